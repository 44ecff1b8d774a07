"""Claims of a photo's file: how many pieces it says it has, counted before a decoder goes through them.

A decoder makes something of every piece, so that a file of a few kilobytes can keep it busy for minutes. Each function
walks through the headers of one format, without unpacking anything, and raises ``ValueError`` where there are far more
pieces than any photo has. What it cannot make sense of is left to the decoder.
"""

import math
import os
import re
import struct
from contextlib import suppress
from importlib.util import find_spec
from io import BytesIO
from typing import IO, NamedTuple

BinaryFile = IO[bytes] | BytesIO  # a BytesIO is an IO[bytes] to static checkers, not to beartype

MAX_SCANS = 30
"""Scans of a JPEG, at most; progressive ones have about ten."""

HEIC_IS_READ = find_spec("pillow_heif") is not None
"""True where the library that reads HEIC is installed; the package can do without it."""

AVIF_BRANDS = {b"avif", b"avis"}
"""Brands by which an AVIF names itself."""
HEIC_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs", b"mif1", b"msf1"}
"""Brands by which a HEIC names itself; AVIF has some of them, too."""

_MAX_PIECES = 10_000  # segments, chunks, boxes: photos have up to some hundreds, beside the pixels
_MAX_JPEG = 1 << 28  # bytes of a JPEG that are looked at: the largest pictures are smaller
_MAX_JUNK = 1 << 16  # bytes that stand between the segments of a JPEG
_CHUNK = 1024  # bytes that the chunks of a large PNG have on average, at least
_MAX_RUN_PIXELS = 1 << 22
_MAX_PNM_HEADER, _MAX_COMMENTS, _MAX_DIGITS = 4096, 100, 1 << 27
_MAX_TAGS, _MAX_ALL_TAGS, _MAX_STRIPS, _MAX_WITHIN = 4096, 1 << 17, 1 << 17, 16
_MAX_MARKERS, _MAX_PRECINCTS, _MAX_BLOCKS = 1 << 17, 1 << 16, 1 << 19

# A marker of a JPEG that is neither a stuffed byte nor one that stands inside of a scan.
_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd7\xff]")
# TIFF's tags of the places and lengths of strips and tiles.
_STRIP_TAGS = (273, 279, 324, 325)
# Tags of the kind of a page, what its values are, and the places of more pictures within it; the version of a DNG.
_KIND_TAG, _COLOURS_TAG, _WITHIN_TAG, _DNG_TAG, _SHORT = 254, 262, 330, 50706, 3
_SENSOR_COLOURS = (32803, 34892)  # a filter of colours before each pixel; linear values of a sensor
# Markers of JPEG 2000: SOC, SIZ, COD, COC, SOT, SOD, EOC.
_START, _SIZE, _CODING, _CODING_OF_COMPONENT, _PART, _CONTENT, _END = (
    0xFF4F, 0xFF51, 0xFF52, 0xFF53, 0xFF90, 0xFF93, 0xFFD9,
)  # fmt: skip


def check_claims(file: BinaryFile) -> None:
    """Refuse a photo of far too many pieces, and name what is no photo. The file is left where it was.

    Raises:
        ValueError: it is one of these; the message says which, and is to be put behind the name of the file.
    """
    place = file.tell()
    start = file.read(64)
    if other := _other_kind(start):
        raise ValueError(other)
    for prefixes, check in _CHECKS.items():
        if start.startswith(prefixes):
            file.seek(place)
            with suppress(struct.error, IndexError, ZeroDivisionError):  # the decoder says what is wrong
                check(file)
    file.seek(place)


