"""Text lists without names of columns: ``photo depth focal`` as BTS has them, and those of TUM RGB-D."""

import os
import re
from collections.abc import Iterator
from pathlib import Path, PurePath

from zoedepth.data.stamps import TOLERANCE, pair_by_time, seconds
from zoedepth.data.tables import read_lines
from zoedepth.errors import InputError
from zoedepth.images import IMAGE_SUFFIXES
from zoedepth.stored import DEPTH_SUFFIXES

MISSING = "None"
"""The word that stands in a list where a photo has no depth."""
FOCAL = "focal length of a text list"
"""The key of the third word of a line ``photo depth focal``, which no column of a table can be."""

_PHOTOS, _DEPTHS = "rgb.txt", "depth.txt"
_PHOTO_FOLDERS = {"rgb", "color", "colour", "image", "images"}
_LONGEST = 10_000  # characters of a line, of which every blank is tried; a path has 4096 at most
_WORD = re.compile(r'"([^"]*)"|(\S+)')


def read_text_list(path: Path, root: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield (place for messages, {"image": its path, "depth": its path}) of a list's lines, with a ``FOCAL`` if said.

    A line is ``photo depth``, ``photo depth focal``, or ``time photo time depth`` as in TUM's ``associations.txt``, and
    has blanks, tabs or quotation marks around names that have blanks. Comments begin with #. TUM's ``rgb.txt``, with
    lines ``time photo``, goes with the ``depth.txt`` beside it: see ``zoedepth.data.stamps.pair_by_time``.

    Args:
        path: the list.
        root: the folder that its paths are relative to, where it is looked what a line with many blanks means.

    Raises:
        InputError: the list is no text, or a line is malformed or ambiguous; it is named.
    """
    timed = True
    for where, line in _lines(path):
        if timed and (row := _timed(line)):
            yield from _by_time(path, row)
            return
        timed = False
        photo, depth, focal = _split(line, where, root)
        if _is_swapped(photo, depth):
            photo, depth = depth, photo
        yield where, {"image": photo, "depth": depth} | ({FOCAL: focal} if focal else {})


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    for number, line in enumerate(read_lines(path), start=1):
        if (line := line.strip()) and not line.startswith("#"):
            yield f"{path}, line {number}", line


def _split(line: str, where: str, root: Path) -> tuple[str, str, str]:
    """Return the photo, the depth and the focal length of a line; "" where it has none."""
    if "\t" in line:
        words = [word for part in line.split("\t") if (word := part.strip())]
    else:
        words = [quoted or word for quoted, word in _WORD.findall(line)]
    if len(words) < 2:
        raise InputError(f"{where}: needs a photo and its depth (or {MISSING}); it has only {line[:200]!r}")
    if len(words) == 2 or (len(words) == 3 and _is_number(words[2])):
        return words[0], words[1], words[2] if len(words) == 3 else ""
    names, numbers = words[1:4:2], [words[0], *words[2:3], *words[4:]]
    if len(words) > 3 and all(map(_is_number, numbers)) and not any(map(_is_number, names)):
        return words[1], words[3], ""
    if len(line) > _LONGEST or not (found := _split_at_blanks(line, root)):
        raise InputError(
            f"{where}: cannot tell where the photo ends and its depth begins in {line[:200]!r}. Write photo depth, "
            "photo depth focal, or time photo time depth; names with blanks go between quotation marks"
        )
    return found


def _split_at_blanks(line: str, root: Path) -> tuple[str, str, str] | None:
    """Return what ``_split`` does of a line whose names have blanks; None where it could be this or that."""
    rest, _, focal = line.rpartition(" ")
    line, focal = (rest.rstrip(), focal) if _is_number(focal) else (line, "")
    splits = [(line[: blank.start()], line[blank.end() :]) for blank in re.finditer(r"\s+", line)]
    fitting = [
        (photo, depth)
        for photo, depth in splits
        if _suffix(photo) in IMAGE_SUFFIXES and (depth == MISSING or _suffix(depth) in DEPTH_SUFFIXES)
    ]
    if len(fitting) > 1:
        fitting = [names for names in fitting if all(_exists(root, name) for name in names)]
    return (*fitting[0], focal) if len(fitting) == 1 else None


def _timed(line: str) -> tuple[float, str] | None:
    """Return (time, file) of a line that has just these."""
    words = line.split()
    if len(words) != 2 or _suffix(words[1]) not in IMAGE_SUFFIXES:
        return None
    stamp = seconds(words[0])
    return None if stamp is None else (stamp, words[1])


def _by_time(path: Path, first: tuple[float, str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the pairs of TUM's two lists, of which ``path`` must be that of the photos."""
    other = path.with_name(_DEPTHS)
    if path.name.lower() != _PHOTOS or not other.is_file():
        raise InputError(
            f"{path} has times and one file a line ({first[1]}), not photos and their depth. Call the list of the "
            f"photos {_PHOTOS} and put that of their depth beside it as {_DEPTHS}, or write time photo time depth"
        )
    photos, depths = _times(path), _times(other)
    pairs = pair_by_time([time for time, _, _ in photos], [time for time, _, _ in depths])
    if not pairs:
        raise InputError(f"{path} and {other} have no photo and depth within {TOLERANCE} s of each other")
    for i, j in pairs:
        yield photos[i][2], {"image": photos[i][1], "depth": depths[j][1]}


def _times(path: Path) -> list[tuple[float, str, str]]:
    found = []
    for where, line in _lines(path):
        if not (row := _timed(line)):
            raise InputError(f"{where}: must be a time and a file; it is {line[:200]!r}")
        found.append((*row, where))
    return found


def _is_swapped(photo: str, depth: str) -> bool:
    """Return True if the folders say that depth comes first, as where TUM's tool was given the lists the other way."""
    first, second = ({part.lower() for part in PurePath(name).parts[:-1]} for name in (photo, depth))
    return "depth" in first and "depth" not in second and bool(_PHOTO_FOLDERS & second)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _suffix(name: str) -> str:
    return PurePath(name).suffix.lower()


def _exists(root: Path, name: str) -> bool:
    return name == MISSING or os.path.exists(root / name.lstrip("/"))
