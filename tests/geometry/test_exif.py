"""The camera that a photo's notes tell, against values worked out by hand, and every kind of nonsense in them."""

import math
import struct
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from PIL.TiffImagePlugin import IFDRational
from tests.geometry.scene import FILM, SIZE, Scene, rendered_room, worst_error

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.exif import ExifCamera, read_exif_camera
from zoedepth.images import read_image, read_image_with_notes, to_image_with_notes
from zoedepth.pictures import PhotoNotes

MAKE, MODEL, ORIENTATION = 0x010F, 0x0110, 0x0112
LENS, FILM_LENGTH, ZOOM = 0x920A, 0xA405, 0xA404
ACROSS, DOWN, UNIT = 0xA20E, 0xA20F, 0xA210
WIDTH, HEIGHT = 0xA002, 0xA003
CUSTOM, LENS_MODEL = 0xA401, 0xA434

# A lens of 50 mm before a sensor of 36 mm with 400 pixels across: 50 / 36 * 400 = 555.56 pixels.
FIFTY = {LENS: IFDRational(50), ACROSS: IFDRational(400 * 254, 360), DOWN: IFDRational(400 * 254, 360), UNIT: 2}
FIFTY_PX = 50 / 36 * 400
# 400 x 300 pixels are 500 from corner to corner, and film 43.267 mm: 26 mm are 26 / 43.267 * 500 pixels.
WIDE = {FILM_LENGTH: 26}
WIDE_PX = 26 / 43.266615 * 500
TAKEN = {**WIDE, WIDTH: 400, HEIGHT: 300}


def exif_of(tags: dict[int, object]) -> Image.Exif:
    """Return EXIF with these tags in the directories where they belong."""
    exif = Image.Exif()
    inner = exif.get_ifd(0x8769)
    for tag, value in tags.items():
        (exif if tag in (MAKE, MODEL, ORIENTATION) else inner)[tag] = value
    stored = Image.Exif()
    stored.load(exif.tobytes())  # PNG and TIFF are written without the inner directory of EXIF that was not stored yet
    return stored


def photo_of(path: Path, size: tuple[int, int], tags: dict[int, object], **options: object) -> Path:
    """Write a photo of ``size`` (width, height) with these tags."""
    Image.effect_noise(size, 40).convert("RGB").save(path, exif=exif_of(tags), **options)
    return path


def assert_camera(camera: Camera | None, focal_px: float, size: tuple[int, int]) -> None:
    """Check that a camera looks through the middle of a photo, with square pixels."""
    assert camera is not None
    assert camera.fx == pytest.approx(focal_px, rel=1e-6)
    assert camera == Camera.from_focal(camera.fx, size, source="exif")


def focal(tags: dict[int, object], size: tuple[int, int] = (300, 400)) -> float | None:
    """Return what notes say of a photo of ``size`` (height, width)."""
    orientation = tags.get(ORIENTATION, 1)
    camera = read_exif_camera(PhotoNotes(tags, orientation if isinstance(orientation, int) else 1), size).camera
    return None if camera is None else camera.focal_px


def reason(tags: dict[int, object], size: tuple[int, int] = (300, 400), **notes: object) -> str:
    """Return why notes tell no camera."""
    found = read_exif_camera(PhotoNotes(tags, **notes), size)
    assert found.camera is None
    return found.reason


