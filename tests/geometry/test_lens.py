"""What is known of a camera becomes the camera of a photo of any size, or is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera, Intrinsics
from zoedepth.geometry.lens import Lens, camera_of

OFF_CENTRE = Camera((480, 640), 500.0, 505.0, 310.25, 251.125)
SIDES = st.integers(20, 4000)


@pytest.mark.parametrize(
    ("lens", "field_of_view"),
    [(Lens(fov_x=70), "fov_x"), (Lens(fov_y=50), "fov_y")],
    ids=["horizontal", "vertical"],
)
def test_a_field_of_view_is_that_of_photos_of_any_size(lens: Lens, field_of_view: str) -> None:
    for size in ((480, 640), (3000, 4000), (640, 480), (1, 1)):
        camera = lens.camera(size)
        assert getattr(camera, field_of_view) == pytest.approx(getattr(lens, field_of_view))
        assert (camera.size, camera.source) == (size, "given")
        assert (camera.cx, camera.cy) == ((size[1] - 1) / 2, (size[0] - 1) / 2)


def test_the_diagonal_is_the_same_for_upright_and_lying_photos() -> None:
    lying, upright = Lens(fov_diagonal=90).camera((300, 400)), Lens(fov_diagonal=90).camera((400, 300))
    assert lying.fx == pytest.approx(250)  # half the diagonal of 500 pixels, at 45 degrees
    assert lying.rotated(1) == upright
    assert Lens(focal_px=250).camera((300, 400)).fov_x == pytest.approx(2 * math.degrees(math.atan(200 / 250)))


@pytest.mark.parametrize(
    "known",
    [{}, {"fov_x": 70, "focal_px": 500}, {"fov_x": 0}, {"fov_x": 180}, {"fov_y": -5}, {"fov_diagonal": math.nan},
     {"focal_px": 0}, {"focal_px": -500}, {"focal_px": math.inf}],
    ids=str,
)  # fmt: skip
def test_what_no_lens_has_is_refused_before_there_is_a_photo(known: dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"a lens needs one of|must be (between|above) 0"):
        Lens(**known)


def test_what_is_known_comes_back_to_the_last_bit() -> None:
    assert camera_of(OFF_CENTRE, (480, 640)) is OFF_CENTRE
    intrinsics = Intrinsics(1000 / 3, 1000 * (0.1 + 0.2), 320 + 1e-7, 240.0)
    assert camera_of(intrinsics, (480, 640)).intrinsics == intrinsics


@pytest.mark.parametrize("place", [(159.4, 239.5), (319.5, 119.4), (480.0, 239.5), (319.5, 360.0)])
def test_intrinsics_that_look_past_the_middle_are_of_another_photo(place: tuple[float, float]) -> None:
    with pytest.raises(InputError, match=r"far from the middle of a photo of 640 x 480 pixels.*Scale them"):
        camera_of(Intrinsics(500, 500, *place), (480, 640))


@pytest.mark.parametrize("known", [Lens(focal_px=26), Lens(focal_px=0.81), Intrinsics(4e5, 4e5, 319.5, 239.5)])
def test_focal_lengths_in_another_unit_are_refused(known: Lens | Intrinsics) -> None:
    with pytest.raises(InputError, match=r"degrees along the 640 pixels of the photo, .* in pixels, and not in millim"):
        camera_of(known, (480, 640))


@pytest.mark.parametrize(
    ("name", "value"), [("fov_x", 0.69), ("fov_x", 1.2), ("fov_y", 2.79), ("fov_y", 175.0), ("fov_diagonal", 0.5)]
)
def test_fields_of_view_in_another_unit_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=rf"{name} is {value:g} degrees, and it must be 2.8 to 160: radians"):
        Lens(**{name: value})


@given(height=SIDES, width=SIDES, factor=st.floats(0.05, 1))
def test_a_resized_photo_has_the_resized_camera(height: int, width: int, factor: float) -> None:
    """Sides are rounded to whole pixels, down or to the nearest, in either direction."""
    large = Lens(fov_x=60).camera((height, width))
    for rounded in (math.floor, round):
        size = (max(1, rounded(height * factor)), max(1, rounded(width * factor)))
        assert camera_of(large, size) == large.resized(size)
        small = large.resized(size)
        assert camera_of(small, (height, width)) == small.resized((height, width))


def test_a_camera_that_looks_through_the_middle_may_be_turned() -> None:
    camera = Camera((480, 640), 500.0, 510.0, 319.5, 239.5)
    assert camera_of(camera, (1280, 960)) == Camera((1280, 960), 1020.0, 1000.0, 479.5, 639.5)


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ((640, 480), "of photos of 640 x 480 pixels, and the photo has 480 x 640: one of them is turned"),
        ((480, 600), "of photos of 640 x 480 pixels, and the photo has 600 x 480, of other proportions"),
        ((360, 640), "of other proportions, so it was cropped"),
        ((479, 640), "of other proportions, so it was cropped"),
    ],
)
def test_a_camera_of_another_size_is_refused_and_both_sizes_are_told(size: tuple[int, int], message: str) -> None:
    with pytest.raises(InputError, match=message):
        camera_of(OFF_CENTRE, size)
