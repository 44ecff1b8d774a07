"""Photographs in, pictures out.

Every photograph that enters the package, as a file, a PIL image, an array or a tensor, becomes an ``image``: uint8,
(height, width, 3), RGB, upright. Every file that leaves the package is written whole or not at all (``atomic_path``).
"""

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image, UnidentifiedImageError

from zoedepth.claims import HEIC_IS_READ, BinaryFile, check_claims
from zoedepth.errors import InputError, InputWarning, is_no_memory
from zoedepth.moved import moved_name
from zoedepth.pictures import PhotoNotes, has_whole_exif, is_panorama, n_full_pages, open_picture, read_exif, read_notes

ImageArray = UInt8[np.ndarray, "_height _width 3"]
DepthArray = Float32[np.ndarray, "_height _width"]

IMAGE_SUFFIXES = frozenset({".heic", ".heif", ".hif"} if HEIC_IS_READ else ()) | frozenset(
    {".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".tif", ".tiff", ".webp", ".avif", ".bmp", ".dib"}
    | {".gif", ".ppm", ".pgm", ".pbm", ".pnm", ".jp2", ".j2k", ".tga"}
)
"""Suffixes (lower case) by which a photograph is recognised in a folder."""

PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
"""Suffixes that ``write_image`` writes."""

MAX_PIXELS = 178_956_970
"""The largest picture that is decoded, where Pillow itself refuses: about 180 megapixels, or 0.5 GB of RGB."""

OWN_MARK = "made by zoedepth"
"""EXIF's "Software" in the pictures that ``write_image`` writes, by which they are known not to be photographs."""

FORMATS = ("JPEG", "PNG", "TIFF", "WEBP", "AVIF", "BMP", "DIB", "GIF", "PPM", "JPEG2000", "HEIF", "TGA")
"""Formats of photos, as Pillow names them: one by one, for Pillow runs Ghostscript to read EPS, a program."""

PNG_SCALE_MILLIMETRE = 1000.0
PNG_SCALE_KITTI = 256.0
PNG_MAX = 65535

# A file may unpack to _FREE_BYTES, and beyond that to _MAX_RATIO times its size. Screenshots of 8K and pages at 600 dpi
# pass however well they compress; photographs unpack to 2 to 20 times their size, a black one to 200 times.
_FREE_BYTES, _MAX_RATIO = 105_000_000, 256
_RATIOS = {"TGA": 16}  # nobody stores photos so; renders with large flat parts unpack to a few times their size
# Bytes of a pixel that count, where they are not 3. Reading most formats takes 7 (4 in Pillow, 3 in the image); these
# decoders keep more copies, 16, 9, 19 and 8 bytes as measured, and count in proportion.
_BYTES = {"WEBP": 7, "AVIF": 4, "JPEG2000": 8, "HEIF": 4}
_ANIMATED = ("GIF", "PNG", "WEBP", "AVIF")
_MAX_STREAM = 1 << 29  # bytes
_DIM_16_BITS = 1 << 14  # with a largest value below, 16 bits hold 14 or fewer
_DARK, _PLAIN = 16, 4  # of 255: a largest value below, and a spread below
_BAND = 1 << 18  # pixels that are converted at once
# TIFF's tags of the size of a tile, and the pixels of a tile that are always allowed.
_TILE_WIDTH_TAG, _TILE_HEIGHT_TAG, _MAX_TILE = 322, 323, 4096 * 4096
# EXIF orientation -> the transposition that turns the picture upright (EXIF 2.3, tag 0x0112).
_ORIENTATION_TAG, _SOFTWARE_TAG = 0x0112, 0x0131
_PHOTOMETRIC_TAG = 262  # of a TIFF: 0 where 0 is white
_UPRIGHT = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}