@pytest.mark.parametrize(
    ("tags", "stored", "size", "expected"),
    [
        pytest.param(WIDE, (400, 300), (300, 400), WIDE_PX, id="35-mm film"),
        pytest.param(FIFTY, (400, 300), (300, 400), FIFTY_PX, id="focal plane in inches"),
        pytest.param(
            {**FIFTY, ACROSS: IFDRational(4000, 36), DOWN: IFDRational(4000, 36), UNIT: 3},
            (400, 300), (300, 400), FIFTY_PX, id="focal plane in centimetres",
        ),
        pytest.param(
            {**FIFTY, ACROSS: IFDRational(400, 36), DOWN: IFDRational(400, 36), UNIT: 4},
            (400, 300), (300, 400), FIFTY_PX, id="focal plane in millimetres",
        ),
        pytest.param(
            # 390 pixels on 23.5 mm are 16.60 per mm, and 260 on 15.6 are 16.67: that side is whole.
            {LENS: IFDRational(50), MAKE: "NIKON CORPORATION", MODEL: "NIKON D90"},
            (390, 260), (260, 390), 50 * 260 / 15.6, id="size of the sensor",
        ),
        pytest.param({**WIDE, ORIENTATION: 6}, (400, 300), (400, 300), WIDE_PX, id="portrait, to be turned"),
        pytest.param({**WIDE, WIDTH: 400, HEIGHT: 300}, (300, 400), (400, 300), WIDE_PX, id="portrait, turned before"),
        pytest.param({**WIDE, ORIENTATION: 3}, (400, 300), (300, 400), WIDE_PX, id="upside down"),
        pytest.param(
            # 4000 pixels when it was taken, one tenth of them now.
            {**FIFTY, ACROSS: IFDRational(1016000, 360), DOWN: IFDRational(1016000, 360), WIDTH: 4000, HEIGHT: 3000},
            (400, 300), (300, 400), FIFTY_PX, id="resized",
        ),
        pytest.param({**WIDE, WIDTH: 400, HEIGHT: 300}, (400, 225), (225, 400), WIDE_PX, id="cropped"),
        pytest.param({MAKE: "somebody"}, (400, 300), (300, 400), None, id="none"),
        pytest.param({FILM_LENGTH: 0, LENS: IFDRational(0), ACROSS: 0}, (400, 300), (300, 400), None, id="nonsense"),
    ],
)  # fmt: skip
def test_twelve_photos(
    tmp_path: Path, tags: dict[int, object], stored: tuple[int, int], size: tuple[int, int], expected: float | None
) -> None:
    path = photo_of(tmp_path / "photo.jpg", stored, tags)
    assert read_image(path).shape[:2] == size
    camera = read_exif_camera(path, size).camera
    if expected is None:
        assert camera is None
    else:
        assert_camera(camera, expected, size)


class TestFormats:
    """The camera is the same in every format, and is there with the image, without reading the file twice."""

    @pytest.mark.parametrize("orientation", range(1, 9))
    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tif", ".mpo"])
    def test_orientations(self, tmp_path: Path, suffix: str, orientation: int) -> None:
        options = {"save_all": True, "append_images": [Image.new("RGB", (8, 6))]} if suffix == ".mpo" else {}
        tags = {**WIDE, WIDTH: 40, HEIGHT: 30, ORIENTATION: orientation}
        path = photo_of(tmp_path / f"photo{suffix}", (40, 30), tags, **options)
        size = (30, 40) if orientation < 5 else (40, 30)
        image, notes = read_image_with_notes(path)
        assert image.shape[:2] == size
        assert (notes.orientation, notes.damage) == (orientation, "")
        found = read_exif_camera(notes, size)
        assert_camera(found.camera, WIDE_PX / 10, size)
        assert found.reason == "its 35-mm focal length is 26 mm"
        assert read_exif_camera(path, size) == found
        with path.open("rb") as file:
            assert read_exif_camera(file, size) == found

    def test_heic(self, tmp_path: Path) -> None:
        pytest.importorskip("pillow_heif").register_heif_opener()
        path = tmp_path / "IMG_1.HEIC"
        exif = exif_of({**WIDE, ORIENTATION: 6, WIDTH: 80, HEIGHT: 60}).tobytes()
        Image.effect_noise((80, 60), 40).convert("RGB").save(path, format="HEIF", exif=exif)
        image, notes = read_image_with_notes(path)
        assert image.shape[:2] == (80, 60)
        assert notes.orientation == 6
        found = read_exif_camera(notes, (80, 60))
        assert_camera(found.camera, WIDE_PX / 5, (80, 60))
        assert read_exif_camera(path, (80, 60)) == found

    def test_pictures_in_memory(self, tmp_path: Path) -> None:
        path = photo_of(tmp_path / "photo.jpg", (40, 30), {**WIDE, ORIENTATION: 8})
        picture = Image.open(path)
        image, notes = to_image_with_notes(picture)
        np.testing.assert_array_equal(image, read_image(path))
        assert read_exif_camera(notes, image.shape[:2]) == read_exif_camera(path, (40, 30))
        assert read_exif_camera(picture, (40, 30)) == read_exif_camera(path, (40, 30))

    def test_arrays_have_no_notes(self) -> None:
        image, notes = to_image_with_notes(np.zeros((3, 4, 3), np.uint8))
        assert (image.shape, notes) == ((3, 4, 3), PhotoNotes())
        assert reason(dict(notes.tags)) == "it has no EXIF"

    def test_files_that_are_no_pictures(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="check the path"):
            read_exif_camera(tmp_path / "none.jpg", (3, 4))
        (tmp_path / "text.jpg").write_text("no picture")
        with pytest.raises(InputError, match=r"text\.jpg"):
            read_exif_camera(tmp_path / "text.jpg", (3, 4))


