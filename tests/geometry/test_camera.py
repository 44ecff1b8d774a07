"""What is done to a photo and to its camera commutes with projection, in formulas and in a rendered room."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageOps
from tests.geometry.scene import FOCAL, SIZE, rendered_room, worst_error

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera, Intrinsics, depth_of_distance

CAMERA = Intrinsics(fx=500.0, fy=520.0, cx=310.5, cy=247.0)
PHOTO = Camera.of(CAMERA, (480, 640))
OFFSETS = st.floats(-200, 200)
PIXELS = st.integers(-200, 200)
SIZES = st.tuples(st.integers(1, 3000), st.integers(1, 3000))
FACTORS = st.floats(0.1, 10)
POINTS = st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(0.1, 80))


def project(camera: Intrinsics, point: tuple[float, float, float]) -> np.ndarray:
    """Column and row at which a camera sees a point (x right, y down, z forward, metres)."""
    x, y, z = point
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


@given(point=POINTS, top=OFFSETS, left=OFFSETS)
def test_a_window_sees_the_point_at_its_own_rows_and_columns(
    point: tuple[float, float, float], top: float, left: float
) -> None:
    expected = project(CAMERA, point) - (left, top)
    np.testing.assert_allclose(project(CAMERA.cropped(top, left), point), expected, atol=1e-6)


@given(point=POINTS, vertical=FACTORS, horizontal=FACTORS)
def test_resizing_scales_distances_from_the_corner_of_the_photo(
    point: tuple[float, float, float], vertical: float, horizontal: float
) -> None:
    """The corner is half a pixel outside the centre of the first pixel."""
    expected = (project(CAMERA, point) + 0.5) * (horizontal, vertical) - 0.5
    np.testing.assert_allclose(project(CAMERA.scaled(vertical, horizontal), point), expected, rtol=1e-9, atol=1e-6)


@given(point=POINTS, width=st.integers(1, 5000))
def test_the_mirrored_photo_shows_the_mirrored_point(point: tuple[float, float, float], width: int) -> None:
    x, y, z = point
    column, row = project(CAMERA, point)
    np.testing.assert_allclose(project(CAMERA.mirrored(width), (-x, y, z)), (width - 1 - column, row), atol=1e-6)


@given(top=OFFSETS, left=OFFSETS, vertical=FACTORS, horizontal=FACTORS)
def test_the_order_of_cropping_and_resizing_does_not_matter(
    top: float, left: float, vertical: float, horizontal: float
) -> None:
    one = CAMERA.cropped(top, left).scaled(vertical, horizontal)
    other = CAMERA.scaled(vertical, horizontal).cropped(top * vertical, left * horizontal)
    np.testing.assert_allclose(list(vars(one).values()), list(vars(other).values()), rtol=1e-9, atol=1e-6)


def test_the_middle_of_the_photo_stays_the_middle() -> None:
    middle = Intrinsics(fx=500.0, fy=500.0, cx=(640 - 1) / 2, cy=(480 - 1) / 2)
    assert middle.mirrored(640) == middle
    half = middle.scaled(0.5, 0.5)
    assert (half.fx, half.cx, half.cy) == (250, (320 - 1) / 2, (240 - 1) / 2)


def test_rays_are_what_each_pixel_sees() -> None:
    rays = CAMERA.rays((3, 4))
    assert rays.shape == (3, 4, 3)
    assert rays.dtype == np.float32
    assert (rays[..., 2] == 1).all()
    for row in range(3):
        for column in range(4):
            np.testing.assert_allclose(project(CAMERA, tuple(7 * rays[row, column])), (column, row), atol=1e-3)


@pytest.mark.parametrize("size", [(1, 1), (30, 40)])
def test_depth_of_a_wall_is_the_same_everywhere_though_its_corners_are_farther(size: tuple[int, int]) -> None:
    camera = Intrinsics(fx=20.0, fy=20.0, cx=(size[1] - 1) / 2, cy=(size[0] - 1) / 2)
    wall = 3 * camera.rays(size)
    depth = depth_of_distance(np.linalg.norm(wall, axis=-1).astype(np.float32), camera)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, 3, rtol=1e-5)


@given(point=POINTS, top=PIXELS, left=PIXELS, size=SIZES)
def test_crops_and_padding(point: tuple[float, float, float], top: int, left: int, size: tuple[int, int]) -> None:
    expected = project(CAMERA, point)
    crop = PHOTO.cropped(top, left, size)
    assert (crop.size, crop.source) == (size, "given")
    np.testing.assert_allclose(crop.project(np.array(point)), expected - (left, top), atol=1e-6)
    np.testing.assert_allclose(
        PHOTO.padded(top, left, size).project(np.array(point)), np.add(expected, (left, top)), atol=1e-6
    )


@given(point=POINTS, size=SIZES)
def test_resizing_to_a_size(point: tuple[float, float, float], size: tuple[int, int]) -> None:
    """Borders stay borders: pixels are as much wider as the photo is."""
    factors = np.array([size[1] / 640, size[0] / 480])
    expected = (project(CAMERA, point) + 0.5) * factors - 0.5
    np.testing.assert_allclose(PHOTO.resized(size).project(np.array(point)), expected, rtol=1e-9, atol=1e-6)


@given(point=POINTS, quarter_turns=st.integers(-5, 9), mirror=st.booleans())
def test_mirrored_and_turned(point: tuple[float, float, float], quarter_turns: int, mirror: bool) -> None:
    """What the pixels of the photo do, the picture of a point does: ``np.rot90`` of a photo that has one pixel lit."""
    x, y, z = point
    column, row = project(CAMERA, point)
    height, width = PHOTO.size
    camera = PHOTO
    if mirror:
        x, column, camera = -x, width - 1 - column, camera.mirrored()
    for _ in range(quarter_turns % 4):  # what was on the right comes to the top, and what was below, to the right
        x, y, column, row = y, -x, row, width - 1 - column
        height, width = width, height
    turned = camera.rotated(quarter_turns)
    assert turned.size == (height, width)
    np.testing.assert_allclose(turned.project(np.array([x, y, z])), (column, row), atol=1e-6)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientations_are_those_of_pillow(orientation: int) -> None:
    """One lit pixel goes where Pillow's reading of the orientation takes it."""
    stored = np.zeros((5, 7), np.uint8)
    stored[1, 4] = 255
    exif = Image.Exif()
    exif[0x0112] = orientation
    picture = Image.fromarray(stored)
    picture.info["exif"] = exif.tobytes()
    upright = np.asarray(ImageOps.exif_transpose(picture))
    (row,), (column,) = np.nonzero(upright)
    # The axis of this camera goes through the lit pixel, and has to go through it ever after.
    camera = Camera((5, 7), 10.0, 20.0, 4.0, 1.0).upright(orientation)
    assert (camera.size, camera.cx, camera.cy) == (upright.shape, column, row)
    assert (camera.fx, camera.fy) == ((10.0, 20.0) if orientation < 5 else (20.0, 10.0))
    assert camera.source == "given"


