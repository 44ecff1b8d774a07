"""Tell whether a run's checkpoints belong to this data and these starting weights: their state when it began."""

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

from zoedepth.data.sample import Samples
from zoedepth.evaluation.identity import said_and_files, settings_fingerprint
from zoedepth.weights.fingerprint import content, file_state
from zoedepth.weights.hub import WEIGHTS
from zoedepth.weights.load import find


def data_state(dataset: Samples, source: str) -> str:
    """Return a hash that changes with the files of a data set (their sizes and times) and with what is said of them.

    Args:
        dataset: the data set.
        source: where it is, as it was given.
    """
    digest = hashlib.sha256(str(settings_fingerprint(source, dataset)).encode())
    for said, files in said_and_files(dataset, source):
        digest.update(repr(said).encode())
        _add(digest, files)
    return digest.hexdigest()[:16]


def start_state(init: str | None, *, start: str | None = None) -> list[str | None]:
    """Return [name of the starting weights, hash of their content]; None where there is no such file.

    Args:
        init: the name, as it was given.
        start: the place of the weights; None: the newest that the name stands for.
    """
    if init is None:
        return [None, None]
    place = init if start is None else start
    path = find(place) if Path(place).is_dir() else Path(place)
    file = path / WEIGHTS if path.is_dir() else path
    return [init, _weights(file) if file.is_file() else None]


def same_start(first: object, second: object) -> bool:
    """Return True if two states of starting weights agree: by their content, whatever path leads to them.

    Weights that are gone by now agree by their name.
    """
    if not (isinstance(first, list) and isinstance(second, list) and len(first) == len(second) == 2):
        return first == second
    (name, weights), (other_name, other_weights) = first, second
    return weights == other_weights if weights and other_weights else name == other_name


def _weights(file: Path) -> str:
    """Return a hash of a file of weights; of safetensors without the header, in which texts may have changed."""
    header = 0
    if file.suffix == ".safetensors":
        with file.open("rb") as opened:
            header = 8 + int.from_bytes(opened.read(8), "little")
    return content(file, first=header)[:16]


def _add(digest: "hashlib._Hash", files: Iterable[Path]) -> None:
    """Add names, sizes and times of writing. Unlike scores, a run goes on where its data was copied with its times."""
    for file in files:
        found = file_state(file)
        state = "none" if found is None else f"{found.st_size} {found.st_mtime_ns}"
        digest.update(os.fsencode(f"{file.name}: {state}\n"))  # names need not be UTF-8
