"""Arrays as NumPy and the portable maps store them: .npy, .npz, .pfm, .pgm."""

import re
import zipfile
from io import BytesIO
from math import prod
from pathlib import Path
from typing import IO, Any

import numpy as np
from jaxtyping import Float32

from zoedepth.images import check_expansion
from zoedepth.stored.files import PIECE, BoundedFile, Map, Memory, check_map, read_binary

_NAMELESS = "arr_0.npy"  # the array that np.savez gives no name
_MOST_NAMED = 12
_MAX_NPY_HEADER = 10_000
_MAX_PGM_HEADER = 1000
# Width, height and the greatest value, with white space or comments before each.
_PGM = re.compile(rb"P5" + 3 * rb"(?:\s|#[^\r\n]*[\r\n])+(\d{1,9})" + rb"\s")


def read_npy(file: Path | Memory) -> Map:
    """Read the one map of an .npy file; an axis of length one at either end is dropped. Pickled objects are refused."""
    return read_binary(file, _parse_npy, "a readable .npy with one map of numbers")


def read_npz(file: Path | Memory, *, name: str = "depth") -> Map:
    """Read an array of an .npz file by its name, or the only one without a name. Pickled objects are refused."""
    return read_binary(file, lambda opened: _parse_npz(opened, name), f"a readable .npz with one map of {name}")


def read_pfm(file: Path | Memory) -> Float32[np.ndarray, "height width"]:
    """Read a portable float map of one channel. Its rows are stored from the bottom up; here the top one is first."""
    return read_binary(file, _parse_pfm, "a readable PFM of one channel")


def read_pgm(file: Path | Memory) -> Map:
    """Read a portable grey map of 8 or 16 bits, stored in binary. Its values are not scaled, as picture readers do."""
    return read_binary(file, _parse_pgm, "a readable PGM")


def _parse_npz(file: IO[bytes], wanted: str) -> np.ndarray:
    bounded: Any = BoundedFile(file, max_bytes=PIECE)  # as much of a file as zipfile uses
    with zipfile.ZipFile(bounded) as archive:
        names = archive.namelist()
        name = _NAMELESS if names == [_NAMELESS] else f"{wanted}.npy"
        if name not in names:
            found = ", ".join(Path(name).stem for name in names[:_MOST_NAMED]) + (", ..." * (len(names) > _MOST_NAMED))
            advice = ". Save the one of depth as 'depth'" if wanted == "depth" else ""
            raise ValueError(f"it has no array {wanted!r}, but {found or 'none at all'}{advice}")
        member = archive.getinfo(name)
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError("its array is compressed in a way that numpy does not use")
        check_expansion(member.file_size, member.compress_size)
        with archive.open(member) as opened:
            return _parse_npy(opened)


def _parse_npy(file: IO[bytes]) -> np.ndarray:
    """Read a map, and look at its size before any of it is unpacked."""
    # numpy reads a header of whatever length the file claims before it checks that: give it the start of the file only.
    start = BytesIO(file.read(_MAX_NPY_HEADER))
    version = np.lib.format.read_magic(start)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"version {version} is not for plain numbers")
    shape, fortran, dtype = readers[version](start, max_header_size=_MAX_NPY_HEADER)
    sides = shape
    if len(shape) == 3 and 1 in (shape[0], shape[-1]):
        sides = shape[:-1] if shape[-1] == 1 else shape[1:]
    check_map(sides, dtype)
    content = _read_exactly(file, prod(sides) * dtype.itemsize, begun=start.read())
    values = np.frombuffer(content, dtype, prod(sides)).reshape(shape, order="F" if fortran else "C")
    return values.reshape(sides)


def _parse_pfm(file: IO[bytes]) -> Float32[np.ndarray, "height width"]:
    kind, size, scale = (file.readline(100).decode("ascii").strip() for _ in range(3))
    width, height = (int(side) for side in size.split())
    order = "<" if float(scale) < 0 else ">"
    if kind != "Pf" or width < 1 or height < 1:
        colours = ": it has three channels" if kind == "PF" else ""
        raise ValueError(f"it is a {kind!r} of {width} x {height}, not a 'Pf'{colours}")
    check_map((height, width), np.dtype(np.float32))
    content = _read_exactly(file, 4 * width * height)
    return np.frombuffer(content, f"{order}f4").reshape(height, width)[::-1].astype(np.float32)


def _parse_pgm(file: IO[bytes]) -> np.ndarray:
    start = file.read(_MAX_PGM_HEADER)
    if not (found := _PGM.match(start)):
        raise ValueError("it must be a binary one, which begins with P5 and three numbers")
    width, height, greatest = (int(number) for number in found.groups())
    if not 0 < greatest < 1 << 16:
        raise ValueError(f"its greatest value is {greatest}")
    dtype = np.dtype(np.uint8 if greatest < 256 else np.uint16)
    check_map((height, width), dtype)
    content = _read_exactly(file, dtype.itemsize * width * height, begun=start[found.end() :])
    if file.read(1) or len(start) - found.end() > len(content):
        raise ValueError(
            "more follows its pixels: it holds several maps, or its header ends with more than the one blank that the "
            "format has there, so that every value would be a wrong one"
        )
    return np.frombuffer(content, dtype.newbyteorder(">")).reshape(height, width).astype(dtype)


def _read_exactly(file: IO[bytes], size: int, *, begun: bytes = b"") -> bytearray:
    """Read the rest of ``size`` bytes, in pieces: a file that holds less than it promises costs only what it holds."""
    content = bytearray(begun[:size])
    while len(content) < size and (piece := file.read(min(size - len(content), PIECE))):
        content += piece
    if len(content) < size:
        raise ValueError(f"it is cut short: {size - len(content):,} of {size:,} bytes are missing")
    return content
