"""The picture in a file, opened by Pillow's readers: the full one, whatever else the file holds."""

import re
import struct
import warnings
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from itertools import count
from typing import NamedTuple

from PIL import ExifTags, Image, UnidentifiedImageError
from PIL.JpegImagePlugin import JpegImageFile

from zoedepth.claims import HEIC_IS_READ, BinaryFile

# TIFF's tag of the kind of a page, NewSubfileType, with the bits of previews and masks; and its predecessor's value.
_KIND_TAG, _PREVIEW_OR_MASK, _OLD_KIND_TAG, _OLD_PREVIEW = 254, 0b101, 255, 2
_MAX_NOTES = 1 << 20  # bytes of the texts and the profile of a PNG together, unpacked: what Pillow allows for one
_MAX_UNPACKED = 64 * _MAX_NOTES  # bytes that are unpacked to find that out
_VALUE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}  # of EXIF's types
# In XMP, as attributes or as elements (DJI, "Drone Image Metadata", and exiftool's list of its XMP).
_CALIBRATED = {b"FocalLength": "focal", b"OpticalCenterX": "x", b"OpticalCenterY": "y"}
_CALIBRATION = re.compile(
    rb"drone-dji:Calibrated(FocalLength|OpticalCenter[XY])\s{0,9}(?:=\s{0,9}[\"']|>)\s{0,9}([-+.\deE]{1,32})"
)
_PANORAMA = b"GPano:ProjectionType"  # in XMP, of spheres and of strips
_PROJECTION = re.compile(_PANORAMA + rb"\s{0,9}(?:=\s{0,9}[\"']|>)\s{0,9}([A-Za-z]{1,32})")
_PART_OF_PANORAMA = re.compile(
    rb"GPano:(CroppedAreaImage|FullPano)(Width|Height)Pixels\s{0,9}(?:=\s{0,9}[\"']|>)\s{0,9}(\d{1,9})"
)


@dataclass(frozen=True)
class PhotoNotes:
    """The notes in a photo's file beside its pixels. Anybody may have written it, and it may be wrong."""

    tags: Mapping[int, object] = field(default_factory=dict)
    """EXIF's values by the numbers of their tags, those of the main and those of the Exif directory together. The
    values are as Pillow reads them; none is checked."""
    orientation: int = 1
    """EXIF orientation, 1 to 8, by which the photo is turned upright; 1 where nothing or nonsense is said."""
    panorama: bool = False
    """True if XMP says that it is a panorama: a sphere, a part of one, or a strip."""
    sphere: bool = False
    """True if XMP says that it is a whole sphere; see ``is_whole_sphere``."""
    calibration: Mapping[str, float] = field(default_factory=dict)
    """Numbers of the maker's own calibration of the camera that XMP has, as DJI's drones write them: "focal" (length),
    and "x" and "y" of the middle of the lens, all in pixels of the photo as it was taken, from its corner."""
    damage: str = ""
    """The reason why its EXIF could not be read, or not all of it; empty where nothing is wrong."""


def read_notes(picture: Image.Image) -> PhotoNotes:
    """Return what a picture's file says about it. Ask before it is decoded: a TIFF forgets how it was turned.

    Broken notes raise nothing; see ``PhotoNotes.damage``.
    """
    tags: dict[int, object] = {}
    damage = ""
    try:
        exif = read_exif(picture)
        tags |= exif
        tags |= exif.get_ifd(ExifTags.IFD.Exif)
    except Exception as error:  # Pillow raises nearly anything on broken EXIF, from struct.error to SyntaxError
        damage = str(error) or type(error).__name__
    # A HEIC is turned as it is opened, and keeps what it was turned by.
    orientation = picture.info.get("original_orientation") or tags.get(ExifTags.Base.Orientation)
    if not isinstance(orientation, int) or not 1 <= orientation <= 8:
        orientation = 1
    return PhotoNotes(tags, orientation, is_panorama(picture), is_whole_sphere(picture), _calibration(picture), damage)


def read_exif(picture: Image.Image) -> Image.Exif:
    """Return a picture's EXIF as Pillow's ``getexif`` does, without its warnings of damage, which name no file.

    Of damaged EXIF it has what stands before the damage, and the orientation wherever it stands. Pillow raises nearly
    anything where nothing can be read at all.
    """
    if has_whole_exif(picture):
        return picture.getexif()
    with warnings.catch_warnings():  # other threads may warn meanwhile: this silences nothing but damaged EXIF
        damage = r"(Possibly c|C)orrupt EXIF|Truncated File Read|Tag (data|offset)"
        warnings.filterwarnings("ignore", damage, UserWarning)
        exif = picture.getexif()
        with suppress(Exception):
            exif.get_ifd(ExifTags.IFD.Exif)  # Pillow keeps it, so that nothing is read later
    if (orientation := _walk(picture.info["exif"]).orientation) is not None:
        exif.setdefault(ExifTags.Base.Orientation, orientation)
    return exif