def _check_jpeg(file: BinaryFile) -> None:
    """Count the segments of the first picture, and its scans, each of which passes over the whole picture.

    Phones append films and further pictures, in which any bytes may stand.
    """
    begin = file.tell()
    size = file.seek(0, os.SEEK_END) - begin
    file.seek(begin)
    content = file.read(min(size, _MAX_JPEG))  # read(n) takes memory for n bytes, however few there are
    place, pieces, scans, junk = 2, 0, 0, 0
    # Only in scans may bytes stand that belong to no segment.
    while found := _MARKER.search(content, place, len(content) if scans else place + _MAX_JUNK + 2):
        kind, begin = content[found.start() + 1], found.start()
        if kind == 0xD9:  # the end of the picture
            break
        junk += 0 if scans else begin - place
        pieces += 1
        scans += kind == 0xDA
        if scans > MAX_SCANS:
            raise ValueError(f"it has more than {MAX_SCANS} scans. Save it again as an ordinary JPEG")
        if pieces > _MAX_PIECES or junk > _MAX_JUNK:
            break
        place = found.end() + int.from_bytes(content[found.end() : found.end() + 2], "big")
    else:
        junk += 0 if scans else len(content) - place
    if pieces > _MAX_PIECES:
        raise ValueError(f"it has more than {_MAX_PIECES:,} segments. Save it again as an ordinary JPEG")
    if junk > _MAX_JUNK:
        raise ValueError(f"more than {_MAX_JUNK:,} bytes stand between its segments. Save it again as an ordinary JPEG")


def _check_png(file: BinaryFile) -> None:
    """Count the chunks: those of pixels have 8 KB and more, others are few."""
    begin = file.tell()
    size = file.seek(0, os.SEEK_END)
    limit = _MAX_PIECES + (size - begin) // _CHUNK
    file.seek(begin + 8)
    for _ in range(limit):
        length, kind = struct.unpack(">I4s", file.read(8))
        if kind == b"IEND" or file.seek(length + 4, os.SEEK_CUR) >= size:
            return
    raise ValueError(f"it has more than {limit:,} chunks. Save it again as an ordinary PNG")


def _check_bmp(file: BinaryFile) -> None:
    """Refuse large pictures that are packed by runs: Pillow unpacks them one pixel at a time."""
    begin = file.tell()
    file.seek(begin + (14 if file.read(2) == b"BM" else 0))
    width, height, packing = struct.unpack("<4xii4xI", file.read(20))
    n_bytes = file.seek(0, os.SEEK_END) - begin
    if packing in (1, 2) and (abs(width * height) > _MAX_RUN_PIXELS or n_bytes > _MAX_RUN_PIXELS):
        raise ValueError(f"it is packed by runs, and larger than {_MAX_RUN_PIXELS:,} pixels or bytes. Save it as PNG")


def _check_pnm(file: BinaryFile) -> None:
    """Refuse large pictures of digits, which Pillow reads one number at a time, and count the comments.

    Pillow reads the header one byte at a time, and passes over the whole text per comment.
    """
    begin = file.tell()
    header = re.sub(rb"#[^\r\n]*[\r\n]", b" ", file.read(_MAX_PNM_HEADER)).split(maxsplit=4)
    if len(header) < 4:
        raise ValueError(f"its header is longer than {_MAX_PNM_HEADER:,} bytes, or cut short. Save it as PNG")
    if header[0] not in (b"P1", b"P2", b"P3"):
        _check_blank(file, begin)
        return
    n_pixels = math.prod(int(side) for side in header[1:3] if side.isdigit())
    n_bytes = file.seek(0, os.SEEK_END) - begin
    if n_pixels > _MAX_RUN_PIXELS or n_bytes > _MAX_DIGITS:
        raise ValueError(
            f"it is written in digits, and larger than {_MAX_RUN_PIXELS:,} pixels or {_MAX_DIGITS:,} bytes. Save it as "
            "PNG"
        )
    file.seek(begin)
    if file.read(n_bytes).count(b"#") > _MAX_COMMENTS:
        raise ValueError(f"it has more than {_MAX_COMMENTS} comments. Save it as PNG")


