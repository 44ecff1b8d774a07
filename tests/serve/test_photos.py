import io
import struct
import tracemalloc

import pytest
from PIL import Image
from tests import bombs
from tests.serve.running import photo

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera, Intrinsics
from zoedepth.geometry.lens import Lens
from zoedepth.serve.photos import MEDIA_TYPES, Decoded, check_photo, decode_photo
from zoedepth.serve.problems import Problem

LIMIT = 1_000_000


def refusal(content: bytes) -> Problem:
    """The problem for which a photo is refused, by its header or as it is decoded."""
    with pytest.raises(Problem) as caught:
        look_and_decode(content)
    return caught.value


def look_and_decode(content: bytes) -> Decoded:
    """What the service does with a photo."""
    check_photo(content, max_pixels=LIMIT)
    return decode_photo(content, "exif", max_pixels=LIMIT)


@pytest.mark.parametrize("kind", [kind for kind in MEDIA_TYPES if kind != "HEIF"])
def test_every_format_that_is_taken_is_decoded(kind: str) -> None:
    content = photo(64, 48, format=kind)
    assert check_photo(content, max_pixels=LIMIT) == (kind, (48, 64))
    assert decode_photo(content, "exif", max_pixels=LIMIT).image.shape == (48, 64, 3)


def test_photos_of_phones_are_taken() -> None:
    import pillow_heif

    file = io.BytesIO()
    pillow_heif.from_pillow(Image.open(io.BytesIO(photo()))).save(file)
    assert check_photo(file.getvalue(), max_pixels=LIMIT).format == "HEIF"
    assert decode_photo(file.getvalue(), "none", max_pixels=LIMIT).image.shape == (48, 64, 3)


@pytest.mark.parametrize(
    "content",
    [b"", b"x", b"hello, world", b"%PDF-1.7\n", b"<svg/>", b"PK\3\4", b"\x7fELF", b"P6 1 1 255 abc", bytes(1000),
     b"\0\0\0\x18ftypmp42" + bytes(50), b"RIFF\0\0\0\0WAVE", b"#!/bin/sh\n", b"%!PS-Adobe\n", b"\0\0\x02" + bytes(50)],
)  # fmt: skip
def test_what_is_no_photo_is_not_supported(content: bytes) -> None:
    problem = refusal(content)
    assert (problem.status, problem.kind) == (415, "unsupported-format")