def has_whole_exif(picture: Image.Image) -> bool:
    """Return False if directories or values of a picture's EXIF lie beyond its end, as where a program cut it short."""
    content = picture.info.get("exif")
    return not isinstance(content, bytes) or _walk(content).whole


class _Walk(NamedTuple):
    """The findings of a walk through the directories of EXIF."""

    whole: bool
    """False where a directory or a value lies beyond the end."""
    orientation: int | None


def _walk(content: bytes) -> _Walk:
    """Walk through the main directory of EXIF, and through the Exif directory that it names."""
    if not (content := content.removeprefix(b"Exif\0\0")):
        return _Walk(True, None)
    order = "<" if content.startswith(b"II") else ">"
    whole, orientation = True, None
    try:
        places = [struct.unpack_from(order + "I", content, 4)[0]]
        for place in places:  # one more may be found on the way
            (n_tags,) = struct.unpack_from(order + "H", content, place)
            for entry in range(place + 2, place + 2 + 12 * n_tags, 12):
                tag, kind, count, value = struct.unpack_from(order + "HHII", content, entry)
                n_bytes = _VALUE_BYTES.get(kind, 0) * count
                whole &= n_bytes <= 4 or value + n_bytes <= len(content)
                if tag == ExifTags.IFD.Exif and len(places) == 1:
                    places.append(value)
                elif tag == ExifTags.Base.Orientation and kind == 3:  # a short number stands in the entry itself
                    (orientation,) = struct.unpack_from(order + "H", content, entry + 8)
            struct.unpack_from(order + "I", content, place + 2 + 12 * n_tags)  # the place of the next directory
    except struct.error:
        whole = False
    return _Walk(whole, orientation)


def is_panorama(picture: Image.Image) -> bool:
    """Return True if the XMP of a picture says that it is a panorama."""
    return _xmp(picture).find(_PANORAMA) >= 0


def is_whole_sphere(picture: Image.Image) -> bool:
    """Return True if the XMP of a picture says that it is an equirectangular panorama, and no part cut out of one."""
    notes = _xmp(picture)
    projection = _PROJECTION.search(notes)
    if projection is None or projection[1].lower() != b"equirectangular":
        return False
    pixels = {(kind, side): int(number) for kind, side, number in _PART_OF_PANORAMA.findall(notes)}
    return all(
        pixels.get((b"CroppedAreaImage", side)) in (None, whole)
        for (kind, side), whole in pixels.items()
        if kind == b"FullPano"
    )


def _xmp(picture: Image.Image) -> bytes:
    notes = picture.info.get("xmp", b"")
    return notes if isinstance(notes, bytes) else str(notes).encode()


def _calibration(picture: Image.Image) -> dict[str, float]:
    """Return ``PhotoNotes.calibration``; what is no number, or said in several ways, is left out."""
    found = {_CALIBRATED[name]: number for name, number in _CALIBRATION.findall(_xmp(picture))}
    numbers = {}
    for name, text in found.items():
        with suppress(ValueError):
            numbers[name] = float(text)
    return numbers


def open_picture(file: BinaryFile, formats: Iterable[str]) -> Image.Image:
    """Open the picture of a file as ``PIL.Image.open`` does. Nothing is decoded yet.

    Of a TIFF it is the first page that is no preview and no mask. The first is the full one in all other formats: JPEGs
    with a second view, a depth map or a gain map behind it (MPO, Ultra HDR), animations. HEIC says which is the main
    one.

    Pillow warns of pictures of more than 90 megapixels, and refuses texts and profiles of a PNG of more than 1 MB. Both
    would hit sound files, so neither is so here: the caller looks at the size, and large texts are passed over.

    Args:
        file: a file that ``check_claims`` has passed.
        formats: Pillow's names of the formats that are tried.

    Raises:
        UnidentifiedImageError: it has another format. Readers raise nearly anything else on a damaged file.
    """
    Image.init()
    file.seek(0)
    start = file.read(16)
    if start.startswith(b"\x89PNG"):
        file = _without_large_notes(file)
    for name in formats:
        if name == "HEIF":
            if start[4:8] == b"ftyp" and HEIC_IS_READ:
                return _open_heic(file)
            continue
        if name not in Image.OPEN:  # this Pillow was built without it
            continue
        reader, accepts = Image.OPEN[name]
        verdict = accepts is None or accepts(start)
        if not verdict or isinstance(verdict, str):  # a text says why it cannot be read here
            continue
        if name == "JPEG":
            reader = _Jpeg  # the registered one looks for further pictures, and warns where they are damaged
        file.seek(0)
        try:
            picture = reader(file, "")
        except (SyntaxError, IndexError, TypeError, struct.error):  # as Pillow says that it is another format after all
            continue
        if name == "TIFF":
            _seek_full_page(picture)
        return picture
    raise UnidentifiedImageError("it is no picture in a known format")


