"""A photo that somebody sent: what its header says, checked before a pixel is decoded; and the photo, decoded."""

import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import Literal, NamedTuple

from zoedepth.claims import AVIF_BRANDS, HEIC_BRANDS, HEIC_IS_READ, check_claims, media_brands
from zoedepth.errors import InputError, InputWarning, is_no_memory
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.choice import CameraChoice, known_without_notes
from zoedepth.geometry.exif import read_exif_camera
from zoedepth.images import ImageArray, read_image, read_image_with_notes
from zoedepth.pictures import is_whole_sphere, n_full_pages, open_picture
from zoedepth.serve.problems import Problem, sentence

MEDIA_TYPES = {
    "JPEG": "image/jpeg",
    "PNG": "image/png",
    "WEBP": "image/webp",
    "AVIF": "image/avif",
    "TIFF": "image/tiff",
    "BMP": "image/bmp",
    "GIF": "image/gif",
} | ({"HEIF": "image/heic"} if HEIC_IS_READ else {})
"""Format that is taken, as Pillow names it → its media type."""

_STARTS = {
    "JPEG": (b"\xff\xd8\xff",),
    "PNG": (b"\x89PNG\r\n\x1a\n",),
    "TIFF": (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
    "BMP": (b"BM",),
    "GIF": (b"GIF87a", b"GIF89a"),
}

_heard = threading.local()


class _Upload(BytesIO):
    """A photo in memory, with the name by which errors speak of it."""

    name = "the photo"


class Header(NamedTuple):
    """The claims of a photo's header."""

    format: str
    """Format, as Pillow names it."""
    size: tuple[int, int]
    """(height, width) of the photo as it is stored."""


class Decoded(NamedTuple):
    """A photo that is ready for the model."""

    image: ImageArray
    """The photo, RGB, upright."""
    camera: Camera | Literal["none"]
    """The camera that was asked for, or the one that the photo's notes tell; "none" where nobody knows it."""
    camera_note: str
    """The notes in a few words, see ``DepthMap.camera_note``."""
    warnings: tuple[str, ...]
    """Sentences about the photo, see ``read_image``."""


def check_photo(content: bytes, *, max_pixels: int) -> Header:
    """Look at the header of a photo; returns what it says.

    Raises:
        Problem: it is no photo in a format that is taken, is damaged, has too many pixels, or several frames.
    """
    kind = _format(content[:64])
    taken = ", ".join(MEDIA_TYPES)
    if kind is None:
        raise Problem("unsupported-format", f"It does not begin as a photo does. These formats are taken: {taken}.")
    file = _Upload(content)
    try:
        check_claims(file)
        with open_picture(file, (kind,)) as picture:
            width, height = picture.size
            sphere = is_whole_sphere(picture) and abs(max(width, height) - 2 * min(width, height)) <= 2
            animated = kind != "JPEG" and getattr(picture, "is_animated", False)
            n_frames = n_full_pages(picture) if kind == "TIFF" else 2 if animated else 1
    except Exception as error:  # readers raise nearly anything on a damaged header
        if is_no_memory(error):
            raise
        raise Problem(
            "unreadable-photo", f"The photo cannot be read, it may be cut short or damaged: {error}"
        ) from error
    if width * height > max_pixels:
        raise Problem(
            "too-many-pixels", f"The photo has {width} x {height} pixels, more than {max_pixels:,}. Send it resized."
        )
    if n_frames > 1:
        raise Problem("several-frames", "The file has several frames or pages. Send the one that you need.")
    if sphere:
        raise Problem(
            "panorama",
            "It is a panorama of 360 x 180 degrees, and a model takes it for an ordinary photo. `zoedepth predict` "
            "looks at it in parts.",
        )
    return Header(kind, (height, width))


def decode_photo(content: bytes, camera: CameraChoice, *, max_pixels: int) -> Decoded:
    """Decode a photo as ``zoedepth predict`` does.

    Args:
        content: the photo's file; ``check_photo`` has passed it.
        camera: the camera that was asked for, or "exif" for that of the photo's notes.
        max_pixels: pixels, at most.

    Raises:
        Problem: it cannot be read.
        InputError: the camera that was asked for is that of no photo of this size.
    """
    file = _Upload(content)
    _heard.warnings = heard = []
    try:
        if camera == "exif":
            image, notes = read_image_with_notes(file, max_pixels=max_pixels)
            known = read_exif_camera(notes, (image.shape[0], image.shape[1]))
            return Decoded(image, known.camera or "none", known.reason, tuple(heard))
        image = read_image(file, max_pixels=max_pixels)
    except InputError as error:
        raise Problem("unreadable-photo", sentence(error)) from error
    finally:
        _heard.warnings = None
    return Decoded(image, _camera(camera, (image.shape[0], image.shape[1])), "", tuple(heard))


@contextmanager
def hear_warnings() -> Iterator[None]:
    """Let ``decode_photo`` tell the client what reading a photo warns of, until the block ends."""
    before = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *rest: object) -> None:
        if issubclass(category, InputWarning):  # the model is given an array, of which the same is said again
            if (heard := getattr(_heard, "warnings", None)) is not None:
                heard.append(str(message))
        else:
            # Handed on as it came: *rest has the types that Python's own showwarning takes.
            before(message, category, *rest)  # pyright: ignore[reportArgumentType]

    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = show
        yield


def _camera(choice: CameraChoice, size: tuple[int, int]) -> Camera | Literal["none"]:
    """Return the camera of a photo of ``size`` (height, width)."""
    return known_without_notes(choice, size) or "none"


def _format(start: bytes) -> str | None:
    """Return the format that a file has by its first bytes; None for one that is not taken."""
    for kind, prefixes in _STARTS.items():
        if start.startswith(prefixes):
            return kind
    if start[:4] == b"RIFF" and start[8:12] == b"WEBP":
        return "WEBP"
    brands = media_brands(start)
    if brands & AVIF_BRANDS:
        return "AVIF"
    return "HEIF" if HEIC_IS_READ and brands & HEIC_BRANDS else None
