"""Files in memory, and bounds on what a file may unpack to, for all readers of stored maps."""

from collections.abc import Callable
from contextlib import suppress
from io import BytesIO
from math import prod
from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import Shaped

from zoedepth.claims import stand_in
from zoedepth.errors import InputError
from zoedepth.images import MAX_PIXELS

Map = Shaped[np.ndarray, "height width"]

PIECE = 1 << 20
"""Bytes that are read at once."""

_MAX_BYTES = 4 * MAX_PIXELS  # a map may be as large as a photo, with four bytes a pixel


class Memory(BytesIO):
    """A file in memory.

    Args:
        content: its bytes.
        name: the name of the file for messages.
        suffix: the suffix of its format, lower case, with the dot.
    """

    def __init__(self, content: bytes, name: str, suffix: str = "") -> None:
        super().__init__(content)
        self.name = name
        self.suffix = suffix

    def __str__(self) -> str:
        return self.name


class BoundedFile:
    """A file that hands out few bytes at once, for libraries that read as many as a header tells them to.

    Raises:
        ValueError: more than ``max_bytes`` are asked for at once.
    """

    def __init__(self, file: IO[bytes], *, max_bytes: int) -> None:
        self._file = file
        self._max_bytes = max_bytes
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1) -> bytes:
        """Read ``size`` bytes, or all that are left."""
        content = self._file.read(min(size, self._max_bytes) if size >= 0 else self._max_bytes + 1)
        if max(size, len(content)) > self._max_bytes:
            raise ValueError(f"a header is too long: more than {self._max_bytes:,} bytes")
        return content


def check_exists(file: Path | Memory) -> None:
    if isinstance(file, Path) and not file.is_file():
        raise InputError(f"there is no file {file}. Check the path")


def check_map(shape: tuple[int, ...], dtype: np.dtype) -> None:
    if len(shape) != 2 or min(shape) < 1 or dtype.kind not in "uif":
        raise ValueError(f"it must hold one map (height, width) of numbers; it holds {dtype} {tuple(shape)}")
    if prod(shape) > MAX_PIXELS or prod(shape) * dtype.itemsize > _MAX_BYTES:
        raise ValueError(
            f"{shape[1]} x {shape[0]} pixels of {dtype} are more than {MAX_PIXELS:,} pixels or {_MAX_BYTES:,} bytes"
        )


def cause(file: Path | Memory, error: Exception) -> object:
    """Return why a file cannot be read: because something else stands in its place, or as a library says."""
    if isinstance(file, Path):
        with suppress(OSError), file.open("rb") as opened:
            return stand_in(opened.read(64)) or error
    return error


def read_binary(file: Path | Memory, parse: Callable[[IO[bytes]], np.ndarray], what: str) -> np.ndarray:
    check_exists(file)
    try:
        with file if isinstance(file, Memory) else file.open("rb") as opened:
            return parse(opened)
    except Exception as error:  # a damaged archive or header can raise nearly anything
        raise InputError(f"{file} is not {what} ({cause(file, error)})") from error
