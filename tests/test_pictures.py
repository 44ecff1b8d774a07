"""The full picture of a file is opened, whatever stands beside it, without Pillow's warnings and bounds."""

import io
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, UnidentifiedImageError
from tests import bombs

from zoedepth.pictures import n_full_pages, open_picture

PHOTO = Image.fromarray(np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8))
PREVIEW, MASK = Image.new("RGB", (6, 4), "red"), Image.new("1", (30, 20))


def stored(picture: Image.Image, kind: str, **options: object) -> io.BytesIO:
    file = io.BytesIO()
    picture.save(file, kind, **options)
    return file


@pytest.mark.parametrize(
    "file",
    [
        bombs.tiff_pages((PREVIEW, {254: 1}), (PHOTO, {254: 0})),
        bombs.tiff_pages((PREVIEW, {254: 1}), (MASK, {254: 4}), (PREVIEW, {255: 2}), (PHOTO, {})),
        bombs.tiff_pages((PHOTO, {}), (PREVIEW, {254: 1})),
        bombs.tiff_pages((PHOTO, {}), (MASK, {254: 4})),
    ],
    ids=["preview first", "previews and a mask first", "preview last", "mask last"],
)
def test_full_page_of_a_tiff(file: io.BytesIO) -> None:
    picture = open_picture(file, ["TIFF"])
    assert n_full_pages(picture) == 1
    np.testing.assert_array_equal(np.asarray(picture), np.asarray(PHOTO))


def test_several_full_pages_are_counted_and_the_first_stays_open() -> None:
    picture = open_picture(bombs.tiff_pages((PHOTO, {}), (PREVIEW, {254: 1}), (PREVIEW, {}), (PREVIEW, {})), ["TIFF"])
    assert (n_full_pages(picture), n_full_pages(picture, most=9)) == (2, 3)
    np.testing.assert_array_equal(np.asarray(picture), np.asarray(PHOTO))


def test_pages_that_are_all_said_to_be_previews() -> None:
    picture = open_picture(bombs.tiff_pages((PHOTO, {254: 1}), (PREVIEW, {254: 1})), ["TIFF"])
    np.testing.assert_array_equal(np.asarray(picture), np.asarray(PHOTO))


def test_second_view_of_a_jpeg_is_passed_over() -> None:
    """Stereo cameras and phones with two lenses write MPO: the first picture is an ordinary JPEG."""
    file = stored(PHOTO, "MPO", save_all=True, append_images=[PREVIEW])
    picture = open_picture(file, ["JPEG"])
    assert (picture.format, picture.size, n_full_pages(picture)) == ("JPEG", PHOTO.size, 1)
    damaged = file.getvalue().replace(b"MPF\0", b"MPF\0\xff")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert open_picture(io.BytesIO(damaged), ["JPEG"]).size == PHOTO.size


def test_more_than_90_megapixels_are_opened_without_a_warning() -> None:
    file = bombs.png(12_000, 9_000)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert open_picture(io.BytesIO(file), ["PNG"]).size == (12_000, 9_000)


def test_format_that_is_not_asked_for() -> None:
    with pytest.raises(UnidentifiedImageError):
        open_picture(stored(PHOTO, "PNG"), ["JPEG", "TIFF", "no such format"])
    with pytest.raises(UnidentifiedImageError):
        open_picture(io.BytesIO(b"\x89PNG\r\n\x1a\nrubbish"), ["PNG"])


def packed(n_bytes: int) -> bytes:
    return zlib.compress(b"a" * n_bytes)


class TestNotesOfPng:
    """Texts and profiles: small ones stay, those beyond 1 MB are passed over."""

    @staticmethod
    def opened(*chunks: bytes, after: tuple[bytes, ...] = ()) -> Image.Image:
        content = stored(PHOTO, "PNG").getvalue()
        file = content[:33] + b"".join(chunks) + content[33:-12] + b"".join(after) + content[-12:]
        picture = open_picture(io.BytesIO(file), ["PNG"])
        np.testing.assert_array_equal(np.asarray(picture), np.asarray(PHOTO))
        return picture

    @pytest.mark.parametrize(
        "large",
        [
            bombs.chunk(b"iCCP", b"scanner\0\0" + packed(1_600_000)),
            bombs.chunk(b"zTXt", b"workflow\0\0" + packed(1_600_000)),
            bombs.chunk(b"iTXt", b"prompt\0\1\0en\0\0" + packed(1_600_000)),
            bombs.chunk(b"iTXt", b"prompt\0\0\0en\0\0" + b"a" * 1_600_000),
            bombs.chunk(b"tEXt", b"parameters\0" + b"a" * 70_000_000),
            bombs.chunk(b"zTXt", b"bomb\0\0" + bombs.zeros(1024)),
        ],
        ids=["profile", "packed", "international packed", "international", "70 MB", "bomb"],
    )
    def test_large_ones_hide_nothing(self, large: bytes) -> None:
        small = bombs.chunk(b"tEXt", b"Title\0a room"), bombs.chunk(b"zTXt", b"Packed\0\0" + packed(100))
        picture = self.opened(large, *small, after=(bombs.chunk(b"tEXt", b"Later\0yes"), large))
        assert picture.info["Title"] == "a room"
        assert picture.info["Packed"] == "a" * 100
        assert picture.info["Later"] == "yes"

    def test_many_ones_together(self) -> None:
        each = bombs.chunk(b"zTXt", b"name\0\0" + packed(600_000))
        assert len(self.opened(*3 * [each]).info["name"]) == 600_000

    def test_damaged_ones(self) -> None:
        self.opened(bombs.chunk(b"zTXt", b"name\0\0rubbish"), bombs.chunk(b"iCCP", b"name\0\0rubbish"))
        self.opened(bombs.chunk(b"iTXt", b"name"), bombs.chunk(b"tEXt", b""), bombs.chunk(b"iTXt", b"name\0\1\0"))

    def test_chunk_that_goes_beyond_the_end(self, tmp_path: Path) -> None:
        content = stored(PHOTO, "PNG").getvalue()
        file = content[:-12] + struct.pack(">I", 2**31) + b"zTXt" + bytes(99)
        np.testing.assert_array_equal(np.asarray(open_picture(io.BytesIO(content), ["PNG"])), np.asarray(PHOTO))
        assert open_picture(io.BytesIO(file), ["PNG"]).size == PHOTO.size