@pytest.mark.parametrize("kind", [kind for kind in MEDIA_TYPES if kind != "HEIF"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_photo_that_is_cut_short_is_told_or_read(kind: str, share: float) -> None:
    content = photo(64, 48, format=kind)
    kind_of_problem = ""
    try:
        look_and_decode(content[: int(share * len(content))])
    except Problem as problem:
        kind_of_problem = problem.kind
    # What is nearly whole some decoders read without a word; of half a photo each of them says that it is one.
    told = ("unreadable-photo", "unsupported-format")
    assert kind_of_problem in (told if share <= 0.5 else ("", *told))


@pytest.mark.parametrize("reader", ["zoedepth.serve.photos.open_picture", "zoedepth.images.load_upright"])
def test_too_little_memory_is_no_damage(reader: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> object:
        raise MemoryError

    monkeypatch.setattr(reader, full)
    with pytest.raises(MemoryError):
        look_and_decode(photo(64, 48))


def test_pixels_are_counted_before_they_are_decoded() -> None:
    file = io.BytesIO()
    Image.new("L", (4000, 3000)).save(file, "PNG")
    tracemalloc.start()
    with pytest.raises(Problem) as caught:
        check_photo(file.getvalue(), max_pixels=LIMIT)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (caught.value.status, caught.value.kind) == (413, "too-many-pixels")
    assert "4000 x 3000" in caught.value.detail
    assert peak < 1_000_000


@pytest.mark.parametrize("kind", ["GIF", "PNG", "WEBP", "AVIF", "TIFF"])
def test_several_frames_are_refused(kind: str) -> None:
    frames = [Image.open(io.BytesIO(photo(seed=seed))) for seed in (1, 2)]
    file = io.BytesIO()
    frames[0].save(file, kind, save_all=True, append_images=frames[1:])
    problem = refusal(file.getvalue())
    assert (problem.status, problem.kind) == (422, "several-frames")


PNG = b"\x89PNG\r\n\x1a\n" + bombs.chunk(b"IHDR", struct.pack(">IIBBBBB", 9, 9, 8, 2, 0, 0, 0))
BOMBS = {
    "large png": bombs.png(30_000, 30_000),
    "tiles": bombs.tiff(900, 900, tile=(30_000, 30_000)),
    "large tiff": bombs.tiff(30_000, 30_000),
    "chunks": PNG + bombs.chunk(b"aaAa", b"") * 20_000,
    "text": PNG + bombs.chunk(b"zTXt", b"a\0\0" + bombs.zeros(512)),
    "segments": b"\xff\xd8" + b"\xff\xe1\0\2" * 20_000,
    "gif": b"GIF89a" + struct.pack("<HH", 65535, 65535) + bytes(50),
    "bmp": b"BM" + struct.pack("<IHHIIiiHHI", 60, 0, 0, 54, 40, 60_000, 60_000, 1, 8, 1) + bytes(50),
}


@pytest.mark.parametrize("content", BOMBS.values(), ids=BOMBS)
def test_bombs_are_refused_without_memory(content: bytes) -> None:
    tracemalloc.start()
    problem = refusal(content)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert problem.kind in ("unreadable-photo", "too-many-pixels")
    assert peak < 20_000_000 + 4 * len(content)


@pytest.mark.parametrize("content", [bombs.png(900, 900), bombs.tiff(900, 900)], ids=["png", "tiff"])
def test_what_lies_behind_the_last_pixel_is_never_unpacked(content: bytes) -> None:
    tracemalloc.start()
    check_photo(content, max_pixels=LIMIT)
    decode_photo(content, "none", max_pixels=LIMIT)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20_000_000


def test_a_polyglot_is_decoded_as_what_it_begins_with_or_not_at_all() -> None:
    page = b"<html><script>alert(1)</script></html>"
    png = photo()
    assert decode_photo(png + page, "none", max_pixels=LIMIT).image.shape == (48, 64, 3)
    assert refusal(page + png).status == 415
    assert refusal(b"%PDF-1.7\n" + png).status == 415


def test_a_panorama_is_no_photo_of_one_camera() -> None:
    xmp = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf GPano:ProjectionType="equirectangular"/></x:xmpmeta>'
    problem = refusal(photo(128, 64, format="JPEG", xmp=xmp))
    assert (problem.status, problem.kind) == (422, "panorama")
    check_photo(photo(128, 100, format="JPEG", xmp=xmp), max_pixels=LIMIT)  # a part of one


def test_a_camera_that_is_said_goes_before_the_notes() -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 26
    content = photo(64, 48, format="JPEG", exif=exif)
    known = decode_photo(content, "exif", max_pixels=LIMIT)
    assert getattr(known.camera, "source", "") == "exif"
    assert "26 mm" in known.camera_note
    lens = Lens(fov_x=50)
    assert decode_photo(content, lens, max_pixels=LIMIT).camera == lens.camera((48, 64))
    unknown = decode_photo(photo(), "exif", max_pixels=LIMIT)
    assert (unknown.camera, unknown.camera_note) == ("none", "it has no EXIF")


@pytest.mark.parametrize(
    ("camera", "told"),
    [
        (
            Intrinsics(3300, 3300, 1919.5, 1439.5),
            r"\(1919\.5, 1439\.5\), is far from the middle of a photo of 64 x 48 .*Scale them",
        ),
        (Intrinsics(60, 60, 31.5, 2), r"\(31\.5, 2\), is far from the middle"),
        (Lens(focal_px=0.1), "no lens"),
    ],
)
def test_a_camera_of_another_photo_is_refused(camera: Intrinsics | Lens, told: str) -> None:
    with pytest.raises(InputError, match=told):
        decode_photo(photo(64, 48), camera, max_pixels=LIMIT)


def test_intrinsics_are_of_the_photo_as_it_is_seen() -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # a quarter turn
    found = decode_photo(photo(128, 48, exif=exif), Intrinsics(100, 101, 23.5, 63.5), max_pixels=LIMIT)
    assert found.camera == Camera((128, 48), 100, 101, 23.5, 63.5)
