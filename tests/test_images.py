"""Reading every kind of photo, and refusing every kind of rubbish."""

import io
import re
import struct
import threading
import tracemalloc
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, PngImagePlugin
from tests import bombs

from zoedepth import images
from zoedepth.errors import InputError, InputWarning
from zoedepth.images import (
    FORMATS,
    IMAGE_SUFFIXES,
    PNG_MAX,
    as_array,
    atomic_path,
    read_image,
    read_image_with_notes,
    read_image_with_orientation,
    read_photo_notes,
    to_image,
    to_image_with_notes,
    write_image,
)


@pytest.fixture
def photo() -> np.ndarray:
    """uint8 (5, 7, 3), every pixel another colour."""
    return np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)


def saved(picture: Image.Image, path: Path, **options: object) -> Path:
    picture.save(path, **options)
    return path


class TestReadImage:
    def test_rgb(self, photo: np.ndarray, tmp_path: Path) -> None:
        path = saved(Image.fromarray(photo), tmp_path / "photo.png")
        np.testing.assert_array_equal(read_image(path), photo)
        np.testing.assert_array_equal(read_image(str(path)), photo)
        np.testing.assert_array_equal(read_image(io.BytesIO(path.read_bytes())), photo)

    def test_alpha_is_dropped(self, photo: np.ndarray, tmp_path: Path) -> None:
        rgba = np.dstack([photo, np.zeros(photo.shape[:2], np.uint8)])
        np.testing.assert_array_equal(read_image(saved(Image.fromarray(rgba), tmp_path / "photo.png")), photo)

    @pytest.mark.parametrize("mode", ["L", "LA", "1"])
    def test_grey_is_repeated(self, photo: np.ndarray, tmp_path: Path, mode: str) -> None:
        grey = Image.fromarray(photo).convert(mode)
        image = read_image(saved(grey, tmp_path / "photo.png"))
        expected = np.asarray(grey.convert("L"))
        np.testing.assert_array_equal(image, np.repeat(expected[..., None], 3, axis=2))

    @pytest.mark.parametrize(("mode", "suffix"), [("P", ".png"), ("P", ".gif"), ("CMYK", ".tif"), ("YCbCr", ".jpg")])
    def test_other_modes_are_converted(self, photo: np.ndarray, tmp_path: Path, mode: str, suffix: str) -> None:
        picture = Image.fromarray(photo).convert(mode)
        options = {"quality": 100, "subsampling": 0} if suffix == ".jpg" else {}
        path = saved(picture, tmp_path / f"photo{suffix}", **options)
        # A JPEG of quality 100 rounds its coefficients, and JPEG decoders may round differently.
        np.testing.assert_allclose(read_image(path).astype(int), np.asarray(picture.convert("RGB")), atol=6)

    @pytest.mark.parametrize("suffix", [".png", ".tif"])
    def test_16_bit_grey_spans_the_whole_range(self, tmp_path: Path, suffix: str) -> None:
        levels = np.array([[0, 128, 129, 257, 32768, PNG_MAX]], np.uint16)
        image = read_image(saved(Image.fromarray(levels), tmp_path / f"photo{suffix}"))
        np.testing.assert_array_equal(image[0, :, 0], [0, 0, 1, 1, 128, 255])

    @pytest.mark.parametrize("orientation", [1, 6])
    def test_tiff_of_16_bits_whose_0_is_white_is_turned_round(self, tmp_path: Path, orientation: int) -> None:
        levels = np.arange(6, dtype=np.uint16).reshape(2, 3) * 10_000
        for photometric, wanted in ((1, levels), (0, 65535 - levels)):
            path = tmp_path / f"{photometric}.tif"
            Image.fromarray(levels).save(path, tiffinfo={262: photometric, 274: orientation})
            found = read_image(path)[..., 0]
            np.testing.assert_array_equal(
                found, (wanted / 257).round() if orientation == 1 else np.rot90((wanted / 257).round(), -1)
            )

    def test_float_tiff(self, tmp_path: Path) -> None:
        levels = np.array([[0, 0.5, 1]], np.float32)
        image = read_image(saved(Image.fromarray(levels), tmp_path / "photo.tif"))
        np.testing.assert_array_equal(image[0, :, 0], [0, 128, 255])
        with pytest.raises(InputError, match=r"photo\.tif.*scale floats to \[0, 1\]"):
            read_image(saved(Image.fromarray(levels * 1000), tmp_path / "photo.tif"))

    @pytest.mark.parametrize("suffix", [".png", ".tif", ".webp"])
    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_exif_orientation(self, photo: np.ndarray, tmp_path: Path, orientation: int, suffix: str) -> None:
        undo = {1: None, 2: 0, 3: 3, 4: 1, 5: 5, 6: 2, 7: 6, 8: 4}[orientation]  # the transpose stored in the file
        stored = Image.fromarray(photo) if undo is None else Image.fromarray(photo).transpose(Image.Transpose(undo))
        exif = Image.Exif()
        exif[0x0112] = orientation
        options = {"lossless": True} if suffix == ".webp" else {}
        path = saved(stored, tmp_path / f"photo{suffix}", exif=exif, **options)
        image, found = read_image_with_orientation(path)
        np.testing.assert_array_equal(image, photo)
        np.testing.assert_array_equal(read_image(path), photo)
        assert found == orientation

    def test_notes_come_with_the_image_or_without_it(self, photo: np.ndarray, tmp_path: Path) -> None:
        exif = Image.Exif()
        exif[0x0112], exif[0x010F] = 6, "a camera"
        exif.get_ifd(0x8769)[0x920A] = 4.25
        path = saved(Image.fromarray(photo), tmp_path / "photo.jpg", exif=exif, xmp=b"GPano:ProjectionType")
        image, notes = read_image_with_notes(path)
        np.testing.assert_array_equal(image, read_image(path))
        assert (notes.tags[0x010F], notes.tags[0x920A]) == ("a camera", 4.25)
        assert (notes.orientation, notes.panorama, notes.damage) == (6, True, "")
        for source in (path, str(path), io.BytesIO(path.read_bytes()), Image.open(path)):
            found = to_image_with_notes(source)
            np.testing.assert_array_equal(found[0], image)
            assert found[1] == notes
        assert read_photo_notes(path) == notes
        path.write_bytes(path.read_bytes()[:-40])  # the pixels are cut short, and nobody needs them
        assert read_photo_notes(path) == notes
        with pytest.raises(InputError, match="cut short"):
            read_image_with_notes(path)

    def test_notes_are_bounded_as_images_are(self, photo: np.ndarray, tmp_path: Path) -> None:
        path = saved(Image.fromarray(photo), tmp_path / "photo.png")
        with pytest.raises(InputError, match="over the limit of 9"):
            read_image_with_notes(path, max_pixels=9)
        (tmp_path / "photo.txt").write_text("no photo")
        with pytest.raises(InputError, match=r"photo\.txt is not an image"):
            read_photo_notes(tmp_path / "photo.txt")
        assert read_photo_notes(path).tags == {}

    def test_broken_exif_is_ignored(self, photo: np.ndarray, tmp_path: Path) -> None:
        path = saved(Image.fromarray(photo), tmp_path / "photo.png", exif=b"Exif\x00\x00not a tiff header")
        with pytest.warns(InputWarning, match=r"photo\.png has damaged EXIF"):
            image, orientation = read_image_with_orientation(path)
        np.testing.assert_array_equal(image, photo)
        assert orientation == 1

    @pytest.mark.parametrize("n_bytes", [4, 30, 60])
    def test_exif_that_is_cut_short_is_named_with_its_file(
        self, photo: np.ndarray, tmp_path: Path, recwarn: pytest.WarningsRecorder, n_bytes: int
    ) -> None:
        exif = Image.Exif()
        exif[0x0112], exif[0x010F] = 6, "a camera"
        exif.get_ifd(0x8769)[0x9286] = b"a long comment of somebody"
        path = saved(Image.fromarray(photo), tmp_path / "photo.jpg", exif=exif.tobytes()[:-n_bytes])
        image, orientation = read_image_with_orientation(path)
        assert (orientation, image.shape[:2]) == (6, photo.shape[1::-1]), "what is left of it still counts"
        assert [str(warning.message).partition(". ")[0] for warning in recwarn] == [f"{path} has damaged EXIF"]

    def test_orientation_that_is_none_is_ignored(self, photo: np.ndarray, tmp_path: Path) -> None:
        exif = Image.Exif()
        exif[0x0112] = 9
        image, orientation = read_image_with_orientation(
            saved(Image.fromarray(photo), tmp_path / "photo.png", exif=exif)
        )
        np.testing.assert_array_equal(image, photo)
        assert orientation == 1

    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".bmp", ".tif", ".gif"])
    @pytest.mark.filterwarnings("ignore::UserWarning:PIL")
    def test_truncated_anywhere_is_an_input_error(self, tmp_path: Path, suffix: str) -> None:
        noise = np.random.default_rng(1).integers(0, 256, (60, 60, 3), dtype=np.uint8)
        whole = saved(Image.fromarray(noise), tmp_path / f"whole{suffix}").read_bytes()
        path = tmp_path / f"cut{suffix}"
        for length in (0, 1, 10, len(whole) // 3, len(whole) // 2):
            path.write_bytes(whole[:length])
            with pytest.raises(InputError, match="cut"):
                read_image(path)

    @pytest.mark.filterwarnings("ignore::UserWarning:PIL")
    def test_damaged_bytes_never_raise_anything_else(self, tmp_path: Path) -> None:
        rng = np.random.default_rng(2)
        noise = Image.fromarray(rng.integers(0, 256, (30, 30, 3), dtype=np.uint8))
        path, n_refused = tmp_path / "damaged", 0
        for suffix in (".jpg", ".png", ".webp", ".tif", ".gif"):
            whole = saved(noise, tmp_path / f"whole{suffix}").read_bytes()
            for _ in range(40):
                data = np.frombuffer(whole, np.uint8).copy()
                data[rng.integers(0, len(data), 8)] = rng.integers(0, 256, 8)
                path.write_bytes(data.tobytes())
                try:
                    read_image(path, max_pixels=1_000_000)
                except InputError:
                    n_refused += 1
        assert n_refused > 20

    @pytest.mark.parametrize("step", ["load_upright", "as_array"])
    def test_too_little_memory_is_no_damage(self, step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        Image.new("RGB", (8, 8)).save(tmp_path / "photo.png")

        def full(*_: object) -> object:
            raise MemoryError

        monkeypatch.setattr(images, step, full)
        with pytest.raises(MemoryError):
            read_image(tmp_path / "photo.png")
        with pytest.raises(MemoryError):
            to_image(Image.new("RGB", (8, 8)))

    def test_rubbish(self, tmp_path: Path) -> None:
        path = tmp_path / "notes.jpg"
        path.write_text("not an image")
        with pytest.raises(InputError, match=r"notes\.jpg is not an image in a known format"):
            read_image(path)
        with pytest.raises(InputError, match=r"missing\.jpg cannot be opened"):
            read_image(tmp_path / "missing.jpg")
        with pytest.raises(InputError, match="cannot be opened"):
            read_image(tmp_path)
        with pytest.raises(InputError, match="download it first"):
            read_image("https://example.org/photo.jpg")

    def test_nothing_is_executed_to_read_a_file(self, tmp_path: Path) -> None:
        path = tmp_path / "drawing.jpg"  # Pillow would start Ghostscript on EPS, whatever the suffix
        path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\nshowpage\n")
        with pytest.raises(InputError, match=r"drawing\.jpg is no ordinary photo: it is a document"):
            read_image(path)
        assert "EPS" not in FORMATS

    def test_streams_and_files_at_their_end(self, photo: np.ndarray, tmp_path: Path) -> None:
        file = io.BytesIO()
        Image.fromarray(photo).save(file, "PNG")  # which leaves it at its end
        np.testing.assert_array_equal(read_image(file), photo)

        class Stream(io.BytesIO):
            """As the web and pipes give it: it can be read once."""

            def seekable(self) -> bool:
                return False

            def seek(self, place: int, whence: int = 0) -> int:
                raise io.UnsupportedOperation

        np.testing.assert_array_equal(read_image(Stream(file.getvalue())), photo)

    def test_palette_with_transparency_is_read_without_a_warning(self, photo: np.ndarray, tmp_path: Path) -> None:
        palette = Image.fromarray(photo).convert("P")
        path = saved(palette, tmp_path / "photo.png", transparency=bytes(range(256)))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            np.testing.assert_array_equal(read_image(path), np.asarray(palette.convert("RGB")))
            picture = Image.open(path)
            np.testing.assert_array_equal(to_image(picture), np.asarray(palette.convert("RGB")))
        assert "transparency" in picture.info  # the user's picture is left as it was


def large(photo: np.ndarray) -> np.ndarray:
    return np.kron(photo, np.ones((8, 8, 1), np.uint8))


class TestWarnings:
    """What can be read and is hardly meant is named, with what to do."""

    @pytest.mark.parametrize(
        ("bits", "words"), [(10, "nearly black"), (14, r"too dark.*below 16384\. .*by 4$"), (15, "")]
    )
    def test_few_bits_in_16_of_colours(
        self, photo: np.ndarray, tmp_path: Path, recwarn: pytest.WarningsRecorder, bits: int, words: str
    ) -> None:
        """Pillow cannot write such PNGs, and keeps the upper 8 bits when it reads one."""
        levels = np.round(photo / photo.max() * (2**bits - 1)).astype(">u2")
        height, width = photo.shape[:2]
        header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
        rows = b"".join(b"\0" + row.tobytes() for row in levels)
        chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
        path = tmp_path / "raw.png"
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(bombs.chunk(*each) for each in chunks))
        np.testing.assert_array_equal(read_image(path), levels >> 8)
        said = [str(warning.message) for warning in recwarn]
        assert len(said) == bool(words)
        assert re.search(words, " ".join(said))

    def test_few_bits_in_16_with_some_saturated_pixels(self, tmp_path: Path) -> None:
        levels = np.linspace(0, 4095, 300 * 400).reshape(300, 400).astype(np.uint16)
        levels[7] = PNG_MAX
        path = saved(Image.fromarray(levels), tmp_path / "thermal.png")
        with pytest.warns(InputWarning, match=r"thermal\.png is too dark.*nearly all of its values are at most 40\d\d"):
            read_image(path)
        levels[::2] = PNG_MAX  # a photo of light and shadow
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            to_image(levels)

    @pytest.mark.parametrize(("bits", "factor"), [(8, 257), (10, 64), (12, 16), (14, 4)])
    def test_few_bits_in_16(self, photo: np.ndarray, tmp_path: Path, bits: int, factor: int) -> None:
        levels = np.round(photo[..., 0] / photo[..., 0].max() * (2**bits - 1)).astype(np.uint16)
        path = saved(Image.fromarray(levels), tmp_path / "thermal.png")
        with pytest.warns(InputWarning, match=rf"thermal\.png is too dark.*{2**bits - 1}\. .*by {factor}$"):
            dark = read_image(path)
        assert dark.max() <= 64  # it is not stretched without being asked
        for source, name in ((levels, "the array"), (Image.open(path), "the PIL image"), (levels.astype(">u2"), "the")):
            with pytest.warns(InputWarning, match=rf"{name}.* is too dark"):
                to_image(source)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            to_image(levels * np.uint16(factor))

    @pytest.mark.parametrize(
        ("values", "message"),
        [
            (np.random.default_rng(0).integers(0, 2, (30, 40, 3), np.uint8), "nearly black: its largest value is 1 of"),
            (np.zeros((30, 40, 3), np.uint8), "nearly black"),
            (np.full((30, 40, 3), (9, 200, 40), np.uint8), "nearly of one colour"),
            (np.full((300, 400), 1, np.float32), "nearly of one colour"),
            (np.zeros((30, 40), np.uint16), "nearly black"),
        ],
        ids=["0 and 1", "black", "coloured", "white", "16 bits"],
    )
    def test_nothing_to_see(self, values: np.ndarray, message: str) -> None:
        with pytest.warns(InputWarning, match=f"the array is {message}"):
            to_image(values)

    def test_12_bits_in_16_in_colour(self, tmp_path: Path) -> None:
        levels = np.random.default_rng(0).integers(0, 4096, (20, 30, 3)).astype(">u2")
        rows = b"".join(b"\0" + row.tobytes() for row in levels)
        header = chunk(b"IHDR", struct.pack(">IIBBBBB", 30, 20, 16, 2, 0, 0, 0))
        body = chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
        (tmp_path / "thermal.png").write_bytes(b"\x89PNG\r\n\x1a\n" + header + body)
        with pytest.warns(InputWarning, match=r"thermal\.png is nearly black: its largest value is 15 of 255"):
            read_image(tmp_path / "thermal.png")

    def test_one_lamp_at_night_is_something_to_see(self) -> None:
        night = np.zeros((1000, 1500, 3), np.uint8)
        night[501, 777] = 255  # beside the pixels of the first look
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            to_image(night)

    def test_masks_and_maps_are_no_photos(self, tmp_path: Path) -> None:
        path = saved(Image.new("1", (30, 20)), tmp_path / "mask.png")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert not read_image(path, photo=False).any()

    @pytest.mark.parametrize("suffix", [".gif", ".png", ".webp", ".tif"])
    def test_several_frames(self, photo: np.ndarray, tmp_path: Path, suffix: str) -> None:
        first, second = (Image.fromarray(values) for values in (large(photo), large(photo)[::-1]))
        options = {"lossless": True} if suffix == ".webp" else {}
        path = saved(first, tmp_path / f"film{suffix}", save_all=True, append_images=[second], **options)
        with pytest.warns(InputWarning, match=rf"film\{suffix} has several pages or frames, and the first is read"):
            image = read_image(path)
        atol = 40 if suffix == ".gif" else 0  # its palette
        np.testing.assert_allclose(image.astype(int), large(photo), atol=atol)

    def test_preview_in_a_tiff_is_no_second_page(self, photo: np.ndarray, tmp_path: Path) -> None:
        path = tmp_path / "photo.tif"
        path.write_bytes(
            bombs.tiff_pages((Image.fromarray(photo), {}), (Image.new("RGB", (3, 2)), {254: 1})).getvalue()
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            np.testing.assert_array_equal(read_image(path), photo)

    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tif"])
    def test_panorama(self, photo: np.ndarray, tmp_path: Path, suffix: str) -> None:
        notes = '<x:xmpmeta xmlns:x="adobe:ns:meta/"><a GPano:ProjectionType="equirectangular"/></x:xmpmeta>'
        options: dict[str, object] = {"xmp": notes.encode()}
        if suffix == ".png":
            options = {"pnginfo": PngImagePlugin.PngInfo()}
            options["pnginfo"].add_itxt("XML:com.adobe.xmp", notes)
        elif suffix == ".tif":
            options = {"tiffinfo": {700: notes.encode()}}
        path = saved(Image.fromarray(large(photo)), tmp_path / f"sphere{suffix}", **options)
        with pytest.warns(InputWarning, match=rf"sphere\{suffix} is a panorama"):
            read_image(path)


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(height: int, width: int, *chunks: bytes) -> bytes:
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    body = chunk(b"IDAT", zlib.compress(b"\0" * height * (3 * width + 1))) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(chunks) + body


def claiming(kind: str, side: int) -> bytes:
    """A file of a few hundred bytes that says it holds side x side pixels."""
    buffer = io.BytesIO()
    options = {"lossless": True} if kind == "WEBP" else {}
    Image.new("RGB", (16, 16)).save(buffer, kind, **options)
    data = bytearray(buffer.getvalue())

    def put(place: int, code: str, *values: int) -> None:
        struct.pack_into(code, data, place, *values)

    if kind == "JPEG":
        put(data.index(b"\xff\xc0") + 5, ">HH", side, side)
    elif kind == "GIF":
        put(6, "<HH", side, side)
    elif kind in ("BMP", "DIB"):
        put(18 if kind == "BMP" else 4, "<ii", side, side)
    elif kind == "TGA":
        put(12, "<HH", side, side)
    elif kind == "WEBP":
        put(21, "<I", (side - 1) | (side - 1) << 14)
    elif kind == "JPEG2000":
        put(data.index(b"ihdr") + 4, ">II", side, side)
        for place in (8, 24):  # of the picture and of its only tile
            put(data.index(b"\xff\x51") + place - 2, ">II", side, side)
    elif kind == "AVIF":
        put(data.index(b"ispe") + 8, ">II", side, side)
    elif kind == "TIFF":
        (directory,) = struct.unpack_from("<I", data, 4)
        for entry in range(directory + 2, directory + 26, 12):  # width and height come first
            put(entry + 2, "<HII", 4, 1, side)
    elif kind == "PPM":
        data = bytearray(b"P6 %d %d 255\n" % (side, side))
    elif kind == "PNG":
        data[8:33] = chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0))
    return bytes(data)