_PNM = re.compile(rb"P(?P<kind>[56])\s+(?P<width>\d{1,9})\s+(?P<height>\d{1,9})\s+(?P<greatest>\d{1,9})\s\s")
"""The header of a binary PGM or PPM without comments, and a blank too many."""


def _check_blank(file: BinaryFile, begin: int) -> None:
    """Refuse a binary picture whose header ends with two blanks (\\r\\n): Pillow takes the second for a value."""
    file.seek(begin)
    found = _PNM.match(file.read(_MAX_PNM_HEADER))
    n_left = file.seek(0, os.SEEK_END) - begin
    file.seek(begin)
    if found is None:
        return
    width, height, greatest = (int(found[name]) for name in ("width", "height", "greatest"))
    n_bytes = (1 if greatest < 256 else 2) * (3 if found["kind"] == b"6" else 1)
    if n_left - found.end() == height * width * n_bytes:
        raise ValueError(
            "its header ends with two blanks, where the format has one, so that every value would be a wrong one. Save "
            "it as PNG"
        )


def _check_tiff(file: BinaryFile) -> None:
    """Count the pages, their tags, and the strips or tiles of each; refuse what a camera's sensor has recorded."""
    begin = file.tell()
    start = file.read(16)
    if start[8:10] == b"CR":  # Canon's CR2
        raise ValueError(_RAW)
    order = "<" if start.startswith(b"II") else ">"
    for large in {start[2] == 43, 43 in start[2:4]}:  # BigTIFF has numbers of 64 bits; Pillow looks at the first byte
        first = struct.unpack_from(order + ("Q" if large else "I"), start, 8 if large else 4)[0]
        _check_pages(file, begin, first, order, large=large)


def _check_pages(file: BinaryFile, begin: int, place: int, order: str, *, large: bool) -> None:
    pages: dict[int, _Directory] = {}  # by their places
    n_tags = 0
    with suppress(struct.error):  # the decoder does not come farther either
        while place and place not in pages:
            pages[place] = page = _read_directory(file, begin + place, order, large=large)
            n_tags += page.n_tags
            place = page.following
            if n_tags > _MAX_ALL_TAGS or len(pages) > _MAX_PIECES:
                raise ValueError(
                    f"it has more than {_MAX_PIECES:,} pages, or {_MAX_ALL_TAGS:,} tags in all of them. Save the page "
                    "that you need as an ordinary TIFF"
                )
    within = [place for page in pages.values() for place in page.within]
    if within and all(page.is_preview for page in pages.values()):
        raise ValueError(_RAW)
    for place in within[:_MAX_WITHIN]:
        with suppress(struct.error):
            _read_directory(file, begin + place, order, large=large)


class _Directory(NamedTuple):
    """Directory of a page of a TIFF: the parts of it that are looked at."""

    n_tags: int
    is_preview: bool
    within: tuple[int, ...]
    """Places of directories of further pictures that belong to this page."""
    following: int
    """Place of the next page; 0 after the last."""


def _read_directory(file: BinaryFile, place: int, order: str, *, large: bool) -> _Directory:
    head, entry, link = (order + code for code in (("Q", "HHQ8s", "Q") if large else ("H", "HHI4s", "I")))
    file.seek(place)
    (n_tags,) = struct.unpack(head, file.read(struct.calcsize(head)))
    if n_tags > _MAX_TAGS:
        raise ValueError(f"it has {n_tags:,} tags, more than {_MAX_TAGS:,}. Save it again as an ordinary TIFF")
    is_preview, within, n_within = False, 0, 0
    for _ in range(n_tags):
        tag, kind, count, value = struct.unpack(entry, file.read(struct.calcsize(entry)))
        (number,) = struct.unpack_from(order + ("H" if kind == _SHORT else "Q" if large else "I"), value)
        if tag in _STRIP_TAGS and count > _MAX_STRIPS:
            raise ValueError(
                f"it has {count:,} strips or tiles, more than {_MAX_STRIPS:,}. Save it again as an ordinary TIFF"
            )
        if tag == _DNG_TAG or (tag == _COLOURS_TAG and number in _SENSOR_COLOURS):
            raise ValueError(_RAW)
        if tag == _WITHIN_TAG:
            within, n_within = number, min(count, _MAX_WITHIN)
        is_preview |= tag == _KIND_TAG and number & 1 == 1
    (following,) = struct.unpack(link, file.read(struct.calcsize(link)))
    places = (within,)
    if n_within > 1:  # then the places themselves stand there
        file.seek(within)
        places = struct.unpack(link[0] + n_within * link[1], file.read(n_within * struct.calcsize(link)))
    return _Directory(n_tags, is_preview, places if n_within else (), following)