class TestRenderedRoom:
    """A room that is photographed with a lens of known length: its points land where they were seen."""

    @pytest.fixture
    def room(self) -> Scene:
        return rendered_room()

    def camera(self, path: Path, picture: Image.Image, tags: dict[int, object], size: tuple[int, int]) -> Camera:
        picture.save(path / "room.png", exif=exif_of(tags))
        image, notes = read_image_with_notes(path / "room.png")
        assert image.shape[:2] == size
        camera = read_exif_camera(notes, size).camera
        assert camera is not None
        return camera

    def test_by_film(self, room: Scene, tmp_path: Path) -> None:
        camera = self.camera(tmp_path, Image.fromarray(room.image), {FILM_LENGTH: FILM}, SIZE)
        assert worst_error(room.depth, camera, room.places) < 0.01

    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_each_orientation(self, room: Scene, tmp_path: Path, orientation: int) -> None:
        undo = {1: None, 2: 0, 3: 3, 4: 1, 5: 5, 6: 2, 7: 6, 8: 4}[orientation]  # the transpose stored in the file
        stored = Image.fromarray(room.image)
        stored = stored if undo is None else stored.transpose(Image.Transpose(undo))
        camera = self.camera(tmp_path, stored, {FILM_LENGTH: FILM, ORIENTATION: orientation}, SIZE)
        np.testing.assert_array_equal(read_image(tmp_path / "room.png"), room.image)
        assert worst_error(room.depth, camera, room.places) < 0.01

    def test_resized(self, room: Scene, tmp_path: Path) -> None:
        small = Image.fromarray(room.image).resize((60, 45))
        tags = {FILM_LENGTH: FILM, WIDTH: SIZE[1], HEIGHT: SIZE[0]}
        camera = self.camera(tmp_path, small, tags, (45, 60))
        # A pixel of the small photo is seen between two of the large one.
        places = (room.places[::2, ::2] + room.places[1::2, 1::2]) / 2
        assert worst_error(room.depth[::2, ::2], camera, places) < 0.01

    def test_cropped(self, room: Scene, tmp_path: Path) -> None:
        """A strip off the top and one off the bottom, as programs cut a photo to 16:9."""
        tags = {FILM_LENGTH: FILM, WIDTH: SIZE[1], HEIGHT: SIZE[0]}
        window = np.s_[11:79]
        camera = self.camera(tmp_path, Image.fromarray(room.image[window]), tags, (68, 120))
        assert worst_error(room.depth[window], camera, room.places[window]) < 0.01