def test_what_a_camera_says_of_itself() -> None:
    assert Camera.from_matrix(PHOTO.matrix, PHOTO.size) == PHOTO
    assert PHOTO.intrinsics == CAMERA
    assert PHOTO.resized(PHOTO.size) is PHOTO
    assert PHOTO.focal_px == math.sqrt(500 * 520)
    assert Camera.from_focal(1 / 3, (10, 20)).focal_px == 1 / 3
    np.testing.assert_array_equal(PHOTO.rays(), CAMERA.rays(PHOTO.size))
    np.testing.assert_allclose(PHOTO.project(5 * PHOTO.ray(17.25, 400)), (17.25, 400))
    assert PHOTO.project(np.ones((2, 3, 3))).shape == (2, 3, 2)


@pytest.mark.parametrize(
    ("field", "focal"),
    [
        # The half of a side over the tangent of the half of the angle: 320 / tan 45, 240 / tan 30, 400 / tan 45.
        ({"horizontal": 90}, 320),
        ({"vertical": 60}, 240 * math.sqrt(3)),
        ({"diagonal": 90}, 400),
    ],
)
def test_fields_of_view(field: dict[str, float], focal: float) -> None:
    camera = Camera.from_fov((480, 640), **field, source="assumed")
    assert (camera.cx, camera.cy, camera.source) == (319.5, 239.5, "assumed")
    assert camera.fx == camera.fy == pytest.approx(focal)
    if "horizontal" in field:
        assert camera.fov_x == pytest.approx(90)
        assert camera.fov_y == pytest.approx(2 * math.degrees(math.atan(240 / 320)))


