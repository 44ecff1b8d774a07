"""Read depth maps, masks and small texts as files hold them; the only place in the package that does.

Files may come from anyone. A reader never runs what a file holds, and looks at the size that a file claims before it
unpacks anything: no small file can fill the memory. Everything that is wrong with a file ends in an ``InputError``
that names it.
"""

import json
import zipfile
import zlib
from collections.abc import Callable
from io import BytesIO
from math import prod
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Shaped, UInt16
from PIL import Image

from zoedepth.errors import InputError, MissingExtraError
from zoedepth.images import MAX_PIXELS, DepthArray, check_tiles

DEPTH_SUFFIXES = (".png", ".npy", ".npz", ".exr", ".tif", ".tiff")
"""Suffixes (lower case) of files that can hold depth."""

SCALE_KEY = "DepthScale"
"""The PNG text chunk in which this package says the unit of the depth it writes: the stored value of one metre."""

MAX_TEXT = 1 << 20
"""Bytes of a small text, at most: 1 MiB."""

MAX_NESTING = 32
"""How deep the brackets of a JSON text may go."""

_MAX_BYTES = 4 * MAX_PIXELS  # a map may be as large as a photo, with four bytes a pixel
_MAX_NUMBER = 1e38  # what float32 holds
_MAX_NPY_HEADER = 10_000
_MAX_CHUNKS = 1 << 16
_MAX_LZF_BYTES = 1 << 27
_LZF_RATIO = 88  # three bytes stand for 264 at most
_PIECE = 1 << 20
_PICTURES = {".png": "PNG", ".tif": "TIFF", ".tiff": "TIFF"}

Map = Shaped[np.ndarray, "height width"]


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


class StoredMap(NamedTuple):
    """A map as a file has it."""

    values: Map
    scale: float | None = None
    """The stored value of one metre, where the file itself says it."""


# -------------------------------------------------------------------------------------------------- depth in any format


def read_depth(path: str | Path, *, scale: float | None = None) -> DepthArray:
    """Read a depth map: float32 (height, width) in metres, 0 where there is no depth.

    Args:
        path: a PNG or TIFF of one channel; an .npy, an .npz with an array ``depth``, or an .exr, in metres.
        scale: stored value of one metre in a PNG or TIFF, for example 1000 for millimetres. None takes the number that
            ``write_depth`` left in the PNG.

    Raises:
        InputError: the file is missing, damaged or too large, has another format, is not one channel of 16 bits or
            more, or nobody says its scale.
        MissingExtraError: an .exr, and OpenEXR is not installed.
    """
    path = Path(path)
    stored = read_stored(path)
    if path.suffix.lower() not in _PICTURES or stored.values.dtype.kind == "f":
        return stored.values.astype(np.float32, copy=False)
    if stored.values.dtype.itemsize < 2:
        raise InputError(f"{path} is not a depth map: it has 8 bits a pixel. Give a PNG of one channel of 16 bits")
    scale = scale or stored.scale
    if scale is None:
        raise InputError(f"{path} does not say its scale: pass scale=1000 for millimetres, or scale=256 for KITTI's")
    return stored.values.astype(np.float32) / np.float32(scale)


def read_stored(file: Path | Memory) -> StoredMap:
    """Read the map of a file: a PNG or TIFF of one channel, an .npy, an .npz with an array ``depth``, or an .exr.

    Raises:
        InputError: the file is missing, damaged or too large, has another format, or more than one channel.
        MissingExtraError: an .exr, and OpenEXR is not installed.
    """
    suffix = file.suffix.lower()
    if suffix in _PICTURES:
        return _read_picture(file, _PICTURES[suffix])
    if suffix == ".exr" and isinstance(file, Path):
        return StoredMap(read_exr(file))
    if suffix == ".npy":
        return StoredMap(read_npy(file))
    if suffix == ".npz":
        return StoredMap(_read_binary(file, _parse_npz, "a readable .npz with one map of depth"))
    raise InputError(f"cannot read depth from {file}: use one of {', '.join(DEPTH_SUFFIXES)} (.exr not inside a shard)")


def declared_scale(path: Path) -> float | None:
    """Return the stored value of one metre that a PNG declares in its text; None where it does not, or is no PNG."""
    try:
        with Image.open(path, formats=["PNG"]) as picture:  # reads no more than the header
            return _scale_in(picture)
    except Exception:  # whoever reads the map says what is wrong with the file
        return None


# -------------------------------------------------------------------------------------------------- a function a format