class _Jpeg(JpegImageFile):
    """Pillow's reader, which leaves EXIF alone: it would look there for the dots per inch, and warn of damage."""

    def _read_dpi_from_exif(self) -> None:
        pass


def _open_heic(file: BinaryFile) -> Image.Image:
    """Open the main picture of a HEIC; it is turned upright as it is decoded."""
    from pillow_heif import HeifImageFile

    file.seek(0)
    try:
        return HeifImageFile(file, "")
    except SyntaxError as error:
        raise ValueError(f"no readable HEIC: {error}") from error


def n_full_pages(picture: Image.Image, *, most: int = 2) -> int:
    """Return how many pages of a TIFF are neither previews nor masks, counted up to ``most``; 1 for other formats."""
    if picture.format != "TIFF" or not getattr(picture, "is_animated", False):
        return 1
    here, found = picture.tell(), 1
    for page in count(here + 1):
        if found >= most or not _go_to(picture, page):
            break
        found += not _is_preview(picture)
    picture.seek(here)
    return found


def _seek_full_page(picture: Image.Image) -> None:
    for page in count(1):
        if not _is_preview(picture):
            break
        if not _go_to(picture, page):
            picture.seek(0)  # they are all said to be previews, so the first is as good as any
            break


def _go_to(picture: Image.Image, page: int) -> bool:
    """Go to a page, also to one that cannot be read itself, as some masks; returns False behind the last."""
    try:
        picture.seek(page)
    except EOFError:
        return False
    except SyntaxError:
        pass
    return True


def _is_preview(picture: Image.Image) -> bool:
    tags = getattr(picture, "tag_v2", {})
    return bool(int(tags.get(_KIND_TAG, 0)) & _PREVIEW_OR_MASK) or tags.get(_OLD_KIND_TAG) == _OLD_PREVIEW


def _without_large_notes(file: BinaryFile) -> BinaryFile:
    """Return a PNG without the texts and the colour profile beyond 1 MB; the file itself where there are none."""
    kept, start, total, unpacked = [], 0, 0, 0
    place = 8
    while len(header := _read_at(file, place, 8)) == 8:
        end = place + 12 + int.from_bytes(header[:4], "big")
        if header[4:] in (b"tEXt", b"zTXt", b"iTXt", b"iCCP"):
            n_bytes = _MAX_NOTES + 1
            if end - place <= n_bytes and unpacked < _MAX_UNPACKED:
                n_bytes = _unpacked_size(header[4:], _read_at(file, place + 8, end - place - 12))
                unpacked += n_bytes
            if total + n_bytes > _MAX_NOTES:
                kept.append((start, place))
                start = end
            else:
                total += n_bytes
        place = end
    if not kept:
        return file
    return BytesIO(b"".join(_read_at(file, begin, end - begin) for begin, end in [*kept, (start, place)]))


def _unpacked_size(kind: bytes, content: bytes) -> int:
    """Return how long a text or profile is, or a number beyond what is allowed."""
    packed = content
    if kind == b"iTXt":
        packed = content.partition(b"\0")[2]
        packed = packed[2:].split(b"\0", 2)[-1] if packed.startswith(b"\1") else b""
    elif kind != b"tEXt":
        packed = content.partition(b"\0")[2][1:]
    try:
        return len(content) + (0 if kind == b"tEXt" else len(zlib.decompressobj().decompress(packed, _MAX_NOTES + 1)))
    except zlib.error:  # nothing of it is used
        return len(content)


def _read_at(file: BinaryFile, place: int, n_bytes: int) -> bytes:
    file.seek(place)
    return file.read(n_bytes)
