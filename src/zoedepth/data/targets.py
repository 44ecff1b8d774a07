"""Files of depth as people keep them, from disk or from memory: to arrays, and to samples.

Every reader refuses what is damaged or larger than a photo may be with an ``InputError`` that names it. Nothing is
unpickled.
"""

import zipfile
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float32, Shaped
from PIL import Image

from zoedepth.data.facts import Facts
from zoedepth.data.readers import read_exr
from zoedepth.data.sample import Sample, Target
from zoedepth.errors import InputError
from zoedepth.images import MAX_PIXELS, ImageArray

DEPTH_SUFFIXES = (".png", ".npy", ".npz", ".exr", ".tif", ".tiff")
"""Suffixes (lower case) of files that can hold depth."""

SCALE_KEY = "DepthScale"
"""The PNG text chunk in which this package says the unit of the depth it writes."""

_PICTURES = {".png": "PNG", ".tif": "TIFF", ".tiff": "TIFF"}
_MAX_HEADER = 10_000


class Memory(BytesIO):
    """A file in memory.

    Args:
        content: its bytes.
        name: what to call it in messages.
        suffix: of the format, lower case, with its dot.
    """

    def __init__(self, content: bytes, name: str, suffix: str = "") -> None:
        super().__init__(content)
        self.name = name
        self.suffix = suffix

    def __str__(self) -> str:
        return self.name


class Stored(NamedTuple):
    """A map as a file has it."""

    values: Shaped[np.ndarray, "height width"]
    scale: float | None = None
    """The stored value of one metre, where the file itself says it."""


def read_stored(file: Path | Memory) -> Stored:
    """The map of a file: a PNG or TIFF of one channel, an .npy, an .npz with an array ``depth``, or an .exr.

    Raises:
        InputError: another format, more than one channel, damaged or too large.
        MissingExtraError: an .exr, and OpenEXR is not installed.
    """
    suffix = file.suffix.lower()
    if suffix in _PICTURES:
        return _read_picture(file, _PICTURES[suffix])
    if suffix == ".exr" and isinstance(file, Path):
        return Stored(read_exr(file))
    if suffix not in (".npy", ".npz"):
        raise InputError(f"cannot read depth from {file}: use one of {', '.join(DEPTH_SUFFIXES)}; no .exr in shards")
    try:
        with file if isinstance(file, Memory) else file.open("rb") as opened:
            return Stored(_parse_npy(opened) if suffix == ".npy" else _parse_npz(opened))
    except Exception as error:  # a damaged zip or header can raise nearly anything
        raise InputError(f"{file} is not a readable {suffix} with one map of depth ({error})") from error


def read_mask(file: Path | Memory) -> Bool[np.ndarray, "height width"]:
    """True where a PNG of one channel, of 1 to 16 bits, is not zero.

    Raises:
        InputError: more than one channel, damaged or too large.
    """
    return _read_picture(file, "PNG", bits=True).values != 0


def png_scale(path: Path) -> float | None:
    """The stored value of one metre that a PNG says in its text chunk; None where it does not, or is no PNG."""
    try:
        with Image.open(path, formats=["PNG"]) as picture:  # the head alone is read
            return _scale_in(picture)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        return None


def to_sample(
    photo: ImageArray,
    stored: Stored | None,
    *,
    kind: Target,
    facts: Facts,
    default_scale: float | None = None,
    mask: Bool[np.ndarray, "height width"] | None = None,
    mask_decides: bool = False,
    name: str,
    files: tuple[object, object],
) -> Sample:
    """A sample of a photo and what is stored about it.

    The unit of depth is the first of: ``facts.depth_scale``, what the file says, ``default_scale``; floating point is
    metres without any. What is not finite or not positive is unknown.

    Args:
        photo: uint8 (height, width, 3).
        stored: of the size of the photo; None: nothing is known.
        mask: False where the target is not valid.
        mask_decides: disparity that is not positive is known where the mask, if there is one, says so.
        name: the sample's.
        files: what photo and target are called in messages.

    Raises:
        InputError: sizes differ, or nobody knows the unit.
    """
    size = photo.shape[:2]
    for what, found in (("", None if stored is None else stored.values), ("the mask of ", mask)):
        if found is not None and found.shape != size:
            raise InputError(f"{files[0]} is {size} and {what}{files[1]} is {found.shape}: sizes must agree")
    target = np.zeros(size, np.float32)
    if stored is not None:
        scale = 1.0 if kind == "disparity" else facts.depth_scale or stored.scale or default_scale
        target = _divided(stored.values, scale, files[1])
    known = np.isfinite(target) & (mask if mask is not None else target > 0)
    if not (mask_decides and kind == "disparity"):
        known &= target > 0
    return Sample(
        image=torch.tensor(photo).permute(2, 0, 1).float() / 255,
        target=torch.from_numpy(np.where(known, target, np.float32(0)))[None],
        mask=torch.from_numpy(known)[None],
        kind=kind,
        domain=facts.domain or "",
        name=name,
        camera=facts.camera,
    )


def _divided(values: np.ndarray, scale: float | None, name: object) -> Float32[np.ndarray, "height width"]:
    if scale is None:
        if values.dtype.kind != "f":
            raise InputError(f"{name} has whole numbers and does not say how many are one metre: give depth_scale")
        scale = 1.0
    with np.errstate(over="ignore"):  # float64 beyond float32 is as unknown as infinity
        return values.astype(np.float32) / np.float32(scale)


def _read_picture(file: Path | Memory, format: str, *, bits: bool = False) -> Stored:
    try:
        with Image.open(file, formats=[format]) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                raise ValueError(f"more than {MAX_PIXELS:,} pixels")
            mode, values, scale = picture.mode, np.asarray(picture), _scale_in(picture)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{file} is not a readable {format} ({error})") from error
    if values.ndim != 2 or mode == "P" or (mode == "1" and not bits):
        raise InputError(f"{file} must be a {format} of one channel of 8 or 16 bits; it is of mode {mode!r}")
    return Stored(values, scale)


def _scale_in(picture: Image.Image) -> float | None:
    try:
        scale = float(picture.info[SCALE_KEY])
    except (KeyError, TypeError, ValueError):
        return None
    return scale if np.isfinite(scale) and scale > 0 else None


def _parse_npz(file: IO[bytes]) -> np.ndarray:
    with zipfile.ZipFile(file) as archive:
        if "depth.npy" not in archive.namelist():
            raise ValueError(f"it has no array depth, but {[Path(name).stem for name in archive.namelist()[:5]]}")
        with archive.open("depth.npy") as member:
            return _parse_npy(member)


def _parse_npy(file: IO[bytes]) -> np.ndarray:
    """The map, its size checked before any of it is read; an axis of one at either end is dropped."""
    version = np.lib.format.read_magic(file)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"version {version} is not for plain numbers")
    shape, fortran, dtype = readers[version](file, max_header_size=_MAX_HEADER)
    sides = shape
    if len(shape) == 3 and 1 in (shape[0], shape[-1]):
        sides = shape[:-1] if shape[-1] == 1 else shape[1:]
    if len(sides) != 2 or 0 in sides or dtype.kind not in "uif":
        raise ValueError(f"it must be one map (height, width) of numbers, and is {dtype} {shape}")
    count = sides[0] * sides[1]
    if count > MAX_PIXELS:
        raise ValueError(f"{count:,} pixels are more than {MAX_PIXELS:,}")
    content = file.read(count * dtype.itemsize)
    values = np.frombuffer(content, dtype, count).reshape(shape, order="F" if fortran else "C")
    return values.reshape(sides)