def read_mask(file: Path | Memory) -> Bool[np.ndarray, "height width"]:
    """Return True where a PNG of one channel, of 1 to 16 bits, is not zero.

    Raises:
        InputError: the file is missing, damaged or too large, or has more than one channel.
    """
    return _read_picture(file, "PNG", one_bit=True).values != 0


def read_png(path: Path) -> Map:
    """Read the stored values of a PNG of one channel of 8 or 16 bits."""
    return _read_picture(path, "PNG").values


def read_png16(path: Path) -> UInt16[np.ndarray, "height width"]:
    """Read the stored values of a PNG of one channel that must have 16 bits."""
    values = read_png(path)
    if values.dtype != np.uint16:
        raise InputError(f"{path} must have 16 bits a pixel; it has {8 * values.dtype.itemsize}. Get the original file")
    return values


def read_png_with_text(path: Path) -> tuple[Map, dict[str, str]]:
    """Read the stored values of a PNG of one channel of 8 or 16 bits, and its text chunks."""
    values = read_png(path)
    with Image.open(path, formats=["PNG"]) as picture:
        return values, {str(key): value for key, value in picture.info.items() if isinstance(value, str)}


def read_npy(file: Path | Memory) -> Map:
    """Read the one map of an .npy file; an axis of length one at either end is dropped. Pickled objects are refused."""
    return _read_binary(file, _parse_npy, "a readable .npy with one map of numbers")


def read_pfm(path: Path) -> Float32[np.ndarray, "height width"]:
    """Read a portable float map of one channel. Its rows are stored from the bottom up; here the top one is first."""
    return _read_binary(path, _parse_pfm, "a readable PFM of one channel")


def read_hdf5(path: Path, key: str) -> Map:
    """Read the map under a key of an HDF5 file.

    Raises:
        InputError: there is no such map, or it is damaged, too large, or partly in other files.
        MissingExtraError: h5py is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("data", f"reading {path.name}") from error
    _check_exists(path)
    try:
        with h5py.File(path, "r") as file:
            if isinstance(file.get(key, getlink=True), h5py.ExternalLink):
                raise ValueError(f"{key!r} is in another file")
            found = file[key]
            if not isinstance(found, h5py.Dataset):
                raise ValueError(f"{key!r} is not an array")
            _check_map(found.shape, found.dtype)
            _check_chunks(found)
            return np.asarray(found)
    except Exception as error:  # h5py raises OSError, KeyError, RuntimeError and others on a damaged file
        raise InputError(f"{path} is not an HDF5 file with a map {key!r} ({error})") from error


def read_exr(path: Path) -> Float32[np.ndarray, "height width"]:
    """Read the one channel of an OpenEXR file. Of several, it is the first of Z, Y, R, G, B, then of the alphabet.

    Raises:
        InputError: the file is missing, damaged or too large.
        MissingExtraError: OpenEXR is not installed.
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise MissingExtraError("data", f"reading {path.name}") from error
    _check_exists(path)
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            _check_exr([part.header for part in file.parts])
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = file.channels()
            names = sorted(channels, key=lambda name: ("ZYRGB".find(name) % 6, name))
            values = np.asarray(channels[names[0]].pixels)
        _check_map(values.shape, values.dtype)
    except Exception as error:  # the library raises RuntimeError and others for damage of any kind
        raise InputError(f"{path} is not a readable OpenEXR file ({error})") from error
    return values.astype(np.float32)


# ---------------------------------------------------------------------------------------------------------- small texts


def read_text(path: Path, *, max_bytes: int = MAX_TEXT) -> str:
    """Read a text file in UTF-8.

    Raises:
        InputError: it cannot be read, is not text, or is longer than ``max_bytes``.
    """
    try:
        return _read_small(path, max_bytes).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a text in UTF-8 ({error})") from error


def read_numbers(path: Path) -> list[float]:
    """Read the numbers of a small text file, separated by commas or white space.

    Raises:
        InputError: it cannot be read, is longer than 64 KiB, or has other words.
    """
    text = read_text(path, max_bytes=1 << 16)
    try:
        return [float(word) for word in text.replace(",", " ").split()]
    except ValueError as error:
        raise InputError(f"{path} is not a text file of numbers ({error})") from error


def read_json(path: Path, *, max_bytes: int = MAX_TEXT) -> dict[str, Any]:
    """Read the JSON object in a file: see ``parse_json``.

    Raises:
        InputError: it cannot be read, or is not such an object.
    """
    return parse_json(_read_small(path, max_bytes), str(path), max_bytes=max_bytes)