def _check_jp2(file: BinaryFile) -> None:
    """Find the codestream in the boxes of a JP2 file, and check it."""
    for _ in range(_MAX_PIECES):
        place = file.tell()
        size, kind = struct.unpack(">I4s", file.read(8))
        if size == 1:
            (size,) = struct.unpack(">Q", file.read(8))
        if kind == b"jp2c":
            return _check_codestream(file)
        if size < 8:  # the last box, or a damaged one
            return None
        file.seek(place + size)
    raise ValueError(f"it has more than {_MAX_PIECES:,} boxes. Save it again as an ordinary JPEG 2000")


def _check_codestream(file: BinaryFile) -> None:
    """Count what OpenJPEG makes objects of, used or not: precincts, of which a tile has at least one, and code blocks.

    The part of each tile may change the sizes of both.
    """
    grid, part_end = b"", None
    for _ in range(_MAX_MARKERS):
        place = file.tell()
        (marker,) = struct.unpack(">H", file.read(2))
        if marker == _END:
            return
        if marker == _CONTENT:
            if part_end is None:  # it is the last one
                return
            file.seek(part_end)
        elif marker != _START:
            (length,) = struct.unpack(">H", file.read(2))
            segment = file.read(max(length - 2, 0))
            if marker == _SIZE:
                grid = segment
            elif marker == _PART:
                (size,) = struct.unpack_from(">I", segment, 2)
                part_end = place + size if size else None
            elif marker in (_CODING, _CODING_OF_COMPONENT):
                _check_coding(segment, grid, of_component=marker == _CODING_OF_COMPONENT)
    raise ValueError(f"it has more than {_MAX_MARKERS:,} parts. Save it again with larger tiles")


