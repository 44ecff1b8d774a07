"""Are the files of a data set whole? Headers, sizes and ends are looked at, and what looks wrong is read.

Reading a hundred thousand photos takes an hour, looking at them a minute. The look only raises suspicion: whether a
pair is broken is decided by reading it as training does.
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from zoedepth.data.fit import check_fit
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Hashed, Samples
from zoedepth.errors import InputError
from zoedepth.images import FORMATS
from zoedepth.pictures import open_picture, read_exif

MOST_BROKEN = 0.1
"""Share of the samples of a data set that may be broken before it is not used."""

_THREADS, _CHUNK = 8, 1024
_TAIL = 64
_ORIENTATION = 0x0112


def find_broken(
    dataset: Samples,
    *,
    full: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[int, str]:
    """Look at every file of a data set.

    Args:
        dataset: the data set. Of shards, Hugging Face's rows and rendered scenes, which are checked when they are
            opened, nothing more is looked at unless ``full``.
        full: read every sample, and compare shards with their hashes.
        progress: called with the number of samples that are done, and of all.

    Returns:
        Index of a sample → message that names the file and what is wrong with it.
    """
    pairs: Sequence[Any] | None = getattr(dataset, "pairs", None)
    if pairs is None and not full:
        return {}

    def judge(index: int) -> str | None:
        if not full and pairs is not None and not _suspicious(pairs[index], paired=isinstance(dataset, PairDataset)):
            return None
        try:
            dataset[index]
        except InputError as error:
            return str(error)
        return None

    # What is read may look right where bytes have changed.
    broken = dataset.altered() if full and isinstance(dataset, Hashed) else {}
    indices = [i for i in range(len(dataset)) if i not in broken and (pairs is None or pairs[i].target is not None)]
    with ThreadPoolExecutor(_THREADS) as pool:
        for start in range(0, len(indices), _CHUNK):
            chunk = indices[start : start + _CHUNK]
            broken |= {i: problem for i, problem in zip(chunk, pool.map(judge, chunk), strict=True) if problem}
            progress(start + len(chunk), len(indices))
    return broken


def most_broken(n: int) -> int:
    """Return how many of ``n`` samples may be broken: a tenth, and of few samples one."""
    return max(1, int(MOST_BROKEN * n))


def named(messages: Iterable[str], most: int = 5) -> str:
    """Name what is broken, of many only the first."""
    lines = list(messages)
    more = [f"and {len(lines) - most:,} more, which zoedepth data check lists"] if len(lines) > most else []
    return "; ".join([*lines[:most], *more])


def _suspicious(pair: Any, *, paired: bool) -> bool:
    """Return True if a file of a pair is missing or seems to be cut short, or if photo and depth may not fit."""
    try:
        if not all(_ends_well(path) for path in pair.files):
            return True
        if paired and (found := _size(pair.target, depth=pair.kind == "depth")) is not None:
            with pair.image.open("rb") as file, open_picture(file, FORMATS) as photo:
                turned = "exif" in photo.info and read_exif(photo).get(_ORIENTATION, 1) != 1
                check_fit((photo.height, photo.width), found, names=(pair.image, pair.target))
            return turned
    except Exception:  # whoever reads the pair says what is wrong with it
        return True
    return False


def _ends_well(path: Path) -> bool:
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(16)
        file.seek(max(0, size - _TAIL))
        tail = file.read(_TAIL)
    if start.startswith(b"\xff\xd8"):
        return tail.rstrip(b"\0").endswith(b"\xff\xd9")
    if start.startswith(b"\x89PNG"):
        return b"IEND" in tail
    if start.startswith(b"RIFF"):
        return int.from_bytes(start[4:8], "little") + 8 <= size
    if start.startswith(b"PK"):
        return b"PK\5\6" in tail
    return size > 0


def _size(path: Path, *, depth: bool) -> tuple[int, int] | None:
    """Return (height, width) by the header of a map; None for formats whose header takes long to read.

    Raises:
        ValueError: it is a picture of 8 bits, and should be depth.
    """
    suffix = path.suffix.lower()
    if suffix == ".npy":
        sides = [side for side in np.load(path, mmap_mode="r", allow_pickle=False).shape if side != 1]
        return (int(sides[0]), int(sides[1])) if len(sides) == 2 else None
    if suffix in (".npz", ".exr", ".pfm"):
        return None
    with path.open("rb") as file, open_picture(file, FORMATS) as picture:
        if depth and not picture.mode.startswith(("I", "F")):
            raise ValueError(f"its mode is {picture.mode}")
        return picture.height, picture.width
