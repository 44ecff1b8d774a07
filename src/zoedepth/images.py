"""Files and arrays in, files out: photographs to uint8 arrays, depth maps to files that say their unit.

Everything that enters the package becomes one thing, an ``image``: uint8, (height, width, 3), RGB, upright. Everything
that leaves it is written whole or not at all.
"""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, Any
from uuid import uuid4

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image, UnidentifiedImageError
from PIL.PngImagePlugin import PngInfo

from zoedepth.errors import InputError

ImageArray = UInt8[np.ndarray, "_height _width 3"]
DepthArray = Float32[np.ndarray, "_height _width"]
BinaryFile = IO[bytes] | BytesIO  # a BytesIO is an IO[bytes] to static checkers, not to beartype

IMAGE_SUFFIXES = frozenset(
    {".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".tif", ".tiff", ".webp", ".avif", ".bmp", ".dib"}
    | {".gif", ".ppm", ".pgm", ".pbm", ".pnm", ".jp2", ".j2k", ".tga"}
)
"""Suffixes (lower case) by which a photograph is recognised in a folder."""

PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
"""Suffixes that ``write_image`` writes."""

MAX_PIXELS = 178_956_970
"""The largest picture that is decoded: where Pillow itself refuses, about 180 megapixels or 0.5 GB of RGB."""

PNG_SCALE_MILLIMETRE = 1000.0
PNG_SCALE_KITTI = 256.0
PNG_MAX = 65535

# Named one by one, so that a file can never start a program: Pillow runs Ghostscript to read EPS.
_FORMATS = ("JPEG", "MPO", "PNG", "TIFF", "WEBP", "AVIF", "BMP", "DIB", "GIF", "PPM", "JPEG2000", "TGA")
_SCALE_KEY, _UNIT_KEY = "DepthScale", "DepthUnit"
# EXIF orientation -> what stands the picture upright (EXIF 2.3, tag 0x0112).
_ORIENTATION_TAG = 0x0112
_UPRIGHT = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}


def read_image(source: str | Path | BinaryFile, *, max_pixels: int = MAX_PIXELS) -> ImageArray:
    """Read a photograph as uint8 (height, width, 3), RGB, [0, 255], turned upright by its EXIF orientation.

    Grey is repeated to three channels; palette, CMYK and YCbCr are converted; colour profiles are ignored. Alpha is
    dropped, not composited: the colours under it are kept, and no edge is invented. 16-bit grey spans 0..65535; float
    TIFF must be in [0, 1]. Of several frames the first is read.

    Args:
        source: a path, or a binary file open for reading.
        max_pixels: height * width above which a file is refused before it is decoded.

    Raises:
        InputError: the file is missing, not an image, truncated, too large, or in a mode that has no meaning here.
    """
    with _open(source, max_pixels=max_pixels) as picture:
        return _from_pil(picture, _name(source))


def to_image(source: Any) -> ImageArray:
    """Turn whatever holds a picture into an image: uint8 (height, width, 3), RGB, [0, 255].

    Args:
        source: a path or open file (see ``read_image``); a ``PIL.Image.Image``; a numpy array (H, W) or (H, W, 1|3|4),
            RGB, uint8, uint16 (0..65535) or float in [0, 1]; a torch tensor (H, W) or (1|3|4, H, W) of the same types.
            Floats are rounded to 8 bits, so that one photograph gives one depth whichever way it comes in.

    Raises:
        InputError: another type, shape or range; the message says what is expected.
    """
    if isinstance(source, str | Path) or hasattr(source, "read"):
        return read_image(source)
    if isinstance(source, Image.Image):
        return _from_pil(source, "the PIL image")
    if isinstance(source, np.ndarray):
        return _from_array(source, "the array")
    torch = sys.modules.get("torch")  # whoever holds a tensor has imported torch; nobody else should pay for it
    if torch is not None and isinstance(source, torch.Tensor):
        return _from_array(_channels_last(source), "the tensor")
    raise InputError(
        f"cannot read an image from {type(source).__name__}: pass a path, an open file, a PIL image, "
        "a numpy array (H, W, 3) or a torch tensor (3, H, W)"
    )


