"""Hashes by which weights, files and settings are known again. No torch here."""

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path

from zoedepth.weights.hub import CONFIG, PREPROCESSOR, WEIGHTS
from zoedepth.weights.releases import ASSETS


def weights_fingerprint(path: Path) -> str:
    """Return a hash of a model: of its file of weights, or of its folder, with the configuration beside it.

    OpenVINO's weights are in a .bin beside the .xml, and are part of it; so are those that an .onnx has beside it.
    """
    if path.is_dir() and not (path / WEIGHTS).is_file():
        return fingerprint(files_state(path.rglob("*")))
    folder, file = (path, path / WEIGHTS) if path.is_dir() else (path.parent, path)
    parts = {file, folder / CONFIG, folder / PREPROCESSOR}
    if file.suffix == ".xml":
        parts.add(file.with_suffix(".bin"))
    if file.suffix == ".onnx":
        parts.add(file.with_suffix(".safetensors"))
    return fingerprint([(part.name, content(part)) for part in sorted(parts) if part.is_file()])


def content_fingerprint(path: Path) -> str:
    """Return a hash of what a model is made of, whatever its files are called and wherever they lie.

    A folder counts with its configuration. A file counts alone, unless it is the weights of such a folder, or needs
    another beside it: OpenVINO's .xml its .bin, and the graph in the package its weights.
    """
    if path.is_dir() and not (path / WEIGHTS).is_file():
        return weights_fingerprint(path)
    folder = path if path.is_dir() else path.parent
    if path.is_dir() or path.name == WEIGHTS:
        parts = [folder / WEIGHTS, folder / CONFIG, folder / PREPROCESSOR]
    elif path.suffix.lower() == ".xml":
        parts = [path, path.with_suffix(".bin")]
    elif path.suffix.lower() == ".onnx" and folder == ASSETS:
        parts = [path, path.with_suffix(".safetensors")]
    else:
        parts = [path]
    return fingerprint([content(part) for part in parts if part.is_file()])


def fingerprint(values: object) -> str:
    """Return a short hash of plain values."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:16]


def files_state(files: Iterable[Path]) -> list[tuple[str, int, int, int] | None]:
    """Return name, size and times of files; None for one that is not there.

    The time of the last change is not enough alone: archives and ``cp -p`` set it to what it was.
    """
    states = ((file, file_state(file)) for file in sorted(files) if not file.is_dir())
    return [
        None if found is None else (str(file), found.st_size, found.st_mtime_ns, found.st_ctime_ns)
        for file, found in states
    ]


def file_state(file: Path) -> os.stat_result | None:
    """Return size and times of a file; None if it is not there, or if no file can have this name."""
    try:
        return file.stat()
    except (OSError, ValueError):
        return None


def content(file: Path, *, first: int = 0) -> str:
    """Return a hash of the bytes of a file, from byte ``first`` on."""
    digest = hashlib.sha256()
    with file.open("rb") as opened:
        opened.seek(first)
        while chunk := opened.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()
