"""Maps of depth and masks in files of any format: what a value means is said by the file, or by the caller."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt16
from PIL import Image

from zoedepth.claims import check_claims
from zoedepth.errors import InputError
from zoedepth.images import MAX_PIXELS, DepthArray, as_array, check_expansion, check_tiles, load_upright
from zoedepth.pictures import n_full_pages, open_picture
from zoedepth.stored.arrays import read_npy, read_npz, read_pfm, read_pgm
from zoedepth.stored.exr import read_exr
from zoedepth.stored.files import Map, Memory, check_exists

DEPTH_SUFFIXES = (".png", ".npy", ".npz", ".exr", ".tif", ".tiff", ".pfm", ".pgm")
"""Suffixes (lower case) of files that can hold depth."""

SCALE_KEY = "DepthScale"
"""The PNG text chunk in which this package says the unit of the depth it writes: the stored value of one metre."""

RELATIVE_KEY = "RelativeMin"
"""A PNG text chunk of the relative depth that this package writes, which has no unit."""

# Bytes of a pixel that count, by mode: half of what reading takes, with the copy in metres; others have 4.
_BYTES = {"1": 2, "L": 2, "P": 2, "I;16": 3, "I;16B": 3}
_PICTURES = {".png": "PNG", ".tif": "TIFF", ".tiff": "TIFF"}
# Suffixes of files in which people keep depth, and why it is not read from them.
_NOT_READ = {
    **dict.fromkeys((".jpg", ".jpeg", ".webp", ".avif"), "has 8 bits a pixel, which its compression changes"),
    **dict.fromkeys((".bmp", ".gif", ".tga", ".ppm"), "has 8 bits a pixel"),
    **dict.fromkeys((".h5", ".hdf5", ".mat"), "may hold many arrays"),
    **dict.fromkeys((".ply", ".pcd", ".las"), "holds points and not a map"),
    **dict.fromkeys((".glb", ".gltf", ".obj", ".usdz"), "holds a surface and not a map"),
    **dict.fromkeys((".bin", ".raw", ".dat"), "does not say its size and type"),
}
# What pictures of other modes than one channel of numbers may be.
_COLOURS = "colours. Depth packed into red, green and blue, or shown by a colour map, is not read, for nothing says how"
_MODES = {"P": "a palette of colours", "1": "1 bit a pixel", "LA": "grey with transparency"}


class StoredMap(NamedTuple):
    """A map as a file has it."""

    values: Map
    scale: float | None = None
    """The stored value of one metre, where the file itself says it."""
    orientation: int = 1
    """The EXIF orientation by which the map was turned upright; 1 where it says none."""
    relative: bool = False
    """True where the file says that it holds relative depth."""


def read_depth(path: str | Path, *, scale: float | None = None) -> DepthArray:
    """Read a depth map: float32 (height, width) in metres, 0 where there is no depth.

    Args:
        path: a PNG, TIFF or PGM of one channel; an .npy, an .npz with an array ``depth``, an .exr or a .pfm.
        scale: stored value of one metre, for example 1000 for millimetres. None takes the number that ``write_depth``
            left in the PNG, and floating point for metres.

    Raises:
        InputError: the file is missing, damaged or too large, has another format, is not one channel of 16 bits or
            more, or has whole numbers and nobody says their scale.
        MissingExtraError: an .exr, and OpenEXR is not installed.
    """
    return to_metres(read_stored(Path(path)), path, scale=scale)


def to_metres(stored: StoredMap, path: str | Path, *, scale: float | None = None) -> DepthArray:
    """Return the depth of a stored map as ``read_depth`` does.

    Args:
        stored: the map as ``read_stored`` returned it.
        path: its file, for messages.
        scale: see ``read_depth``.

    Raises:
        InputError: it has relative depth, 8 bits a pixel, or whole numbers of which nobody says the scale.
    """
    if stored.relative:
        raise InputError(f"{path} holds relative depth, which has no metres. Predict depth with a model of metres")
    if stored.values.dtype.itemsize < 2:
        raise InputError(f"{path} is not a depth map: it has 8 bits a pixel. Give a PNG of one channel of 16 bits")
    scale = scale or stored.scale
    if scale is None and stored.values.dtype.kind != "f":
        raise InputError(
            f"{path} does not say its scale: give the stored value of one metre (--depth-scale, from Python "
            "scale), 1000 for millimetres, or 256 for KITTI's"
        )
    with np.errstate(over="ignore"):  # float64 beyond float32 is as unknown as infinity
        depth = stored.values.astype(np.float32)
        if scale is not None:
            depth /= np.float32(scale)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))


def read_stored(file: Path | Memory) -> StoredMap:
    """Read the map of a file: of one of ``DEPTH_SUFFIXES``, with one channel, or an array ``depth`` in an .npz.

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
        return StoredMap(read_npz(file))
    if suffix == ".pfm":
        return StoredMap(read_pfm(file))
    if suffix == ".pgm":
        return StoredMap(read_pgm(file))
    reason = f". A {suffix} {_NOT_READ[suffix]}" if suffix in _NOT_READ else ""
    suffixes = f"{', '.join(DEPTH_SUFFIXES)} (.exr not inside a shard)"
    raise InputError(f"cannot read depth from {file}: use one of {suffixes}{reason}")


