"""Photos of a few kilobytes or megabytes that would keep a decoder busy for seconds to minutes, or fill the memory."""

import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image
from tests import bombs

from zoedepth import claims
from zoedepth.claims import check_claims
from zoedepth.errors import InputError
from zoedepth.images import read_image
from zoedepth.stored import declared_scale, read_mask

PIXELS = zlib.compress(bytes(8 * 25))


def saved(kind: str, size: tuple[int, int] = (64, 64), mode: str = "RGB", **options: object) -> bytes:
    buffer = io.BytesIO()
    Image.new(mode, size).save(buffer, kind, **options)
    return buffer.getvalue()


def jpeg(segments: bytes) -> bytes:
    """A JPEG with more segments at its beginning."""
    content = saved("JPEG")
    return content[:2] + segments + content[2:]


def png(*chunks: bytes, after: bytes = b"") -> bytes:
    header = bombs.chunk(b"IHDR", struct.pack(">IIBBBBB", 8, 8, 8, 2, 0, 0, 0))
    body = b"".join(chunks) + bombs.chunk(b"IDAT", PIXELS) + after + bombs.chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + header + body


def tiff(order: str, tags: dict[int, int], counts: dict[int, int], *, large: bool = False) -> bytes:
    """A TIFF of tags, of which some have more values than one."""
    entry, start = ("HHQQ", "HHHQQ") if large else ("HHII", "HIH")
    values = (43, 8, 0, 16, len(tags)) if large else (42, 8, len(tags))
    entries = [struct.pack(order + entry, tag, 4, counts.get(tag, 1), value) for tag, value in sorted(tags.items())]
    return (b"II" if order == "<" else b"MM") + struct.pack(order + start, *values) + b"".join(entries) + bytes(99)


def bmp(size: int, content: bytes, *, file_header: bool = True) -> bytes:
    """A BMP of 8 bits, packed by runs."""
    info = struct.pack("<IiiHHIIiiII", 40, size, size, 1, 8, 1, len(content), 0, 0, 256, 0) + bytes(1024)
    before = b"BM" + struct.pack("<IHHI", 14 + len(info) + len(content), 0, 0, 14 + len(info)) if file_header else b""
    return before + info + content


def jpeg2000(change: Callable[[bytearray], None], *, in_tile: bool = False, boxes: bool = False) -> bytes:
    """A JPEG 2000 of 1000 x 1000 pixels whose coding style (COD) is changed, in the main header or in its tile's."""
    content = saved("JPEG2000", (1000, 1000), no_jp2=not boxes)
    begin = content.index(b"\xff\x52")
    end = begin + 2 + int.from_bytes(content[begin + 2 : begin + 4], "big")
    style = bytearray(content[begin:end])
    change(style)
    style[2:4] = struct.pack(">H", len(style) - 2)
    if not in_tile:
        return content[:begin] + style + content[end:]
    data = content.index(b"\xff\x93", end)
    part = content.index(b"\xff\x90", end)
    (size,) = struct.unpack_from(">I", content, part + 6)
    changed = bytearray(content[:data] + style + content[data:])
    struct.pack_into(">I", changed, part + 6, size + len(style))
    return bytes(changed)


def tiny_precincts(style: bytearray) -> None:
    """Precincts of 2 x 2 pixels: each takes half a kilobyte, and 1000 x 1000 pixels 1.6 GB."""
    style[4] |= 1
    style += bytes([0x11] * (style[9] + 1))


def tiny_tiles() -> bytes:
    content = bytearray(saved("JPEG2000", (1000, 1000), no_jp2=True))
    struct.pack_into(">II", content, content.index(b"\xff\x51") + 22, 5, 5)
    return bytes(content)