def write_image(path: str | Path, image: ImageArray) -> None:
    """Write a uint8 RGB picture in the format of the suffix (JPEG at quality 92), whole or not at all.

    Raises:
        InputError: a suffix that is not .jpg, .jpeg, .png or .webp.
    """
    if Path(path).suffix.lower() not in PICTURE_SUFFIXES:
        raise InputError(f"cannot write a picture as {Path(path).name!r}: use one of {', '.join(PICTURE_SUFFIXES)}")
    with atomic_path(path) as temporary:
        Image.fromarray(image).save(temporary, quality=92)


def png_scale(depth: np.ndarray) -> float:
    """Levels per metre at which ``depth`` fits a 16-bit PNG: 1000 (millimetres) up to 65.535 m, else 256 (KITTI's)."""
    valid = depth[np.isfinite(depth)]
    fits = valid.size == 0 or valid.max() * PNG_SCALE_MILLIMETRE <= PNG_MAX
    return PNG_SCALE_MILLIMETRE if fits else PNG_SCALE_KITTI


def write_depth_png(path: str | Path, depth: np.ndarray, *, scale: float = PNG_SCALE_MILLIMETRE) -> None:
    """Write metres as a 16-bit grey PNG: value = round(depth * scale), 0 = no depth.

    Too far is clipped to 65535, never wrapped; too near to 1, so that a valid pixel stays valid. Non-finite and
    non-positive depth becomes 0. The text chunks ``DepthScale`` and ``DepthUnit`` say how to read the file back.

    Args:
        path: where to write; folders are made.
        depth: (height, width), metres.
        scale: PNG levels per metre; 1000 is millimetres (up to 65.535 m), 256 is KITTI's (up to 255.996 m).

    Raises:
        InputError: depth is not two-dimensional, or the scale is not a positive number.
    """
    if not (np.isfinite(scale) and scale > 0):
        raise InputError(f"the PNG scale is levels per metre and must be positive, got {scale}")
    depth = _check_depth(depth)
    valid = np.isfinite(depth) & (depth > 0)
    levels = np.where(valid, depth, 0).astype(np.float64)
    levels *= scale
    np.clip(np.rint(levels, out=levels), valid, PNG_MAX, out=levels)  # from 1 where valid
    levels = levels.astype(np.uint16)
    text = PngInfo()
    text.add_text(_SCALE_KEY, f"{scale:.10g}")
    text.add_text(_UNIT_KEY, "metre")
    text.add_text("Description", f"depth along the optical axis in metres = value / {scale:.10g}; 0 = no depth")
    with atomic_path(path) as temporary:
        # Level 1 of zlib takes a quarter of the time of Pillow's 6, for a file a quarter larger.
        Image.fromarray(levels).save(temporary, format="PNG", pnginfo=text, compress_level=1)


def write_relative_png(path: str | Path, relative: np.ndarray) -> tuple[float, float]:
    """Write relative depth as a 16-bit grey PNG, as MiDaS does: the farthest is 0, the nearest 65535.

    Args:
        path: where to write; folders are made.
        relative: (height, width), inverse depth up to scale and shift, finite.

    Returns:
        The least and the greatest value: relative = least + level / 65535 * (greatest - least). They are in the text
        chunks ``RelativeMin`` and ``RelativeMax`` too.

    Raises:
        InputError: it is not two-dimensional, or not finite.
    """
    relative = _check_depth(relative).astype(np.float64)
    if not np.isfinite(relative).all():
        raise InputError("relative depth must be finite")
    low, high = float(relative.min()), float(relative.max())
    levels = np.rint((relative - low) / max(high - low, 1e-12) * PNG_MAX).astype(np.uint16)
    text = PngInfo()
    text.add_text("RelativeMin", f"{low:.10g}")
    text.add_text("RelativeMax", f"{high:.10g}")
    text.add_text("Description", "relative inverse depth, near is large; no unit")
    with atomic_path(path) as temporary:
        Image.fromarray(levels).save(temporary, format="PNG", pnginfo=text)
    return low, high


