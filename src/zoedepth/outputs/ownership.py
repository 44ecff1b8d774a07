"""The files that this package wrote, known by their content and their sidecar, wherever they lie: by no name alone."""

import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from zoedepth.errors import InputError
from zoedepth.images import OWN_MARK
from zoedepth.outputs import sidecar as sidecars
from zoedepth.stored import SCALE_KEY, read_depth, readable

# Pictures have it in their EXIF, PNGs of depth in a chunk of text, other files in their headers.
_MARKS = tuple(mark.encode() for mark in (OWN_MARK, f"tEXt{SCALE_KEY}\0", "tEXtRelativeMin\0"))
_HEAD = 1024  # bytes; WebP has its texts at the end
_UNMARKED = (".npy", ".npz", ".pfm")
_ROUNDING = 1.01e-4  # of sidecars, metres


def is_own_file(file: Path) -> bool:
    """Return True if this package wrote the file.

    Most say it in their first bytes, and sidecars by what they hold. Arrays and PFMs, which have no room for it, are
    known by the sidecar that lists them, if they have the depth that it says; so are the previews of older versions.
    """
    if file.suffix.lower() == sidecars.ENDING:
        return sidecars.read_sidecar(file) is not None
    return has_own_mark(file) or (file.suffix.lower() != ".png" and _is_listed(file))


def has_own_mark(file: Path) -> bool:
    """Return True if the file says in its first or last bytes that this package wrote it."""
    # Of a hundred thousand photos each is looked at, so that this counts: no object of Python's for the file.
    try:
        opened = os.open(file, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except OSError:
        return False
    try:
        if not stat.S_ISREG(os.fstat(opened).st_mode):
            return False
        content = os.read(opened, _HEAD)
        if content.startswith(b"RIFF"):
            os.lseek(opened, -_HEAD, os.SEEK_END)
            content += os.read(opened, _HEAD)
    except OSError:
        return False
    finally:
        os.close(opened)
    return any(mark in content for mark in _MARKS)


def require_own_mark(file: Path, *, advice: str) -> None:
    """Refuse to replace a file, or a link, that this package has not written.

    Args:
        file: the file, which need not be there.
        advice: the end of the message, on what to do.

    Raises:
        InputError: it is there, and does not say that this package wrote it.
    """
    if os.path.lexists(file) and not has_own_mark(file):
        raise InputError(f"{file} is not from zoedepth, and would be replaced: {advice}")


def _is_listed(file: Path) -> bool:
    name = readable(file.name)
    for stem in _stems(file.name):
        sidecar = sidecars.read_sidecar(file.with_name(stem + sidecars.ENDING))
        if sidecar is not None and name in sidecars.listed(sidecar):
            return name not in sidecar["files"].values() or _has_the_values(file, sidecar)
    return False


def _has_the_values(file: Path, sidecar: Mapping[str, Any]) -> bool:
    """Return False if a file has another depth than the sidecar says: somebody has put theirs in the place of ours."""
    said = sidecar.get("depth")
    if file.suffix.lower() not in _UNMARKED or not isinstance(said, dict):
        return True
    ends = [float(end) for end in (said.get("min"), said.get("max")) if isinstance(end, int | float) and end > 0]
    if len(ends) < 2:
        return True
    try:
        depth = read_depth(file)
    except (InputError, OSError):
        return False
    known = depth[depth > 0]
    return known.size > 0 and bool(np.allclose([known.min(), known.max()], ends, rtol=1e-6, atol=_ROUNDING))


def _stems(name: str) -> list[str]:
    """Return what may be the name of the photo in the name of a file: "a" and "a_depth" in "a_depth.npy"."""
    stem = name.rpartition(".")[0]
    return [stem, stem.rpartition("_")[0]] if "_" in stem else [stem]