last_scan = (progressive := saved("JPEG", progressive=True))[progressive.rindex(b"\xff\xda") : -2]
STRIPS = {256: 8, 257: 8, 258: 8, 259: 1, 262: 1, 273: 8, 277: 1, 278: 8, 279: 64}
MANY = {273: 5_000_000, 279: 5_000_000}
# Made where they are needed: they take seconds, and half a gigabyte.
BOMBS: dict[str, tuple[Callable[[], bytes], str]] = {
    "jpeg segments": (lambda: jpeg(b"\xff\xe3\0\2" * 1_000_000), "more than 10,000 segments"),
    "jpeg comments": (lambda: jpeg(b"\xff\xfe\0\6aaaa" * 500_000), "more than 10,000 segments"),
    "jpeg filling": (lambda: jpeg(b"\xff" * 30_000_000), "between its segments"),
    "jpeg zeros": (lambda: jpeg(b"\xff\xe3\0\2" + bytes(30_000_000)), "between its segments"),
    "jpeg scans": (lambda: progressive[:-2] + 30 * last_scan + b"\xff\xd9", "more than 30 scans"),
    "png chunks": (lambda: png(bombs.chunk(b"abCd", b"") * 1_000_000), "more than 21,7.. chunks"),
    "png texts": (lambda: png(*(bombs.chunk(b"tEXt", b"%d\0v" % i) for i in range(100_000))), "chunks"),
    "png pixels": (lambda: png(bombs.chunk(b"IDAT", b"") * 1_000_000), "chunks"),
    "png end": (lambda: png(after=bombs.chunk(b"abCd", b"") * 1_000_000), "chunks"),
    "tiff tags": (lambda: tiff("<", STRIPS | dict.fromkeys(range(300, 65_000), 8), {}),
                  "has 64,709 tags, more than 4,096"),
    "tiff strips": (lambda: tiff("<", STRIPS, MANY) + bytes(20_000_000), "5,000,000 strips"),
    "tiff strips, big-endian": (lambda: tiff(">", STRIPS, MANY) + bytes(20_000_000), "5,000,000 strips"),
    "tiff tiles": (lambda: tiff("<", STRIPS | {324: 8}, {324: 5_000_000}) + bytes(20_000_000),
                   "5,000,000 strips or tiles"),
    "bigtiff strips": (lambda: tiff("<", STRIPS, MANY, large=True) + bytes(20_000_000), "5,000,000 strips"),
    "bmp ends of lines": (lambda: bmp(5770, b"\1\0\0\0" * 5770 + b"\0\1"), "packed by runs"),
    "bmp no pixels": (lambda: bmp(64, bytes(20_000_000)), "packed by runs"),
    "dib ends of lines": (lambda: bmp(5770, b"\1\0\0\0" * 5770 + b"\0\1", file_header=False), "packed by runs"),
    "ppm header": (lambda: b"P6\n" + b"#a\n" * 1_000_000 + b"8 8 255\n" + bytes(192), "header is longer"),
    "ppm comments": (lambda: b"P3 8 8 255\n" + b"#a\n" * 1_000_000 + b"0 " * 192, "more than 100 comments"),
    "ppm digits": (lambda: b"P3 3000 3000 255\n" + b"0 " * 192, "written in digits, and larger than 4,194,304 pixels"),
    "pbm digits": (lambda: b"P1\n# by hand\n5000 5000\n" + b"01" * 192, "written in digits"),
    "jp2 boxes": (lambda: saved("JPEG2000")[:12] + b"\0\0\0\10free" * 1_000_000, "more than 10,000 boxes"),
    "jp2 precincts": (lambda: jpeg2000(tiny_precincts, boxes=True), "1,000,122 precincts"),
    "j2k precincts": (lambda: jpeg2000(tiny_precincts), "1,000,122 precincts"),
    "j2k precincts of a tile": (lambda: jpeg2000(tiny_precincts, in_tile=True), "1,000,122 precincts"),
    "j2k tiles": (tiny_tiles, "720,000 precincts"),
}  # fmt: skip


@pytest.mark.parametrize("bomb", BOMBS)
def test_photo_of_far_too_many_pieces_is_refused_before_it_is_decoded(bomb: str, tmp_path: Path) -> None:
    content, message = BOMBS[bomb]
    path = tmp_path / "bomb"
    path.write_bytes(content())
    with pytest.raises(InputError, match=rf"bomb is no ordinary photo: .*{message}.*Save it"):
        read_image(path)