class TestChain:
    """What tells the focal length, in which order, and what is not believed."""

    def test_film_comes_first_then_the_focal_plane_then_the_sensor(self) -> None:
        nikon = {MAKE: "NIKON CORPORATION", MODEL: "NIKON D700"}  # of 36 x 23.9 mm
        assert focal({**WIDE, LENS: 4.3, **nikon}) == pytest.approx(WIDE_PX)
        assert focal({**FIFTY, **nikon}) == pytest.approx(FIFTY_PX)
        assert focal({**FIFTY, **nikon, ACROSS: 0}) == pytest.approx(50 * 300 / 23.9)
        assert focal({**FIFTY, FILM_LENGTH: 0}) == pytest.approx(FIFTY_PX)

    def test_a_focal_plane_that_is_not_that_of_the_model_is_believed_by_nobody(self) -> None:
        """A photo was made smaller by a program that wrote its new size, and left the resolution of the sensor."""
        tags: dict[int, object] = {MAKE: "NIKON CORPORATION", MODEL: "NIKON D90", LENS: 50}
        whole = 4288 / 23.6  # pixels per mm, of 23.6 x 15.8 mm
        as_taken = {**tags, ACROSS: whole, DOWN: whole, UNIT: 4}
        assert focal(as_taken, (2848, 4288)) == pytest.approx(50 * whole)
        for size in ((1424, 2144), (712, 1072)):
            assert "nobody can tell whether the photo was resized or cropped" in reason(as_taken, size)
        assert focal(tags, (1424, 2144)) == pytest.approx(50 * whole / 2, rel=0.01)

    def test_unit_of_the_focal_plane(self) -> None:
        assert focal({**FIFTY, ACROSS: 0.4 / 36, DOWN: 0.4 / 36, UNIT: 5}) == pytest.approx(FIFTY_PX)
        without = {tag: value for tag, value in FIFTY.items() if tag != UNIT}
        assert focal(without) == pytest.approx(FIFTY_PX), "inches, by the standard"
        for unit in (0, 1, 6, "inch", (2, 2)):
            assert reason({**FIFTY, UNIT: unit}).startswith("its focal plane's resolution has the unit ")

    def test_pixels_are_square(self) -> None:
        a_little = {**FIFTY, DOWN: float(FIFTY[DOWN]) * 1.02}
        assert focal(a_little) == pytest.approx(FIFTY_PX * math.sqrt(1.02))
        assert focal({tag: value for tag, value in FIFTY.items() if tag != DOWN}) == pytest.approx(FIFTY_PX)
        assert focal({**FIFTY, DOWN: 0}) == pytest.approx(FIFTY_PX)
        assert "one must be wrong" in reason({**FIFTY, DOWN: float(FIFTY[DOWN]) * 1.5})

    @pytest.mark.parametrize("value", [0, -26, math.nan, math.inf, IFDRational(26, 0), "26 mm", b"\0", (1, 2), None])
    def test_nonsense_in_every_tag(self, value: object) -> None:
        for tags in ({FILM_LENGTH: value}, {**FIFTY, LENS: value}, {**FIFTY, ACROSS: value}):
            assert len(reason(tags)) > 20
        # The others do not need to make sense where 35-mm film does.
        for tag in (LENS, ACROSS, DOWN, UNIT, ZOOM, WIDTH, HEIGHT, MAKE, MODEL, LENS_MODEL, CUSTOM):
            assert focal({**WIDE, tag: value}) == pytest.approx(WIDE_PX)

    def test_fields_of_view_that_no_lens_has(self) -> None:
        assert reason({FILM_LENGTH: 65535}) == (
            "its 35-mm focal length is 65535 mm, a field of view of 0.0303 degrees, which is nonsense"
        )
        short = {LENS: 1, ACROSS: 400 / 6, DOWN: 400 / 6, UNIT: 3}  # 6 cm of sensor
        assert "a field of view of 176 degrees, which is nonsense" in reason(short)

    def test_lens_and_film_that_no_sensor_goes_with(self) -> None:
        """Some programs of phones give 177 mm for 640 x 480 pixels of a sensor of 4032 x 3024."""
        assert focal({FILM_LENGTH: 28, LENS: 3.99}) is not None
        assert "which no sensor makes of a lens of 3.99 mm" in reason({FILM_LENGTH: 177, LENS: 3.99}, (480, 640))
        # A resolution that was left as it was when a photo was made a tenth as large, and its size was noted anew.
        assert "1.8 mm from corner to corner" in reason({**FIFTY, ACROSS: 7055.56, DOWN: 7055.56})

    def test_values_of_several_numbers(self) -> None:
        assert focal({FILM_LENGTH: (26,)}) == pytest.approx(WIDE_PX)

    def test_nothing_to_go_by(self) -> None:
        assert reason({}) == "it has no EXIF"
        assert reason({}, damage="cut short") == "its EXIF is damaged (cut short)"
        assert reason({LENS: 50}) == "its EXIF does not tell the focal length and what to measure it by"
        assert reason({LENS: 50, MAKE: "Leica", MODEL: "M3"}) == reason({LENS: 50})