def read_image(
    source: str | Path | BinaryFile, *, max_pixels: int = MAX_PIXELS, photo: bool = True, panorama: bool = False
) -> ImageArray:
    """Read a photograph as uint8 (height, width, 3), RGB, [0, 255], turned upright by its EXIF orientation.

    Grey is repeated to three channels; palette, CMYK and YCbCr are converted; colour profiles are ignored. Alpha is
    dropped, not composited: the colours under it are kept, and no edge is invented. 16-bit grey spans 0..65535; float
    TIFF must be in [0, 1]. The first of several frames is read, and the full picture where there are previews, masks, a
    second view, a gain map or a depth map beside it.

    Args:
        source: a path, or a binary file open for reading.
        max_pixels: the most pixels (height * width) a file may claim; one with more is refused before it is decoded.
        photo: False for a mask or a map that is stored as a picture: then nothing is said about what shows in it.
        panorama: True where a panorama is expected: then nothing is said about its being one.

    Raises:
        InputError: the file is missing, not an image, cut short, too large, far too small for the pixels it claims, or
            in a mode that has no meaning here.

    Warns:
        InputWarning: it is nearly black or of one colour, has 16 bits and uses 14 or fewer, has several pages or
            frames, or is a panorama.
    """
    return _read(source, max_pixels=max_pixels, photo=photo, panorama=panorama)[0]


def read_image_with_orientation(
    source: str | Path | BinaryFile, *, max_pixels: int = MAX_PIXELS
) -> tuple[ImageArray, int]:
    """Read a photograph as ``read_image`` does; returns the EXIF orientation by which it was turned upright, too."""
    return _read(source, max_pixels=max_pixels)


def read_image_with_notes(
    source: str | Path | BinaryFile, *, max_pixels: int = MAX_PIXELS
) -> tuple[ImageArray, PhotoNotes]:
    """Read a photograph as ``read_image`` does; returns what its file says about it, too: see ``PhotoNotes``."""
    picture, orientation, notes = _open(source, max_pixels=max_pixels, notes=True)
    with picture:
        return _from_upright(picture, _name(source)), replace(notes, orientation=orientation)


def read_photo_notes(source: str | Path | BinaryFile) -> PhotoNotes:
    """Return what a photo's file says about the photo, without decoding the photo.

    Raises:
        InputError: it is no picture; see ``read_image``.
    """
    picture, _, notes = _open(source, decode=False, notes=True)
    with picture:
        return notes


def read_stored_size(source: str | Path | BinaryFile) -> tuple[int, int]:
    """Return (height, width) of a photo as it is stored, before it is turned upright, without decoding it.

    Raises:
        InputError: it is no picture; see ``read_image``.
    """
    picture, _, _ = _open(source, decode=False)
    with picture:
        return picture.height, picture.width


def to_image_with_notes(source: Any) -> tuple[ImageArray, PhotoNotes]:
    """Turn anything that holds a picture into an image, as ``to_image`` does; returns its notes, too.

    Arrays and tensors have none.
    """
    if isinstance(source, str | os.PathLike) or hasattr(source, "read"):
        return read_image_with_notes(Path(source) if isinstance(source, os.PathLike) else source)
    notes = read_notes(source) if isinstance(source, Image.Image) else PhotoNotes()
    return to_image(source), notes