def declared_scale(path: Path) -> float | None:
    """Return the stored value of one metre that a PNG declares in its text; None where it does not, or is no PNG."""
    try:
        with path.open("rb") as file:
            check_claims(file)
            return _scale_in(open_picture(file, ["PNG"]))  # decodes nothing
    except Exception:  # whoever reads the map says what is wrong with the file
        return None


def read_mask(file: Path | Memory) -> StoredMap:
    """Read a mask: True where a PNG of one channel, of 1 to 16 bits, is not zero.

    Raises:
        InputError: the file is missing, damaged or too large, or has more than one channel.
    """
    stored = _read_picture(file, "PNG", one_bit=True)
    return stored._replace(values=stored.values != 0)


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
    with path.open("rb") as file, open_picture(file, ["PNG"]) as picture:
        return values, {str(key): value for key, value in picture.info.items() if isinstance(value, str)}


def _read_picture(file: Path | Memory, format: str, *, one_bit: bool = False) -> StoredMap:
    check_exists(file)
    try:
        with file if isinstance(file, Memory) else file.open("rb") as opened:
            check_claims(opened)
            picture = open_picture(opened, [format])
            if picture.width * picture.height > MAX_PIXELS:
                raise ValueError(f"{picture.width} x {picture.height} are more than {MAX_PIXELS:,} pixels")
            check_tiles(picture)
            if n_full_pages(picture) > 1:
                raise ValueError("it has several pages: save the one of depth alone")
            n_bytes = file.getbuffer().nbytes if isinstance(file, Memory) else file.stat().st_size
            check_expansion(picture.width * picture.height * _BYTES.get(picture.mode, 4), n_bytes)
            mode, scale, relative = picture.mode, _scale_in(picture), RELATIVE_KEY in picture.info
            picture, orientation = load_upright(picture)
            values = as_array(picture, mode)
    except Exception as error:  # decoders raise nearly anything on a broken file, from struct.error to SyntaxError
        raise InputError(f"{file} is not a readable {format} ({error})") from error
    if values.ndim != 2 or mode == "P" or (mode == "1" and not one_bit):
        raise InputError(
            f"{file} is not a depth map: it must be a {format} of one channel of 8 or 16 bits, and has "
            f"{_MODES.get(mode, _COLOURS)} (mode {mode!r})"
        )
    return StoredMap(values, scale, orientation, relative)


def _scale_in(picture: Image.Image) -> float | None:
    try:
        scale = float(picture.info[SCALE_KEY])
    except (KeyError, TypeError, ValueError):
        return None
    return scale if np.isfinite(scale) and scale > 0 else None