def write_depth(
    path: str | Path,
    depth: np.ndarray,
    *,
    scale: float = PNG_SCALE_MILLIMETRE,
    beside: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write metres in the format of the suffix: .png (16 bits, see ``write_depth_png``), .npy or .npz (float32).

    Args:
        path: where to write; folders are made.
        depth: (height, width), metres.
        scale: PNG levels per metre; the other formats hold metres.
        beside: arrays kept under their names beside ``depth``, in .npz only.

    Raises:
        InputError: another suffix, or depth that is not two-dimensional.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".png":
        write_depth_png(path, depth, scale=scale)
        return
    if suffix not in (".npy", ".npz"):
        raise InputError(f"cannot write depth as {Path(path).name!r}: use .png (16 bits), .npy or .npz (float32)")
    depth = _check_depth(depth).astype(np.float32, copy=False)
    with atomic_path(path) as temporary:
        if suffix == ".npy":
            np.save(temporary, depth)
        else:
            arrays: dict[str, Any] = {"depth": depth, **(beside or {})}
            np.savez_compressed(temporary, **arrays)


def read_depth(path: str | Path, *, scale: float | None = None) -> DepthArray:
    """Read a depth map, float32 (height, width) in metres; 0 = no depth.

    Args:
        path: a 16-bit PNG, an .npy, or an .npz with an array called ``depth``.
        scale: PNG levels per metre; None takes the number that ``write_depth_png`` left in the file.

    Raises:
        InputError: missing or broken file, not one 16-bit channel, or a PNG whose scale nobody knows.
    """
    path = Path(path)
    if path.suffix.lower() in (".npy", ".npz"):
        try:
            loaded = np.load(path, allow_pickle=False)
            depth = loaded["depth"] if path.suffix.lower() == ".npz" else loaded
        except Exception as error:  # a broken zip or header can raise nearly anything
            raise InputError(f"cannot read depth from {path}: {error}") from error
        return _check_depth(depth).astype(np.float32, copy=False)
    with _open(path) as picture:
        if not picture.mode.startswith("I"):
            raise InputError(f"{path} is not a depth map: expected one 16-bit channel, found mode {picture.mode}")
        scale = scale or _scale_in(picture)
        if scale is None:
            raise InputError(f"{path} does not say its scale: pass scale=1000 for millimetres or scale=256 for KITTI's")
        return np.asarray(picture).astype(np.float32) / np.float32(scale)


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path to write to; it becomes ``path`` when the block ends well, and vanishes when it does not.

    The temporary file is in the same folder (made if need be), because only there is the renaming one step, and has
    the same suffix, because writers choose the format by it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{uuid4().hex}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _name(source: str | Path | BinaryFile) -> str:
    return str(source) if isinstance(source, str | Path) else str(getattr(source, "name", "the open file"))


def _open(source: str | Path | BinaryFile, *, max_pixels: int = MAX_PIXELS) -> Image.Image:
    """Open and decode, with one kind of error for everything that can be wrong with a file."""
    name = _name(source)
    if name.startswith(("http://", "https://")):
        raise InputError(f"{name} is an address, not a file: download it first")
    Image.init()
    try:
        picture = Image.open(source, formats=[known for known in _FORMATS if known in Image.OPEN])
        try:
            if picture.width * picture.height > max_pixels:
                raise InputError(
                    f"{name} has {picture.width} x {picture.height} pixels, over the limit of {max_pixels:,}: resize it"
                )
            picture.load()
        except BaseException:
            picture.close()
            raise
    except InputError:
        raise
    except (FileNotFoundError, IsADirectoryError, PermissionError) as error:
        raise InputError(f"{name} cannot be opened: {error.strerror}; check the path") from error
    except UnidentifiedImageError as error:
        raise InputError(f"{name} is not an image in a known format: convert it to JPEG or PNG") from error
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise InputError(f"{name} is too large to decode: resize it ({error})") from error
    except Exception as error:  # decoders raise nearly anything on a broken file, from struct.error to SyntaxError
        raise InputError(f"{name} cannot be read, it may be cut short or damaged: copy it again ({error})") from error
    return picture


def _scale_in(picture: Image.Image) -> float | None:
    """The scale in a PNG's text chunk, if it is there and is a number that can be one."""
    try:
        scale = float(picture.info[_SCALE_KEY])
    except (KeyError, TypeError, ValueError):
        return None
    return scale if np.isfinite(scale) and scale > 0 else None


def _from_pil(picture: Image.Image, name: str) -> ImageArray:
    try:
        picture.load()  # a PIL image handed in may not be decoded yet
        picture = _upright(picture)
        if picture.mode != "F" and not picture.mode.startswith("I"):
            picture = picture.convert("RGB")
        values = np.asarray(picture)
    except Exception as error:  # see ``_open``
        raise InputError(f"{name} cannot be converted from mode {picture.mode} to RGB: {error}") from error
    if values.dtype.kind == "i":  # mode "I" is how some decoders hand out 16 bits
        if values.size and (values.min() < 0 or values.max() > PNG_MAX):
            raise InputError(f"{name} has integers outside 0..65535: convert it to 8 or 16 bits")
        values = values.astype(np.uint16)
    return _from_array(values, name)


def _upright(picture: Image.Image) -> Image.Image:
    try:
        orientation = picture.getexif().get(_ORIENTATION_TAG)
    except Exception:  # broken EXIF says nothing about the pixels, which were decoded without it
        return picture
    return picture.transpose(_UPRIGHT[orientation]) if orientation in _UPRIGHT else picture


def _from_array(array: np.ndarray, name: str) -> ImageArray:
    """(H, W) or (H, W, 1|3|4), uint8, uint16 or float in [0, 1] -> image."""
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or array.shape[-1] not in (1, 3, 4):
        raise InputError(
            f"{name} has shape {array.shape}: expected (height, width) or (height, width, 1, 3 or 4); "
            "a torch tensor has its channels first, and a batch goes to Predictor.batch as a list"
        )
    if array.size == 0:
        raise InputError(f"{name} is empty: its shape is {array.shape}")
    array = _to_uint8(array[..., :3], name)  # a fourth channel is alpha
    return np.ascontiguousarray(np.broadcast_to(array, (*array.shape[:2], 3)))


def _to_uint8(array: np.ndarray, name: str) -> np.ndarray:
    if array.dtype == np.uint8:
        return array
    if array.dtype.kind == "u" and array.dtype.itemsize == 2:  # of either byte order
        return ((array.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if array.dtype.kind != "f":
        raise InputError(f"{name} has type {array.dtype}: expected uint8, uint16 or float in [0, 1]")
    low, high = float(array.min()), float(array.max())
    if not (low >= -1e-3 and high <= 1 + 1e-3):  # also when one of them is not a number
        raise InputError(f"{name} has values in [{low:.4g}, {high:.4g}]: scale floats to [0, 1], or pass uint8")
    return np.rint(array.astype(np.float32).clip(0, 1) * 255).astype(np.uint8)


def _channels_last(tensor: Any) -> np.ndarray:
    tensor = tensor.detach().cpu()
    if tensor.is_floating_point():
        tensor = tensor.float()  # numpy has no bfloat16
    array = tensor.numpy()
    if array.ndim == 3 and array.shape[0] not in (1, 3, 4):
        raise InputError(f"the tensor has shape {array.shape}: expected (channels, height, width), channels first")
    return np.moveaxis(array, 0, -1) if array.ndim == 3 else array


def _check_depth(depth: np.ndarray) -> np.ndarray:
    if not isinstance(depth, np.ndarray) or depth.ndim != 2 or depth.size == 0:
        raise InputError(f"a depth map is an array (height, width), got {getattr(depth, 'shape', type(depth))}")
    return depth
