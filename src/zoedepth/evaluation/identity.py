"""Tell whether kept scores still hold: the state of weights, photos, depth maps and settings when they were made.

The first line of a file of scores says which question they answer (``about``); each score has a stamp of everything
that may have changed since under the same names. Weights and settings are known by their content, the many files of a
data set by their sizes and times.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from zoedepth import __version__
from zoedepth.data.facts import DEFAULTS_FILE
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Samples
from zoedepth.datasets.published import PublishedDataset
from zoedepth.weights.hub import CONFIG, PREPROCESSOR, WEIGHTS


def weights_fingerprint(path: Path) -> str:
    """Return a hash of a model: of its file of weights, or of its folder, with the configuration beside it.

    OpenVINO's weights are in a .bin beside the .xml, and are part of it.
    """
    if path.is_dir() and not (path / WEIGHTS).is_file():
        return fingerprint(files_state(path.rglob("*")))
    folder, file = (path, path / WEIGHTS) if path.is_dir() else (path.parent, path)
    parts = {file, folder / CONFIG, folder / PREPROCESSOR}
    if file.suffix == ".xml":
        parts.add(file.with_suffix(".bin"))
    return fingerprint([(part.name, content(part)) for part in sorted(parts) if part.is_file()])


def settings_fingerprint(source: str) -> str | None:
    """Return a hash of ``dataset.json`` in a folder of data or beside a list; None where there is no such file."""
    path = Path(source)
    settings = (path if path.is_dir() else path.parent) / DEFAULTS_FILE
    return content(settings) if settings.is_file() else None


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


class Stamps:
    """Make the stamps of a source's scores on a data set: the same as long as everything they depend on is.

    Args:
        source: the source of predictions. If it has a method ``state``, that is given the name of a photo, and returns
            plain values that change when the prediction may.
        data: the data set. Of a list, a folder or a published set each image has its own files; of others, which have
            them in an attribute ``files``, every image depends on all.
        state: plain values that change when the scores may.
    """

    def __init__(self, source: object, data: Samples, state: Mapping[str, object]) -> None:
        self._of_source: Callable[[str], object] | None = getattr(source, "state", None)
        self._pairs = data.pairs if isinstance(data, PairDataset | PublishedDataset) else None
        self._n_images = len(data)
        self._common = fingerprint([__version__, dict(state), files_state(getattr(data, "files", ()))])

    def of_data(self, index: int) -> str:
        """Return the state of an image of the data set and of what all scores depend on; "" for no such image."""
        if not 0 <= index < self._n_images:
            return ""
        if self._pairs is None:
            return self._common
        pair = self._pairs[index]
        return fingerprint([self._common, repr(pair), files_state(pair.files)])

    def of(self, index: int, name: str, *, data: str | None = None) -> str:
        """Return the stamp of a score.

        Args:
            index: number of the image in the data set.
            name: name of the photo.
            data: result of ``of_data`` before the image was read; None asks for it now.
        """
        source = None if self._of_source is None else self._of_source(name)
        return fingerprint([data or self.of_data(index), name, source])