def _check_coding(segment: bytes, grid: bytes, *, of_component: bool) -> None:
    right, bottom, left, top, *tile, tile_left, tile_top, n_components = struct.unpack_from(">8IH", grid, 2)
    n_tiles = -(-(right - tile_left) // tile[0]) * -(-(bottom - tile_top) // tile[1])
    start = 0 if not of_component else 1 if n_components < 257 else 2
    levels, *block = struct.unpack_from("3B", segment, start + (1 if of_component else 5))
    sizes = segment[start + (6 if of_component else 10) :] if segment[start] & 1 else b""
    sides = (min(tile[0], right - left), min(tile[1], bottom - top))
    n_precincts = 0
    for level in range(levels + 1):
        size = sizes[level] if sizes else 0xFF
        across, down = (
            max(1, -(-side >> (levels - level) + exponent))
            for side, exponent in zip(sides, (size & 15, size >> 4), strict=True)
        )
        n_precincts += n_components * n_tiles * across * down
    n_blocks = n_components * (right - left) * (bottom - top) >> (sum(side & 15 for side in block) + 4)
    if max(n_precincts / _MAX_PRECINCTS, n_blocks / _MAX_BLOCKS) > 1:
        raise ValueError(
            f"it has {n_precincts:,} precincts and {n_blocks:,} code blocks, more than {_MAX_PRECINCTS:,} and "
            f"{_MAX_BLOCKS:,}. Save it again in one tile, as an ordinary JPEG 2000"
        )


def stand_in(start: bytes) -> str | None:
    """Return what stands in place of a file, by its first bytes, and what to do about it; None where nothing does."""
    if not start:
        return "it is empty. Copy it again"
    bare = start.lstrip().lower()
    return next((what for prefixes, what in _STAND_INS.items() if bare.startswith(prefixes)), None)


def media_brands(start: bytes) -> set[bytes]:
    """Return the brands of a film, an AVIF or a HEIC by its first bytes; empty for all other files."""
    if start[4:8] != b"ftyp":
        return set()
    return {start[place : place + 4] for place in range(8, min(len(start), int.from_bytes(start[:4], "big")), 4)}


def _other_kind(start: bytes) -> str | None:
    """Return what a file is that is no photo, by its first bytes, and what to do about it; None for photos."""
    if other := stand_in(start):
        return other
    if start[4:8] == b"ftyp":
        if start[8:12] == b"crx ":
            return _RAW
        brands = media_brands(start)
        if brands & AVIF_BRANDS:
            return None
        if brands & HEIC_BRANDS:
            return None if HEIC_IS_READ else _HEIC
        return _FILM
    bare = start.lstrip().lower()
    return next((what for prefixes, what in _OTHERS.items() if start.startswith(prefixes) or bare.startswith(prefixes)),
                None)  # fmt: skip


_RAW = "it is a camera's raw file. Develop it to JPEG or TIFF, e.g. with darktable"
_HEIC = (
    "it is HEIC, as phones write it. Install the extra that reads it, pip install 'zoedepth[heic]', or save it as "
    "JPEG, e.g. heif-convert PHOTO.heic PHOTO.jpg"
)
_FILM = "it is a film. Take pictures out of it, e.g. ffmpeg -i FILM frames/%05d.png"
_DOCUMENT = "it is a document. Save its picture as JPEG or PNG"
_LIGHT = "it holds a wide range of light. Save it as JPEG or PNG, as it looks on a screen"

_STAND_INS = {
    (b"version https://git-lfs",): "it only stands for a file that Git LFS keeps. Fetch that: git lfs pull",
    (b"<!doctype html", b"<html"): "it is a web page, which a site sent in place of the file. Download it again",
}
_OTHERS = {
    (b"FUJIFILMCCD-RAW", b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"FOVb", b"\0MRM", b"II\x1a\0\0\0HEAPCCDR"): _RAW,
    (b"\x1aE\xdf\xa3", b"FLV", b"OggS", b"\0\0\1\xba"): _FILM,
    (b"8BPS", b"8BPB", b"%PDF", b"%!PS", b"\xc5\xd0\xd3\xc6", b"gimp xcf", b"<svg", b"<?xml"): _DOCUMENT,
    (b"\x76\x2f\x31\x01", b"#?RADIANCE", b"#?RGBE", b"PF\n", b"Pf\n"): _LIGHT,
    (b"\0\0\0\x0cJXL ", b"\xff\x0a"): "it is JPEG XL. Save it as JPEG or PNG",
    (b"\0\0\1\0", b"icns"): "it is an icon, of several sizes. Save one of them as PNG",
    (b"PK\3\4", b"Rar!", b"7z\xbc\xaf", b"\x1f\x8b"): "it is an archive. Unpack it first",
}
"""How files that are often taken for photos begin → what they are, and what to do."""

_CHECKS = {
    (b"\xff\xd8",): _check_jpeg,
    (b"\x89PNG",): _check_png,
    (b"II", b"MM"): _check_tiff,
    (b"BM", *(bytes([size, 0, 0, 0]) for size in (40, 52, 56, 64, 108, 124))): _check_bmp,
    (b"P1", b"P2", b"P3", b"P4", b"P5", b"P6"): _check_pnm,
    (b"\0\0\0\x0cjP  ",): _check_jp2,
    (b"\xff\x4f\xff\x51",): _check_codestream,
}
"""How a file of a format begins → the function that checks it."""