KINDS = ("JPEG", "PNG", "TIFF", "WEBP", "AVIF", "BMP", "DIB", "GIF", "PPM", "JPEG2000", "TGA")


class TestBombs:
    """Small files that would unpack to gigabytes."""

    @pytest.mark.parametrize("kind", KINDS)
    def test_a_small_file_cannot_claim_a_huge_picture(self, kind: str, tmp_path: Path) -> None:
        (tmp_path / "bomb").write_bytes(claiming(kind, 13_000))
        unpacked = {"WEBP": "1,183", "AVIF": "676", "JPEG2000": "1,352"}.get(kind, "507")  # with the decoder's copies
        with pytest.raises(
            InputError, match=rf"bomb has 13000 x 13000 pixels: [\d,]+ bytes would unpack to {unpacked},000,000"
        ):
            read_image(tmp_path / "bomb")
        with pytest.raises(InputError, match="13000 x 13000"):
            read_image(io.BytesIO((tmp_path / "bomb").read_bytes()))

    def test_more_pixels_than_are_ever_read(self, tmp_path: Path) -> None:
        (tmp_path / "bomb.png").write_bytes(claiming("PNG", 60_000))
        with pytest.raises(InputError, match=r"bomb\.png.*resize"):
            read_image(tmp_path / "bomb.png")
        with pytest.raises(InputError, match="over the limit of 34"):
            read_image(io.BytesIO(png(5, 7)), max_pixels=34)

    def test_a_large_photo_in_a_large_file_is_read(self, tmp_path: Path) -> None:
        large = Image.new("L", (6000, 6000), 7)  # 108 MB in RGB
        assert (read_image(saved(large, tmp_path / "photo.png", compress_level=0)) == 7).all()
        with pytest.raises(InputError, match="less compression"):
            read_image(saved(large, tmp_path / "photo.png"))

    def test_a_screenshot_of_8k_is_read_however_small_its_file(self, tmp_path: Path) -> None:
        path = saved(Image.new("RGB", (7680, 4320), (30, 30, 30)), tmp_path / "screen.png")
        assert path.stat().st_size < 500_000
        assert read_image(path).shape == (4320, 7680, 3)

    @pytest.mark.parametrize(("suffix", "quick"), [(".webp", {"method": 0}), (".avif", {"speed": 10}), (".jp2", {})])
    def test_a_photo_of_12_megapixels_is_read_in_every_format(
        self, suffix: str, quick: dict[str, int], tmp_path: Path
    ) -> None:
        path = saved(Image.new("RGB", (4032, 3024), (30, 30, 30)), tmp_path / f"photo{suffix}", **quick)
        assert path.stat().st_size < 50_000
        assert read_image(path).shape == (3024, 4032, 3)

    def test_runs_of_a_tga(self, tmp_path: Path) -> None:
        """Five megabytes of runs of 128 black pixels are 157 megapixels, which nobody stores so."""
        header = bytes([0, 0, 10, *[0] * 9]) + struct.pack("<HHBB", 12_544, 12_544, 24, 0x20)
        (tmp_path / "bomb.tga").write_bytes(header + (b"\xff" + bytes(3)) * (12_544**2 // 128) + bytes(26))
        with pytest.raises(InputError, match="more than 16 times its size"):
            read_image(tmp_path / "bomb.tga")

    @pytest.mark.parametrize("kind", [b"zTXt", b"iTXt", b"iCCP"])
    def test_text_and_profiles_of_a_png(self, kind: bytes) -> None:
        flags = b"\1\0\0\0" if kind == b"iTXt" else b"\0"
        bomb = chunk(kind, b"name\0" + flags + zlib.compress(b"a" * 50_000_000))
        tracemalloc.start()
        assert read_image(io.BytesIO(png(8, 8, bomb))).shape == (8, 8, 3)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 5_000_000


class TestHeic:
    """The photos of phones, read where pillow-heif is installed."""

    @pytest.fixture(autouse=True)
    def _library(self) -> None:
        library = pytest.importorskip("pillow_heif")
        library.register_heif_opener()  # to write them; reading goes without

    def test_main_picture_upright(self, photo: np.ndarray, tmp_path: Path) -> None:
        shown, other = large(photo), Image.new("RGB", (16, 24), "red")
        turned = Image.fromarray(shown).transpose(Image.Transpose.ROTATE_90)
        exif = Image.Exif()
        exif[0x0112] = 6
        options = {"quality": -1, "chroma": 444, "matrix_coefficients": 0}  # without loss
        path = saved(turned, tmp_path / "IMG_1.HEIC", format="HEIF", exif=exif.tobytes(), **options)
        image, orientation = read_image_with_orientation(path)
        np.testing.assert_allclose(image.astype(int), shown, atol=3)
        assert orientation == 6
        both = saved(other, tmp_path / "IMG_2.heic", format="HEIF", save_all=True,
                     append_images=[Image.fromarray(shown)], primary_index=1, **options)  # fmt: skip
        np.testing.assert_allclose(read_image(both).astype(int), shown, atol=3)
        assert {".heic", ".heif"} <= IMAGE_SUFFIXES

    def test_bounds_hold(self, photo: np.ndarray, tmp_path: Path) -> None:
        path = saved(Image.fromarray(large(photo)), tmp_path / "IMG_1.HEIC", format="HEIF")
        with pytest.raises(InputError, match=r"IMG_1\.HEIC has 56 x 40 pixels, over the limit of 99"):
            read_image(path, max_pixels=99)
        content = path.read_bytes()
        for length in (40, len(content) // 2, len(content) - 9):
            path.write_bytes(content[:length])
            with pytest.raises(InputError, match=r"IMG_1\.HEIC cannot be read"):
                read_image(path)


@pytest.mark.parametrize("mode", ["RGB", "L", "P", "1", "RGBA", "CMYK", "I;16", "F"])
def test_bands_of_a_large_picture_are_those_of_the_whole(mode: str) -> None:
    values = np.random.default_rng(0).integers(0, 256, (700, 1000, 3), dtype=np.uint8)
    picture = Image.fromarray(values[..., 0].astype(np.uint16)) if mode == "I;16" else Image.fromarray(values)
    picture = picture if mode == "I;16" else picture.convert(mode)
    wanted = mode if mode in ("I;16", "F") else "RGB"
    np.testing.assert_array_equal(as_array(picture, wanted), np.asarray(picture.convert(wanted)))


class TestToImage:
    def test_all_ways_in_are_one(self, photo: np.ndarray, tmp_path: Path) -> None:
        tensor = torch.from_numpy(photo).permute(2, 0, 1)
        sources = [
            saved(Image.fromarray(photo), tmp_path / "photo.png"),
            Image.fromarray(photo),
            photo,
            photo / 255,
            (photo / 255).astype(np.float32),
            photo.astype(np.uint16) * 257,
            (photo.astype(np.uint16) * 257).astype(">u2"),
            np.dstack([photo, photo[..., 0]]),
            np.asfortranarray(photo)[::-1][::-1],
            tensor,
            tensor.float() / 255,
            (tensor.float() / 255).requires_grad_(),
        ]
        for source in sources:
            image = to_image(source)
            assert image.dtype == np.uint8
            assert image.flags.c_contiguous
            np.testing.assert_array_equal(image, photo)

    def test_bfloat16_and_half_tensors(self, photo: np.ndarray) -> None:
        tensor = torch.from_numpy(photo).permute(2, 0, 1) / 255
        for dtype in (torch.bfloat16, torch.float16):
            np.testing.assert_allclose(to_image(tensor.to(dtype)).astype(int), photo, atol=1)

    def test_grey_arrays(self, photo: np.ndarray) -> None:
        grey = photo[..., 0]
        expected = np.repeat(grey[..., None], 3, axis=2)
        for source in (grey, grey[..., None], torch.from_numpy(grey), torch.from_numpy(grey)[None]):
            np.testing.assert_array_equal(to_image(source), expected)

    def test_pil_image_with_orientation(self, photo: np.ndarray) -> None:
        picture = Image.fromarray(photo).transpose(Image.Transpose.ROTATE_90)
        picture.getexif()[0x0112] = 6
        np.testing.assert_array_equal(to_image(picture), photo)

    @pytest.mark.parametrize(
        ("source", "message"),
        [
            (np.zeros((2, 3, 4, 3), np.uint8), "shape"),
            (np.zeros((3, 4, 5), np.uint8), "channels first"),
            (np.zeros((0, 4, 3), np.uint8), "empty"),
            (np.zeros((4, 4, 3), np.int64), "int64"),
            (np.full((4, 4, 3), 255.0), "scale floats"),
            (np.full((4, 4, 3), np.nan), "scale floats"),
            (torch.zeros(5, 4, 3), "channels, height, width"),
            (torch.zeros(2, 3, 4, 5), "Predictor.batch"),
            (None, "NoneType"),
            ([[1, 2], [3, 4]], "list"),
        ],
    )
    def test_what_cannot_be_an_image(self, source: object, message: str) -> None:
        with pytest.raises(InputError, match=message):
            to_image(source)

    def test_truncated_pil_image(self, tmp_path: Path) -> None:
        whole = saved(
            Image.fromarray(np.random.default_rng(1).integers(0, 256, (60, 60, 3), dtype=np.uint8)), tmp_path / "a.jpg"
        )
        with pytest.raises(InputError, match="the PIL image"):
            to_image(Image.open(io.BytesIO(whole.read_bytes()[:2000])))


def test_write_image_refuses_other_suffixes(photo: np.ndarray, tmp_path: Path) -> None:
    write_image(tmp_path / "folder" / "picture.png", photo)
    np.testing.assert_array_equal(read_image(tmp_path / "folder" / "picture.png"), photo)
    with pytest.raises(InputError, match=r"picture\.txt"):
        write_image(tmp_path / "picture.txt", photo)
    assert not (tmp_path / "picture.txt").exists()


class TestAtomicPath:
    def test_nothing_is_left_of_a_failed_write(self, tmp_path: Path) -> None:
        path = tmp_path / "file.txt"
        path.write_text("before")

        def fail_half_way() -> None:
            with atomic_path(path) as temporary:
                assert temporary.parent == path.parent
                temporary.write_text("half")
                raise RuntimeError

        with pytest.raises(RuntimeError):
            fail_half_way()
        assert path.read_text() == "before"
        assert list(tmp_path.iterdir()) == [path]

    def test_writers_do_not_share_a_temporary_file(self, tmp_path: Path) -> None:
        pictures = [np.full((50, 50, 3), index, np.uint8) for index in range(8)]
        path = tmp_path / "picture.png"
        threads = [threading.Thread(target=write_image, args=(path, picture)) for picture in pictures]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(np.unique(read_image(path))) == 1
        assert list(tmp_path.iterdir()) == [path]