def to_image(source: Any, *, upright: bool = True) -> ImageArray:
    """Turn anything that holds a picture into an image: uint8 (height, width, 3), RGB, [0, 255].

    Args:
        source: a path or open file (see ``read_image``); a ``PIL.Image.Image``; a numpy array (H, W) or (H, W, 1|3|4),
            RGB, uint8, uint16 (0..65535) or float in [0, 1]; a torch tensor (H, W) or (1|3|4, H, W) of the same types.
            Floats are rounded to 8 bits, so that a photograph gives the same depth whichever way it comes in. BGR, as
            OpenCV has it, cannot be told from RGB: turn it round, ``image[..., ::-1]``. Floats in linear light cannot
            be told from those of a screen (sRGB), which are expected.
        upright: False leaves a PIL image as it is stored, whatever its EXIF orientation.

    Warns:
        InputWarning: see ``read_image``.

    Raises:
        InputError: another type, shape or range; the message says what is expected.
    """
    if isinstance(source, str | os.PathLike) or hasattr(source, "read"):
        return read_image(Path(source) if isinstance(source, os.PathLike) else source)
    if isinstance(source, Image.Image):
        return _from_pil(source, "the PIL image", upright=upright)
    if isinstance(source, np.ndarray):
        return _from_array(source, "the array")
    torch = sys.modules.get("torch")  # imported already if this is a tensor; others should not wait for it
    if torch is not None and isinstance(source, torch.Tensor):
        return _from_array(_channels_last(source), "the tensor")
    raise InputError(
        f"cannot read an image from {type(source).__name__}: pass a path, an open file, a PIL image, "
        "a numpy array (H, W, 3) or a torch tensor (3, H, W)"
    )


def write_image(path: str | Path, image: ImageArray) -> None:
    """Write a uint8 RGB picture in the format of the suffix (JPEG at quality 92), whole or not at all.

    It is for pictures that show something about photos: they say in their EXIF that they are none (``OWN_MARK``).

    Raises:
        InputError: a suffix that is not .jpg, .jpeg, .png or .webp.
    """
    if Path(path).suffix.lower() not in PICTURE_SUFFIXES:
        raise InputError(f"cannot write a picture as {Path(path).name!r}: use one of {', '.join(PICTURE_SUFFIXES)}")
    exif = Image.Exif()
    exif[_SOFTWARE_TAG] = OWN_MARK
    with atomic_path(path) as temporary:
        Image.fromarray(image).save(temporary, quality=92, exif=exif)


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path to write to. It becomes ``path`` when the block ends well, and is removed when it does not.

    The temporary file is in the same folder (made if need be), because only there is renaming one step. It has the same
    suffix, because writers choose the format by it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{uuid4().hex}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _read(
    source: str | Path | BinaryFile, *, max_pixels: int, photo: bool = True, panorama: bool = False
) -> tuple[ImageArray, int]:
    picture, orientation, _ = _open(source, max_pixels=max_pixels, photo=photo, panorama=panorama)
    with picture:
        return _from_upright(picture, _name(source), photo=photo), orientation


def _name(source: str | Path | BinaryFile) -> str:
    return str(source) if isinstance(source, str | Path) else str(getattr(source, "name", "the open file"))


def _is_stream(path: Path) -> bool:
    """Return True for what is there and is neither a file nor a folder, such as a named pipe."""
    return path.exists() and not path.is_file() and not path.is_dir()


def _open(
    source: str | Path | BinaryFile,
    *,
    max_pixels: int = MAX_PIXELS,
    decode: bool = True,
    notes: bool = False,
    photo: bool = True,
    panorama: bool = False,
) -> tuple[Image.Image, int, PhotoNotes]:
    """Open, decode and turn a picture (``load_upright``), with one kind of error for whatever is wrong with a file.

    Its notes are read if they are asked for.
    """
    name = _name(source)
    if name.startswith(("http://", "https://")):
        raise InputError(f"{name} is an address, not a file: download it first")
    if isinstance(source, str | Path) and _is_stream(Path(source)):
        raise InputError(
            f"{name} is a pipe or a device, which can be read but once: save the photo as a file, or send it to "
            "standard input (zoedepth predict - --out -)"
        )
    try:
        with open(source, "rb") if isinstance(source, str | Path) else nullcontext(source) as file:
            file = _seekable(file)
            _check_claims(file, name)
            picture = open_picture(file, FORMATS)
            _check_size(picture, file, name, max_pixels)
            check_tiles(picture)
            found = read_notes(picture) if notes else PhotoNotes()
            orientation = found.orientation
            if decode:
                _warn_of_more(picture, name, panorama=panorama)
                deep = any(";16" in str(tile[3]) for tile in getattr(picture, "tile", ()))
                white_is_0 = getattr(picture, "tag_v2", {}).get(_PHOTOMETRIC_TAG) == 0
                picture, orientation = load_upright(picture)
                if photo and white_is_0 and picture.mode.startswith("I;16"):  # of 8 bits Pillow turns it round
                    picture = Image.fromarray(PNG_MAX - np.asarray(picture, np.uint16))
                if photo and deep:
                    _warn_if_colours_are_dim(picture, name)
    except InputError:
        raise
    except (FileNotFoundError, IsADirectoryError, PermissionError) as error:
        raise InputError(f"{name} cannot be opened: {error.strerror}; check the path") from error
    except UnidentifiedImageError as error:
        raise InputError(f"{name} is not an image in a known format: convert it to JPEG or PNG") from error
    except Exception as error:  # decoders raise nearly anything on a broken file, from struct.error to SyntaxError
        if is_no_memory(error):
            raise
        raise InputError(f"{name} cannot be read, it may be cut short or damaged: copy it again ({error})") from error
    return picture, orientation, found