def test_field_of_view_of_a_window_to_the_side() -> None:
    """A window on the right half of 90 degrees sees from 0 to 45 degrees."""
    window = Camera.from_fov((480, 640), horizontal=90).cropped(0, 320, (480, 320))
    assert window.fov_x == pytest.approx(45)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Camera((0, 5), 1, 1, 0, 0), "at least 1 x 1 pixels, got 5 x 0"),
        (lambda: Camera((4, 5), 0, 1, 0, 0), "focal length fx must be above 0"),
        (lambda: Camera((4, 5), 1, -3, 0, 0), "focal length fy must be above 0.*it is -3"),
        (lambda: Camera((4, 5), math.nan, 1, 0, 0), "focal length fx .*nan"),
        (lambda: Camera((4, 5), math.inf, 1, 0, 0), "focal length fx .*inf"),
        (lambda: Camera((4, 5), 1, 1, math.nan, 0), "principal point cx .*nan"),
        (lambda: Camera((4, 5), 1, 1, 0, -math.inf), "principal point cy .*inf"),
        (lambda: Camera.from_matrix(np.eye(4), (4, 5)), r"3 x 3 numbers, got an array of shape \(4, 4\)"),
        (lambda: Camera.from_matrix(np.ones((3, 3)), (4, 5)), r"must be \[\[fx, 0, cx\]"),
        (lambda: Camera.from_matrix(np.diag([5.0, 5.0, 2.0]), (4, 5)), r"must be \[\[fx, 0, cx\]"),
        (lambda: Camera.from_fov((4, 5)), "one of the horizontal, vertical and diagonal fields of view, got none"),
        (lambda: Camera.from_fov((4, 5), horizontal=5, vertical=5), "got .*horizontal.*vertical"),
        (lambda: Camera.from_fov((4, 5), horizontal=180), "between 0 and 180 degrees; it is 180"),
        (lambda: Camera.from_fov((4, 5), vertical=-1), "between 0 and 180 degrees; it is -1"),
        (lambda: Camera.from_fov((4, 5), diagonal=math.nan), "between 0 and 180 degrees; it is nan"),
        (lambda: Camera.from_fov((4, 5), horizontal=5e-324), "must be in degrees; it is 5e-324, which no camera has"),
        (lambda: Camera.from_fov((4, 5), diagonal=1e-6), "must be in degrees; it is 1e-06, which no camera has"),
        (lambda: PHOTO.upright(0), "a number from 1 to 8, got 0"),
        (lambda: PHOTO.upright(9), "a number from 1 to 8, got 9"),
    ],
)
def test_nonsense_is_refused(make: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


class TestRenderedRoom:
    """Depth of a rendered room becomes points, which land where they were seen, whatever is done to the photo."""

    SHIFT = (9.0, -6.0)
    CAMERA = Camera(SIZE, FOCAL, FOCAL, (SIZE[1] - 1) / 2 + 9, (SIZE[0] - 1) / 2 - 6)

    def test_as_it_is(self) -> None:
        room = rendered_room(self.SHIFT)
        assert worst_error(room.depth, self.CAMERA, room.places, shift=self.SHIFT) < 0.01
        # The check itself notices a pixel and a few percent.
        assert worst_error(room.depth, self.CAMERA.cropped(0, 1, SIZE), room.places, shift=self.SHIFT) > 0.5
        longer = Camera.of(self.CAMERA.intrinsics.scaled(1.02, 1.02), SIZE)
        assert worst_error(room.depth, longer, room.places, shift=self.SHIFT) > 0.5

    @pytest.mark.parametrize("field", ["horizontal", "vertical", "diagonal"])
    def test_field_of_view(self, field: str) -> None:
        side = {"horizontal": SIZE[1], "vertical": SIZE[0], "diagonal": math.hypot(*SIZE)}[field]
        room = rendered_room()
        camera = Camera.from_fov(SIZE, **{field: 2 * math.degrees(math.atan(side / 2 / FOCAL))})
        assert worst_error(room.depth, camera, room.places) < 0.01

    def test_crop(self) -> None:
        room = rendered_room(self.SHIFT)
        camera = self.CAMERA.cropped(11, 20, (60, 77))
        window = np.s_[11:71, 20:97]
        assert worst_error(room.depth[window], camera, room.places[window], shift=self.SHIFT) < 0.01

    def test_padding(self) -> None:
        room = rendered_room(self.SHIFT)
        around = ((7, 3), (5, 9))
        depth = np.pad(room.depth, around)
        camera = self.CAMERA.padded(7, 5, depth.shape)
        places = np.pad(room.places, (*around, (0, 0)))
        assert worst_error(depth, camera, places, shift=self.SHIFT) < 0.01

    @pytest.mark.parametrize("size", [(45, 60), (180, 240), (60, 150)])
    def test_resized(self, size: tuple[int, int]) -> None:
        room = rendered_room(self.SHIFT)
        depth = np.asarray(Image.fromarray(room.depth).resize(size[::-1], Image.Resampling.NEAREST))
        rows, columns = ((np.arange(new) + 0.5) * old / new - 0.5 for new, old in zip(size, SIZE, strict=True))
        places = np.stack(np.meshgrid(columns, rows), axis=-1)  # of the middles of the new pixels
        assert worst_error(depth, self.CAMERA.resized(size), places, shift=self.SHIFT) < 0.01

    def test_mirrored(self) -> None:
        room = rendered_room(self.SHIFT)
        depth, places = room.depth[:, ::-1], room.places[:, ::-1]
        axes = np.diag([-1.0, 1, 1])
        assert worst_error(depth, self.CAMERA.mirrored(), places, shift=self.SHIFT, axes=axes) < 0.01

    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_stored_in_each_orientation(self, orientation: int) -> None:
        """The photo is taken as it is stored; upright, its right and its below are other directions of the room."""
        room = rendered_room(self.SHIFT)
        upright = {
            1: lambda a: a,
            2: lambda a: a[:, ::-1],
            3: lambda a: a[::-1, ::-1],
            4: lambda a: a[::-1],
            5: lambda a: a.swapaxes(0, 1),
            6: lambda a: a[::-1].swapaxes(0, 1),
            7: lambda a: a[::-1, ::-1].swapaxes(0, 1),
            8: lambda a: a[:, ::-1].swapaxes(0, 1),
        }[orientation]
        right, down = {  # of the upright photo, in the axes of the stored one
            1: ((1, 0), (0, 1)), 2: ((-1, 0), (0, 1)), 3: ((-1, 0), (0, -1)), 4: ((1, 0), (0, -1)),
            5: ((0, 1), (1, 0)), 6: ((0, -1), (1, 0)), 7: ((0, -1), (-1, 0)), 8: ((0, 1), (-1, 0)),
        }[orientation]  # fmt: skip
        axes = np.array([(*right, 0), (*down, 0), (0, 0, 1)]).T
        camera = self.CAMERA.upright(orientation)
        assert worst_error(upright(room.depth), camera, upright(room.places), shift=self.SHIFT, axes=axes) < 0.01
