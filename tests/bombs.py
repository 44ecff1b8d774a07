"""Small files that would fill the memory if they were unpacked, and files that lie about their size."""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

GIGABYTES = 4096
"""MiB of zeros in a bomb: 4 GiB, in 4 MB."""


def zeros(mebibytes: int, *, raw: bool = False) -> bytes:
    """Return so many MiB of zeros as a zlib stream, or as a raw deflate stream, of a thousandth of the size.

    One block is compressed once and repeated, so that making a bomb takes no time. The checksum at the end is wrong.
    """
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    block = packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH)
    end = zlib.compressobj(9, zlib.DEFLATED, -15).flush()
    stream = block * mebibytes + end
    return stream if raw else b"\x78\xda" + stream + bytes(4)


def deflated(start: bytes, mebibytes: int) -> bytes:
    """Return a raw deflate stream of these bytes and so many MiB of zeros."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return packer.compress(start) + packer.flush(zlib.Z_FULL_FLUSH) + zeros(mebibytes, raw=True)


def npy_header(shape: tuple[int, ...], descr: str = "<f4") -> bytes:
    """Return the start of an .npy that says it holds as much."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": shape})
    return file.getvalue()


def zip_of(name: str, stream: bytes, size: int, *, entries: int = 1) -> bytes:
    """Return a zip with one member, a raw deflate stream, listed as often as ``entries`` says."""
    common = struct.pack("<HHHHHIIIHH", 20, 0, zipfile.ZIP_DEFLATED, 0, 33, 0, len(stream), size, len(name), 0)
    local = b"PK\3\4" + common + name.encode() + stream
    central = b"PK\1\2" + struct.pack("<H", 20) + common + struct.pack("<HHHII", 0, 0, 0, 0, 0) + name.encode()
    central *= entries
    counts = (entries % 65536, entries % 65536, len(central), len(local))
    return local + central + b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, *counts, 0)


def png(width: int, height: int, *, extra: bytes = b"") -> bytes:
    """Return a 16-bit PNG that says it is as large, with 1 GiB of zeros, and more chunks before them."""
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra + chunk(b"IDAT", zeros(1024)) + chunk(b"IEND", b"")


def chunk(kind: bytes, content: bytes) -> bytes:
    """Return a chunk of a PNG."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def tiff(width: int, height: int, *, tile: tuple[int, int] | None = None) -> bytes:
    """Return a 16-bit TIFF that says it is as large, in a strip or in tiles of (width, height), with 1 GiB of zeros."""
    stream = zeros(1024)
    tags = {256: width, 257: height, 258: 16, 259: 8, 262: 1, 277: 1, 339: 1}
    place, length = (324, 325) if tile else (273, 279)
    tags |= {322: tile[0], 323: tile[1]} if tile else {278: height}
    tags |= {place: 8 + 2 + 12 * (len(tags) + 2) + 4, length: len(stream)}
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in sorted(tags.items()))
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(4) + stream


def exr(path: Path, width: int, height: int) -> None:
    """Write an OpenEXR that says it is as large, and holds 2 x 2 pixels."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": np.zeros((2, 2), np.float32)}).write(str(path))
    window = struct.pack("<iiii", 0, 0, 1, 1)
    content = path.read_bytes()
    assert content.count(window) == 2, "data window and display window"
    path.write_bytes(content.replace(window, struct.pack("<iiii", 0, 0, width - 1, height - 1)))


def hdf5(path: Path, write: Callable) -> None:
    """Write an HDF5 file; ``write`` gets it, and makes its ``depth``."""
    import h5py

    with h5py.File(path, "w") as file:
        write(file)


def photo(path: Path, size: tuple[int, int]) -> None:
    """Write a grey photo of (height, width)."""
    Image.new("RGB", (size[1], size[0]), (128, 128, 128)).save(path)


def tiff_pages(*pages: tuple[Image.Image, dict[int, int]]) -> io.BytesIO:
    """Return a TIFF of several pages, each a picture and its tags: NewSubfileType (254), SubfileType (255)."""
    tifffile = pytest.importorskip("tifffile")
    file = io.BytesIO()
    with tifffile.TiffWriter(file) as writer:
        for picture, tags in pages:
            values = np.asarray(picture)
            older = [(255, "H", 1, tags[255], True)] if 255 in tags else []
            colours = "rgb" if values.ndim == 3 else "mask" if tags.get(254) == 4 else "minisblack"
            writer.write(values, photometric=colours, subfiletype=tags.get(254, 0), extratags=older, metadata=None)
    return file