def _seekable(file: BinaryFile) -> BinaryFile:
    """Return a file that can be gone through twice: streams of the web and of other programs cannot."""
    if file.seekable():
        file.seek(0)
        return file
    content = file.read(_MAX_STREAM + 1)
    if len(content) > _MAX_STREAM:
        raise ValueError(f"the stream is longer than {_MAX_STREAM:,} bytes")
    return BytesIO(content)


def _warn_of_more(picture: Image.Image, name: str, *, panorama: bool) -> None:
    """Say that a file holds more than the picture that is read, or another kind of picture than a model is for."""
    if n_full_pages(picture) > 1 or (picture.format in _ANIMATED and getattr(picture, "is_animated", False)):
        _warn(f"{name} has several pages or frames, and the first is read. Save each as a photo of its own")
    if not has_whole_exif(picture):
        _warn(
            f"{name} has damaged EXIF. Where that says how the photo lies, or its camera, this may be lost: look at "
            "the photo, and turn it if it lies on its side"
        )
    if not panorama and is_panorama(picture):
        _warn(
            f"{name} is a panorama, by its own notes: models take it for an ordinary photo, and its depth will be "
            "wrong. Where it is a whole sphere, --panorama (zoedepth.predict_panorama) looks at it in parts"
        )


def _warn(message: str) -> None:
    warnings.warn(message, InputWarning, stacklevel=2)


def _check_claims(file: BinaryFile, name: str) -> None:
    try:
        check_claims(file)
    except ValueError as error:
        raise InputError(f"{name} is no ordinary photo: {error}") from error


def _check_size(picture: Image.Image, file: BinaryFile, name: str, max_pixels: int) -> None:
    """Refuse, before it is decoded, a picture that would take memory or time out of proportion to its file."""
    n_pixels = picture.width * picture.height
    claim = f"{name} has {picture.width} x {picture.height} pixels"
    if n_pixels > max_pixels:
        raise InputError(f"{claim}, over the limit of {max_pixels:,}: resize it")
    place = file.tell()
    try:
        unpacked = _BYTES.get(picture.format or "", 3) * n_pixels
        check_expansion(unpacked, file.seek(0, os.SEEK_END), ratio=_RATIOS.get(picture.format or "", _MAX_RATIO))
    except ValueError as error:
        raise InputError(f"{claim}: {error}. Resize it, or save it with less compression") from error
    file.seek(place)