HONEST: dict[str, Callable[[], bytes]] = {
    "jpeg": lambda: saved("JPEG"),
    "progressive jpeg": lambda: progressive,
    "jpeg with a film": lambda: progressive + 100 * last_scan + 100 * b"\xff\xda" + 100_000 * b"\xff",
    "jpeg with a large profile": lambda: jpeg((b"\xff\xe2\xff\xff" + bytes(65_533)) * 100),
    "png": lambda: saved("PNG"),
    "png with a thousand texts": lambda: png(*(bombs.chunk(b"tEXt", b"%d\0v" % i) for i in range(1000))),
    "tiff": lambda: saved("TIFF"),
    "bigtiff": lambda: saved("TIFF", big_tiff=True),
    "packed tiff": lambda: saved("TIFF", (3000, 3000), compression="tiff_adobe_deflate"),
    "webp": lambda: saved("WEBP"),
    "bmp": lambda: saved("BMP"),
    "dib": lambda: saved("DIB"),
    "runs in a bmp": lambda: bmp(64, (b"\x40\1\0\0") * 64 + b"\0\1"),
    "gif": lambda: saved("GIF"),
    "ppm": lambda: saved("PPM"),
    "ppm with comments": lambda: b"P3\n# by hand\n1 1\n# white\n255\n255 # red\n255 255\n",
    "jp2": lambda: saved("JPEG2000"),
    "j2k": lambda: saved("JPEG2000", no_jp2=True),
    "j2k in tiles": lambda: saved("JPEG2000", (1000, 1000), no_jp2=True, tile_size=(256, 256)),
    "j2k in precincts": lambda: saved("JPEG2000", (2000, 2000), no_jp2=True, precinct_size=(128, 128),
                                      codeblock_size=(32, 32)),
    "tga": lambda: saved("TGA"),
}  # fmt: skip


@pytest.mark.parametrize("kind", HONEST)
def test_ordinary_photo_is_read(kind: str) -> None:
    assert read_image(io.BytesIO(HONEST[kind]())).ndim == 3


@pytest.mark.parametrize("kind", HONEST)
def test_file_stays_where_it_was_and_may_be_cut_anywhere(kind: str) -> None:
    content = HONEST[kind]()
    file = io.BytesIO(b"before" + content)
    file.seek(6)
    check_claims(file)
    assert file.tell() == 6
    for length in range(20, 200, 3):
        check_claims(io.BytesIO(content[:length]))


def test_many_small_code_blocks() -> None:
    with pytest.raises(ValueError, match="1,687,500 code blocks"):
        check_claims(io.BytesIO(_blocks()))


def _blocks() -> bytes:
    content = bytearray(saved("JPEG2000", (3000, 3000), no_jp2=True))
    style = content.index(b"\xff\x52")
    content[style + 10 : style + 12] = b"\0\0"  # 4 x 4 pixels
    return bytes(content)


def test_maps_and_masks_are_looked_at_as_photos_are(tmp_path: Path) -> None:
    (tmp_path / "bomb.png").write_bytes(png(bombs.chunk(b"abCd", b"") * 1_000_000))
    with pytest.raises(InputError, match=r"bomb\.png is not a readable PNG .*chunks"):
        read_mask(tmp_path / "bomb.png")
    assert declared_scale(tmp_path / "bomb.png") is None


def directories(order: str, *pages: tuple[dict[int, int], ...], within: tuple[dict[int, int], ...] = ()) -> bytes:
    """A TIFF of pages without pixels, given by their tags; those within belong to the first."""
    places, place = [], 8
    for tags in (*pages, *within):
        places.append(place)
        place += 6 + 12 * (len(tags) + 1)
    content = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    for number, tags in enumerate((*pages, *within)):
        tags = {**tags, 330: place} if within and number == 0 else {**tags, 256: 8}
        following = places[number + 1] if number + 1 < len(pages) else 0
        content += struct.pack(order + "H", len(tags))
        for tag, value in sorted(tags.items()):
            count = max(2, len(within)) if tag == 330 else 1
            short = tag in (262, 255)
            content += struct.pack(order + ("HHIHxx" if short else "HHII"), tag, 3 if short else 4, count, value)
        content += struct.pack(order + "I", following)
    return content + b"".join(struct.pack(order + "I", place) for place in places[len(pages) :]) + bytes(8)


SENSOR, PREVIEW = {262: 32803}, {254: 1}


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize(
    "pages",
    [
        {"pages": ({50706: 0x01040000},)},
        {"pages": ({254: 0}, {262: 34892})},
        {"pages": (PREVIEW,), "within": (PREVIEW, SENSOR)},
        {"pages": (PREVIEW, PREVIEW), "within": ({262: 2}, {262: 2})},
        {"pages": ({254: 0},), "within": (PREVIEW, SENSOR)},
    ],
    ids=["DNG", "linear", "NEF", "previews with the photo within", "preview that does not say so"],
)
def test_raw_files_are_not_read_by_their_previews(order: str, pages: dict[str, tuple]) -> None:
    content = directories(order, *pages["pages"], within=pages.get("within", ()))
    with pytest.raises(ValueError, match="it is a camera's raw file"):
        check_claims(io.BytesIO(content))