class TestDigitalZoom:
    def test_apple_counts_it_in(self) -> None:
        """28 mm without zoom, and 55 with one of 1.951, of the same lens."""
        assert focal({FILM_LENGTH: 55, LENS: 3.99, ZOOM: 1.951, MAKE: "Apple"}) == pytest.approx(WIDE_PX * 55 / 26)

    def test_the_focal_length_itself_in_place_of_that_on_film(self) -> None:
        nikon = {MAKE: "NIKON CORPORATION", MODEL: "NIKON D90"}
        assert focal({FILM_LENGTH: 52, LENS: 35, **nikon}) == pytest.approx(52 / 26 * WIDE_PX)
        assert focal({FILM_LENGTH: 35, LENS: 35, **nikon}) == pytest.approx(35 * 300 / 15.6)  # by the sensor
        assert "shorter than any lens" in reason({FILM_LENGTH: 4, LENS: 4.74})
        assert focal({FILM_LENGTH: 78, LENS: 35, **nikon}) == pytest.approx(78 / 26 * WIDE_PX)  # a part of the sensor

    def test_the_sensor_decides_where_it_is_known(self) -> None:
        nikon = {MAKE: "NIKON", MODEL: "NIKON 1 J1", LENS: 10, ZOOM: 2}  # 1 inch: 2.73 times smaller than film
        assert focal({**nikon, FILM_LENGTH: 27}) == pytest.approx(WIDE_PX * 54 / 26)
        assert focal({**nikon, FILM_LENGTH: 54}) == pytest.approx(WIDE_PX * 54 / 26)
        assert focal(nikon) == pytest.approx(2 * 10 * 300 / 8.8), "4:3 has all of the sensor's height"

    def test_otherwise_nobody_can_tell(self) -> None:
        assert "nobody can tell whether that includes its digital zoom of 2" in reason({**WIDE, ZOOM: 2.0})
        assert "nobody can tell whether that includes its digital zoom of 2" in reason({**FIFTY, ZOOM: 2.0})

    @pytest.mark.parametrize("zoom", [0, 1, 1.01, 0.5, math.nan])
    def test_no_zoom(self, zoom: float) -> None:
        assert focal({**WIDE, ZOOM: zoom}) == pytest.approx(WIDE_PX)