def parse_json(content: str | bytes, where: str, *, max_bytes: int = MAX_TEXT) -> dict[str, Any]:
    """Return the JSON object that a small text holds, with values that any code can take.

    Args:
        content: the text.
        where: the name of the text for messages.
        max_bytes: the longest text that is parsed.

    Raises:
        InputError: the text is too long, or not a JSON object; it has NaN, Infinity or a number that float32 cannot
            hold, or brackets deeper than ``MAX_NESTING``.
    """
    if len(content) > max_bytes:
        raise InputError(f"{where}: longer than {max_bytes:,} bytes, which is too long for JSON here")
    try:
        value = json.loads(content, parse_constant=_refuse_constant)
        _check_json(value)
    except (ValueError, RecursionError) as error:  # UnicodeDecodeError is a ValueError
        raise InputError(f"{where}: not a JSON object ({error})") from error
    if not isinstance(value, dict):
        raise InputError(f"{where}: not a JSON object, but a {type(value).__name__}. Write {{...}}")
    return value


def _read_small(path: Path, max_bytes: int) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(max_bytes + 1)
    except OSError as error:
        raise InputError(f"cannot read {path} ({error.strerror or error}): check the path") from error
    if len(content) > max_bytes:
        raise InputError(f"{path} is longer than {max_bytes:,} bytes: it is not the file that belongs here")
    return content


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is not a number in JSON")


def _check_json(value: object) -> None:
    level = [value]
    for _ in range(MAX_NESTING):
        inner: list[object] = []
        for item in level:
            if isinstance(item, dict):
                inner.extend(item.values())
            elif isinstance(item, list):
                inner.extend(item)
            elif isinstance(item, int | float) and not abs(item) <= _MAX_NUMBER:
                raise ValueError(f"a number beyond {_MAX_NUMBER:g}")
        level = inner
    if level:
        raise ValueError(f"brackets deeper than {MAX_NESTING}")


# ----------------------------------------------------------------------------------------- what the readers are made of


def _check_exists(file: Path | Memory) -> None:
    if isinstance(file, Path) and not file.is_file():
        raise InputError(f"there is no file {file}. Check the path")


def _check_map(shape: tuple[int, ...], dtype: np.dtype) -> None:
    if len(shape) != 2 or 0 in shape or dtype.kind not in "uif":
        raise ValueError(f"it must hold one map (height, width) of numbers; it holds {dtype} {tuple(shape)}")
    if prod(shape) > MAX_PIXELS or prod(shape) * dtype.itemsize > _MAX_BYTES:
        raise ValueError(
            f"{shape[1]} x {shape[0]} pixels of {dtype} are more than {MAX_PIXELS:,} pixels or {_MAX_BYTES:,} bytes"
        )


def _read_binary(file: Path | Memory, parse: Callable[[IO[bytes]], np.ndarray], what: str) -> np.ndarray:
    _check_exists(file)
    try:
        with file if isinstance(file, Memory) else file.open("rb") as opened:
            return parse(opened)
    except Exception as error:  # a damaged archive or header can raise nearly anything
        raise InputError(f"{file} is not {what} ({error})") from error


def _read_picture(file: Path | Memory, format: str, *, one_bit: bool = False) -> StoredMap:
    _check_exists(file)
    try:
        with Image.open(file, formats=[format]) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                raise ValueError(f"{picture.width} x {picture.height} are more than {MAX_PIXELS:,} pixels")
            check_tiles(picture)
            mode, values, scale = picture.mode, np.asarray(picture), _scale_in(picture)
    except Exception as error:  # decoders raise nearly anything on a broken file, from struct.error to SyntaxError
        raise InputError(f"{file} is not a readable {format} ({error})") from error
    if values.ndim != 2 or mode == "P" or (mode == "1" and not one_bit):
        raise InputError(
            f"{file} is not a depth map: it must be a {format} of one channel of 8 or 16 bits, and is of mode {mode!r}"
        )
    return StoredMap(values, scale)


def _scale_in(picture: Image.Image) -> float | None:
    try:
        scale = float(picture.info[SCALE_KEY])
    except (KeyError, TypeError, ValueError):
        return None
    return scale if np.isfinite(scale) and scale > 0 else None