def as_array(picture: Image.Image, mode: str) -> np.ndarray:
    """Return the values of a picture in another mode. Only bands of it are copied on the way: that is twice as fast."""
    n_rows = max(1, _BAND // max(1, picture.width))

    def band(top: int, bottom: int) -> Image.Image:
        part = picture.crop((0, top, picture.width, bottom))
        part.info.pop("transparency", None)  # it is dropped, and Pillow warns of it in palettes
        return part.convert(mode)

    values = np.asarray(band(0, min(n_rows, picture.height)))
    if n_rows >= picture.height:
        return values
    values = np.empty((picture.height, *values.shape[1:]), values.dtype)
    for top in range(0, picture.height, n_rows):
        bottom = min(top + n_rows, picture.height)
        values[top:bottom] = band(top, bottom)
    return values


def check_expansion(unpacked: int, packed: int, *, ratio: int = _MAX_RATIO) -> None:
    """Refuse a file that unpacks to far more than it is large.

    Args:
        unpacked: bytes that its content takes in memory.
        packed: bytes of the file.
        ratio: how many times its size a file may unpack to, where that is more than 105 MB.

    Raises:
        ValueError: it does; the message says by how much, and is to be put behind the name of the file.
    """
    if unpacked > max(_FREE_BYTES, ratio * packed):
        raise ValueError(
            f"{packed:,} bytes would unpack to {unpacked:,}; a file that unpacks to more than {ratio} times its size "
            f"may have at most {_FREE_BYTES:,} bytes of content"
        )


def check_tiles(picture: Image.Image) -> None:
    """Refuse a TIFF whose tiles are far larger than the picture: each tile is unpacked whole.

    Raises:
        ValueError: a tile has more pixels than the picture, and than 4096 x 4096.
    """
    tags = getattr(picture, "tag_v2", {})
    width, height = (int(tags.get(tag, 0)) for tag in (_TILE_WIDTH_TAG, _TILE_HEIGHT_TAG))
    if width * height > max(_MAX_TILE, picture.width * picture.height):
        raise ValueError(f"its tiles of {width} x {height} pixels are larger than the picture")


def _from_pil(picture: Image.Image, name: str, *, upright: bool) -> ImageArray:
    try:
        if upright:
            picture, _ = load_upright(picture)  # a PIL image handed in may not be decoded yet
        else:
            picture.load()
    except Exception as error:  # see ``_open``
        if is_no_memory(error):
            raise
        raise InputError(f"{name} cannot be converted from mode {picture.mode} to RGB: {error}") from error
    return _from_upright(picture, name)


def _from_upright(picture: Image.Image, name: str, *, photo: bool = True) -> ImageArray:
    try:
        values = as_array(picture, picture.mode if picture.mode == "F" or picture.mode.startswith("I") else "RGB")
    except Exception as error:  # see ``_open``
        if is_no_memory(error):
            raise
        raise InputError(f"{name} cannot be converted from mode {picture.mode} to RGB: {error}") from error
    if values.dtype.kind == "i":  # mode "I" is how some decoders hand out 16 bits
        if values.size and (values.min() < 0 or values.max() > PNG_MAX):
            raise InputError(f"{name} has integers outside 0..65535: convert it to 8 or 16 bits")
        values = values.astype(np.uint16)
    return _from_array(values, name, photo=photo)


def load_upright(picture: Image.Image) -> tuple[Image.Image, int]:
    """Decode a picture, and turn it upright by its EXIF orientation; returns that, too: 1 where nothing is turned."""
    # A TIFF is turned when it is decoded, and a HEIC, too.
    by_pillow = getattr(picture, "tag_v2", {}).get(_ORIENTATION_TAG, picture.info.get("original_orientation"))
    picture.load()
    try:
        orientation = read_exif(picture).get(_ORIENTATION_TAG)
    except Exception:  # broken EXIF says nothing about the pixels, which were decoded without it
        orientation = None
    if orientation in _UPRIGHT:
        return picture.transpose(_UPRIGHT[orientation]), orientation
    return picture, by_pillow if by_pillow in _UPRIGHT else 1


def _from_array(array: np.ndarray, name: str, *, photo: bool = True) -> ImageArray:
    """Turn (H, W) or (H, W, 1|3|4) of uint8, uint16 or float in [0, 1] into an image."""
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or array.shape[-1] not in (1, 3, 4):
        raise InputError(
            f"{name} has shape {array.shape}: expected (height, width) or (height, width, 1, 3 or 4); "
            "a torch tensor has its channels first, and a batch goes to Predictor.batch as a list"
        )
    if array.size == 0:
        raise InputError(f"{name} is empty: its shape is {array.shape}")
    array = array[..., :3]  # a fourth channel is alpha
    dim = photo and _warn_if_dim(array, name)
    array = _to_uint8(array, name)
    if photo and not dim:
        _warn_if_nothing_shows(array, name)
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
        raise InputError(
            f"{name} has values in [{low:.4g}, {high:.4g}]: scale floats to [0, 1], or pass uint8. "
            "Linear light must be brought to the values of a screen (sRGB) first"
        )
    return np.rint(array.astype(np.float32).clip(0, 1) * 255).astype(np.uint8)


_LOOK = 256  # rows and columns of a picture that are looked at


def _warn_if_dim(array: np.ndarray, name: str) -> bool:
    """Say so where 16 bits hold a picture of fewer bits, as those of thermal and industrial cameras do."""
    if array.dtype.kind != "u" or array.dtype.itemsize != 2 or not (largest := int(array.max())):
        return False
    if largest < _DIM_16_BITS:
        _warn_of_dim(name, f"its largest value is {largest}", PNG_MAX // largest)
        return True
    # A few pixels of a sensor may be saturated, or dead.
    some = array[:: 1 + array.shape[0] // _LOOK, :: 1 + array.shape[1] // _LOOK]
    most = int(np.percentile(some, 99))
    if not 0 < most < _DIM_16_BITS // 4:
        return False
    _warn_of_dim(name, f"nearly all of its values are at most {most}", PNG_MAX // most)
    return True


def _warn_if_colours_are_dim(picture: Image.Image, name: str) -> None:
    """Say the same of colours of 16 bits, of which Pillow keeps the upper 8. What is darker is nearly black."""
    if picture.mode not in ("RGB", "RGBA"):
        return
    extrema: Any = picture.getextrema()
    largest = max(high for _, high in extrema[:3])
    if _DARK <= largest < _DIM_16_BITS >> 8:
        _warn_of_dim(name, f"its largest value is below {largest + 1 << 8}", PNG_MAX // ((largest + 1 << 8) - 1))


def _warn_of_dim(name: str, found: str, factor: int) -> None:
    _warn(
        f"{name} is too dark: it has 16 bits, read as 0 to {PNG_MAX}, and {found}. Stretch it first: multiply its "
        f"values by {factor}"
    )


def _warn_if_nothing_shows(image: UInt8[np.ndarray, "height width channels"], name: str) -> None:
    """Say so where a picture is nearly black or of one colour: a look at 64 x 64 pixels clears most others."""
    some = image[:: 1 + image.shape[0] // 64, :: 1 + image.shape[1] // 64]
    if some.max() < _DARK and image.max() < _DARK:
        _warn(
            f"{name} is nearly black: its largest value is {image.max()} of 255. Brighten it; where a camera of fewer "
            "bits wrote it, stretch its values to the whole range"
        )
    elif np.ptp(some, axis=(0, 1)).max() < _PLAIN and np.ptp(image, axis=(0, 1)).max() < _PLAIN:
        _warn(f"{name} is nearly of one colour. Nothing can be seen in it, and its depth says nothing")


def _channels_last(tensor: Any) -> np.ndarray:
    tensor = tensor.detach().cpu()
    if tensor.is_floating_point():
        tensor = tensor.float()  # numpy has no bfloat16
    array = tensor.numpy()
    if array.ndim == 3 and array.shape[0] not in (1, 3, 4):
        raise InputError(f"the tensor has shape {array.shape}: expected (channels, height, width), channels first")
    return np.moveaxis(array, 0, -1) if array.ndim == 3 else array


def __getattr__(name: str) -> object:
    return moved_name(__name__, name)