class TestCalibration:
    """DJI's drones write how long their lens is, in pixels of the photo as it was taken."""

    # A Phantom 4 Pro: 24 mm of film are 3648 pixels of its 5472 x 3648.
    TAGS: ClassVar[dict[int, object]] = {FILM_LENGTH: 24, WIDTH: 5472, HEIGHT: 3648, MAKE: "DJI", MODEL: "FC6310"}
    NUMBERS: ClassVar[dict[str, float]] = {"focal": 3666.666504, "x": 2736.0, "y": 1824.0}

    def found(self, numbers: dict[str, float], tags: dict[int, object] | None = None) -> ExifCamera:
        return read_exif_camera(PhotoNotes(self.TAGS if tags is None else tags, calibration=numbers), (3648, 5472))

    @pytest.mark.parametrize("form", ['drone-dji:{}="{}"', "<drone-dji:{0}>{1}</drone-dji:{0}>"])
    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tif"])
    def test_is_read_and_scaled_with_the_photo(self, tmp_path: Path, form: str, suffix: str) -> None:
        names = {"focal": "CalibratedFocalLength", "x": "CalibratedOpticalCenterX", "y": "CalibratedOpticalCenterY"}
        texts = " ".join(form.format(names[key], f"{number:.6f}") for key, number in self.NUMBERS.items())
        path = photo_of(tmp_path / f"DJI_0001{suffix}", (171, 114), self.TAGS)
        with Image.open(path) as photo:
            photo.load()
            extra = {"tiffinfo": {700: texts.encode()}} if suffix == ".tif" else {"exif": exif_of(self.TAGS)}
            if suffix == ".png":
                text = PngInfo()
                text.add_itxt("XML:com.adobe.xmp", texts)
                extra["pnginfo"] = text
            elif suffix != ".tif":
                extra["xmp"] = texts.encode()
            photo.save(path, **extra)
        image, notes = read_image_with_notes(path)
        assert notes.calibration == self.NUMBERS
        if suffix != ".tif":
            found = read_exif_camera(notes, image.shape[:2])
            assert_camera(found.camera, 3666.666504 / 32, (114, 171))
            assert found.reason.startswith("its maker's calibration is 3666.67 pixels, and it had 5472 x 3648 pixels")

    @pytest.mark.parametrize("left_out", ["film", "middle"])
    def test_one_witness_is_enough(self, left_out: str) -> None:
        tags = {tag: value for tag, value in self.TAGS.items() if left_out != "film" or tag != FILM_LENGTH}
        numbers = {key: value for key, value in self.NUMBERS.items() if left_out != "middle" or key == "focal"}
        assert_camera(self.found(numbers, tags).camera, 3666.666504, (3648, 5472))

    def test_without_a_witness_it_is_not_believed(self) -> None:
        found = self.found({"focal": 3666.67}, {WIDTH: 5472, HEIGHT: 3648})
        assert (found.camera, found.reason) == (
            None, "its maker's calibration is 3666.67 pixels, which nothing else confirms"
        )  # fmt: skip

    @pytest.mark.parametrize(
        "numbers",
        [
            {**NUMBERS, "focal": 24.0},  # millimetres
            {**NUMBERS, "focal": 0.0},
            {**NUMBERS, "focal": math.nan},
            {**NUMBERS, "focal": math.inf},
            {"focal": 7333.0},  # twice as many pixels
            {**NUMBERS, "x": 1368.0, "y": 912.0},
            {**NUMBERS, "x": math.nan},
        ],
    )
    def test_film_is_believed_where_it_makes_no_sense(self, numbers: dict[str, float]) -> None:
        by_film = 24 / 43.266615 * math.hypot(5472, 3648)
        assert_camera(self.found(numbers).camera, by_film, (3648, 5472))

    def test_digital_zoom_is_not_in_it(self) -> None:
        numbers, tags = self.NUMBERS, {WIDTH: 5472, HEIGHT: 3648, ZOOM: 2.0}
        assert (
            self.found(numbers, tags).reason
            == "its maker's calibration is 3666.67 pixels, without its digital zoom of 2"
        )


class TestSizeWhenTaken:
    @pytest.mark.parametrize(
        ("size", "factor"),
        [
            ((300, 400), 1),
            ((400, 300), 1),  # turned
            ((150, 200), 0.5),
            ((200, 150), 0.5),  # turned and resized
            ((600, 800), 2),
            ((76, 101), 0.253),  # 75.75 rows, rounded up
            ((225, 400), 1),  # cropped
            ((300, 300), 1),
            ((400, 225), 1),  # cropped and turned
            ((300, 398), 1),
            ((296, 400), 1),
        ],
    )
    def test_what_became_of_it(self, size: tuple[int, int], factor: float) -> None:
        assert focal(TAKEN, size) == pytest.approx(WIDE_PX * factor, rel=1e-3)

    @pytest.mark.parametrize("size", [(200, 200), (150, 300), (299, 500), (310, 400), (300, 225)])
    def test_what_nobody_can_tell(self, size: tuple[int, int]) -> None:
        said = reason(TAKEN, size)
        assert said.startswith(f"it has {size[1]} x {size[0]} pixels and had 400 x 300 pixels when it was taken")

    def test_said(self) -> None:
        assert read_exif_camera(PhotoNotes(TAKEN), (225, 400)).reason == (
            "its 35-mm focal length is 26 mm, and it was cropped: it had 400 x 300 pixels when it was taken"
        )

    def test_stored_on_its_side(self) -> None:
        """The size when it was taken is that of the photo as it is stored."""
        notes = PhotoNotes(TAKEN, orientation=6)
        camera = read_exif_camera(notes, (400, 225)).camera
        assert camera is not None
        assert camera.focal_px == pytest.approx(WIDE_PX)