def _parse_npz(file: IO[bytes]) -> np.ndarray:
    bounded: Any = BoundedFile(file, max_bytes=_PIECE)  # as much of a file as zipfile uses
    with zipfile.ZipFile(bounded) as archive:
        names = archive.namelist()
        if "depth.npy" not in names:
            raise ValueError(f"it has no array 'depth', but {[Path(name).stem for name in names[:5]]}")
        if archive.getinfo("depth.npy").compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError("its array 'depth' is compressed in a way that numpy does not use")
        with archive.open("depth.npy") as member:
            return _parse_npy(member)


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
    _check_map(sides, dtype)
    content = _read_exactly(file, prod(sides) * dtype.itemsize, begun=start.read())
    values = np.frombuffer(content, dtype, prod(sides)).reshape(shape, order="F" if fortran else "C")
    return values.reshape(sides)


def _parse_pfm(file: IO[bytes]) -> Float32[np.ndarray, "height width"]:
    kind, size, scale = (file.readline(100).decode("ascii").strip() for _ in range(3))
    width, height = (int(side) for side in size.split())
    order = "<" if float(scale) < 0 else ">"
    if kind != "Pf" or width < 1 or height < 1:
        raise ValueError(f"it is a {kind!r} of {width} x {height}, not a 'Pf'")
    _check_map((height, width), np.dtype(np.float32))
    content = _read_exactly(file, 4 * width * height)
    return np.frombuffer(content, f"{order}f4").reshape(height, width)[::-1].astype(np.float32)


def _read_exactly(file: IO[bytes], size: int, *, begun: bytes = b"") -> bytearray:
    """Read the rest of ``size`` bytes, in pieces: a file that holds less than it promises costs only what it holds."""
    content = bytearray(begun[:size])
    while len(content) < size and (piece := file.read(min(size - len(content), _PIECE))):
        content += piece
    if len(content) < size:
        raise ValueError(f"it is cut short: {size - len(content):,} of {size:,} bytes are missing")
    return content


def _check_chunks(dataset: Any) -> None:
    """Refuse an HDF5 array whose chunks unpack to more than they should, or that leads to other files.

    HDF5 allows a chunk larger than its map, chunks without number, filters upon filters, and unpacks a chunk to
    whatever size it turns out to have.
    """
    import h5py

    if dataset.is_virtual or dataset.external:
        raise ValueError("its values are in other files")
    if dataset.chunks is None:
        return
    if prod(dataset.chunks) > max(dataset.size, _PIECE):
        raise ValueError(f"its chunks of {dataset.chunks} are larger than the map")
    if prod(-(-side // chunk) for side, chunk in zip(dataset.shape, dataset.chunks, strict=True)) > _MAX_CHUNKS:
        raise ValueError(f"it has more than {_MAX_CHUNKS:,} chunks")
    plan = dataset.id.get_create_plist()
    filters = [plan.get_filter(number)[0] for number in range(plan.get_nfilters())]
    packers = [code for code in filters if code not in (h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32)]
    if packers not in ([], [h5py.h5z.FILTER_DEFLATE], [h5py.h5z.FILTER_LZF]):
        raise ValueError(f"it is compressed by the filters {packers}; repack it with gzip: h5repack -f GZIP=4")
    limit = prod(dataset.chunks) * dataset.dtype.itemsize
    for number in range(dataset.id.get_num_chunks() if packers else 0):
        skipped, packed = dataset.id.read_direct_chunk(dataset.id.get_chunk_info(number).chunk_offset)
        if skipped >> filters.index(packers[0]) & 1:  # this chunk is not packed
            continue
        unpacker = zlib.decompressobj()
        if packers == [h5py.h5z.FILTER_LZF]:
            larger = len(packed) * _LZF_RATIO > _MAX_LZF_BYTES
        else:
            larger = unpacker.decompress(packed, limit + 64) and unpacker.unconsumed_tail
        if larger:
            raise ValueError(f"a chunk unpacks to more than its {limit:,} bytes")


def _check_exr(headers: list[dict[str, Any]]) -> None:
    """Refuse an OpenEXR file whose parts and channels, all of which the library unpacks, are too large together."""
    total = 0
    for header in headers:
        (left, top), (right, bottom) = (tuple(map(int, corner)) for corner in header["dataWindow"])
        kind = str(header.get("type", "")).rpartition(".")[2]
        if kind not in ("scanlineimage", "tiledimage"):
            raise ValueError(f"it is a {kind}, with any number of depths a pixel")
        total += (right - left + 1) * (bottom - top + 1) * max(1, len(header["channels"]))
    if total > MAX_PIXELS:
        raise ValueError(f"{total:,} values in all its channels are more than {MAX_PIXELS:,}")