def test_pyramids_are_photos() -> None:
    """Smaller copies within the page of the full picture, as microscopes and maps have them."""
    check_claims(io.BytesIO(directories("<", {262: 2}, within=(PREVIEW, PREVIEW))))
    check_claims(io.BytesIO(directories("<", PREVIEW)))  # the only page, whatever it says


def test_pages_of_a_tiff_are_counted() -> None:
    many = directories("<", *20_000 * [{}])
    with pytest.raises(ValueError, match="more than 10,000 pages"):
        check_claims(io.BytesIO(many))
    circle = bytearray(directories("<", {}))
    circle[22:26] = struct.pack("<I", 8)  # the next page is this one
    check_claims(io.BytesIO(circle))


def brands(*names: bytes) -> bytes:
    return struct.pack(">I", 12 + 4 * len(names)) + b"ftyp" + names[0] + bytes(4) + b"".join(names[1:]) + bytes(99)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "it is empty"),
        (brands(b"crx ", b"isom"), "raw file"),
        (brands(b"isom", b"mp42"), "it is a film"),
        (brands(b"qt  "), "it is a film"),
        (b"II*\0\x10\0\0\0CR\2\0" + bytes(99), "raw file"),
        (b"FUJIFILMCCD-RAW 0201", "raw file"),
        (b"IIU\0" + bytes(99), "raw file"),
        (b"8BPS\0\1" + bytes(99), "it is a document"),
        (b"%PDF-1.7", "it is a document"),
        (b'<?xml version="1.0"?><svg>', "it is a document"),
        (b"\x76\x2f\x31\x01\2\0\0\0", "wide range of light"),
        (b"#?RADIANCE\n", "wide range of light"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "git lfs pull"),
        (b"\n\n<!DOCTYPE html><html>", "it is a web page"),
        (b"PK\3\4" + bytes(99), "it is an archive"),
        (b"\0\0\0\x0cJXL \r\n\x87\n", "JPEG XL"),
        (b"\0\0\1\0\2\0", "it is an icon"),
    ],
)
def test_what_is_no_photo_is_named(content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.raises(InputError, match=rf"a\.jpg is no ordinary photo: .*{message}"):
        read_image(tmp_path / "a.jpg")


def test_heic_needs_a_library(monkeypatch: pytest.MonkeyPatch) -> None:
    for names in ((b"heic", b"mif1"), (b"mif1", b"heix"), (b"msf1", b"hevc")):
        monkeypatch.setattr(claims, "HEIC_IS_READ", False)
        with pytest.raises(ValueError, match=r"it is HEIC, as phones write it\. .*pip install 'zoedepth\[heic\]'"):
            check_claims(io.BytesIO(brands(*names)))
        monkeypatch.setattr(claims, "HEIC_IS_READ", True)
        check_claims(io.BytesIO(brands(*names)))


def test_avif_is_not_taken_for_a_film_or_heic() -> None:
    for names in ((b"avif", b"mif1"), (b"mif1", b"avif", b"miaf")):
        check_claims(io.BytesIO(brands(*names)))


def test_lengths_that_lie_take_no_time() -> None:
    with pytest.raises(ValueError, match="film"):
        check_claims(io.BytesIO(b"\xff\xff\xff\xffftypisom" + bytes(99)))


@pytest.mark.parametrize(("kind", "greatest"), [("P6", 255), ("P5", 255), ("P5", 65535), ("P6", 65535)])
@pytest.mark.parametrize("blanks", ["\r\n", " \n"])
def test_a_header_with_a_blank_too_many_is_refused(tmp_path: Path, kind: str, greatest: int, blanks: str) -> None:
    n_bytes = 8 * 6 * (3 if kind == "P6" else 1) * (1 if greatest < 256 else 2)
    pixels = bytes(range(40, 40 + 96)) * 3
    for header, refused in ((f"{kind}\n8 6\n{greatest}\n", False), (f"{kind}\n8 6\n{greatest}{blanks}", True)):
        (tmp_path / "a.ppm").write_bytes(header.encode() + pixels[:n_bytes])
        if refused:
            with pytest.raises(InputError, match="its header ends with two blanks, where the format has one"):
                read_image(tmp_path / "a.ppm")
        else:
            assert read_image(tmp_path / "a.ppm").shape == (6, 8, 3)


def test_a_line_feed_behind_the_pixels_is_no_blank_too_many(tmp_path: Path) -> None:
    (tmp_path / "a.ppm").write_bytes(b"P6\n8 6\n255\n" + bytes(range(40, 184)) + b"\n")
    assert read_image(tmp_path / "a.ppm")[0, 0].tolist() == [40, 41, 42]