class TestOtherProjections:
    def test_panoramas(self) -> None:
        assert "panorama" in reason(WIDE, panorama=True)
        assert "panorama" in reason({**WIDE, MAKE: "Apple", CUSTOM: 6})
        assert "panorama" in reason({**WIDE, MAKE: "RICOH", MODEL: "RICOH THETA S"})
        assert "shape of a panorama" in reason(WIDE, (300, 800))
        assert focal({**WIDE, MAKE: "NIKON", CUSTOM: 6}) is not None
        assert focal({**WIDE, WIDTH: 400, HEIGHT: 300}, (100, 400)) == pytest.approx(WIDE_PX), "a strip of a photo"

    def test_panorama_by_xmp(self, tmp_path: Path) -> None:
        xmp = b'<rdf:Description GPano:ProjectionType="equirectangular"/>'
        path = photo_of(tmp_path / "photo.jpg", (40, 30), WIDE, xmp=xmp)
        found = read_exif_camera(path, (30, 40))
        assert (found.camera, found.reason) == (None, "it is a panorama, which no pinhole camera takes")

    def test_lenses_that_bend_lines(self) -> None:
        for lens in ("EF8-15mm f/4L FISHEYE USM", "AF Fish-Eye-Nikkor 16mm"):
            assert "fisheye, which bends straight lines: undistort it first" in reason({**WIDE, LENS_MODEL: lens})
        assert "GoPros bend straight lines" in reason({**WIDE, MAKE: "GoPro"})


class TestDamage:
    def test_zero_denominator_in_a_file(self, tmp_path: Path) -> None:
        content = exif_of({**FIFTY, LENS: IFDRational(5011, 97)}).tobytes()
        (order,) = {b"II": "<", b"MM": ">"}[content[6:8]]
        broken = content.replace(struct.pack(order + "II", 5011, 97), struct.pack(order + "II", 5011, 0))
        assert broken != content
        Image.new("RGB", (40, 30)).save(tmp_path / "photo.jpg", exif=broken)
        assert read_exif_camera(tmp_path / "photo.jpg", (30, 40)).reason == (
            "its focal length is nan mm, which is nonsense"
        )

    @pytest.mark.filterwarnings("ignore::UserWarning")
    @given(places=st.lists(st.tuples(st.integers(6, 250), st.integers(0, 255)), max_size=8), length=st.integers(0, 300))
    def test_damaged_bytes(self, places: list[tuple[int, int]], length: int) -> None:
        tags = {**FIFTY, **WIDE, ORIENTATION: 6, MAKE: "NIKON", MODEL: "NIKON D90", WIDTH: 40, HEIGHT: 30}
        content = bytearray(exif_of(tags).tobytes())
        for place, value in places:
            content[place % len(content)] = value
        picture = Image.new("RGB", (40, 30))
        picture.info["exif"] = bytes(content[:length])
        found = read_exif_camera(picture, (40, 30))
        assert found.reason
        if found.camera is not None:
            assert 0.9 < max(found.camera.fov_x, found.camera.fov_y) < 171

    VALUES = st.one_of(
        st.none(), st.integers(-(2**63), 2**63), st.floats(), st.text(max_size=60), st.binary(max_size=60),
        st.booleans(), st.tuples(st.floats(), st.floats()), st.tuples(st.integers()),
    )  # fmt: skip
    TAGS = st.sampled_from(
        [MAKE, MODEL, LENS, FILM_LENGTH, ZOOM, ACROSS, DOWN, UNIT, WIDTH, HEIGHT, CUSTOM, LENS_MODEL]
    )

    @given(
        tags=st.dictionaries(TAGS, VALUES),
        base=st.sampled_from([{}, WIDE, FIFTY]),
        size=st.tuples(st.integers(1, 500), st.integers(1, 500)),
        orientation=st.integers(1, 8),
    )
    def test_any_values(
        self, tags: dict[int, object], base: dict[int, object], size: tuple[int, int], orientation: int
    ) -> None:
        found = read_exif_camera(PhotoNotes({**base, **tags}, orientation), size)
        assert found.reason
        assert "\n" not in found.reason
        if found.camera is not None:
            assert (found.camera.size, found.camera.source) == (size, "exif")
