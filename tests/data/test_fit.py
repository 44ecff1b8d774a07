"""Maps that are smaller than their photo, lie on their side, or may lie upside down."""

import re

import numpy as np
import pytest

from zoedepth.data.fit import check_fit, says_how_it_lies, spread
from zoedepth.errors import InputError

NAMES = ("a.jpg", "a.png")


@pytest.mark.parametrize(
    ("size", "orientation", "said"),
    [((4, 6), 1, True), ((4, 6), 6, True), ((4, 4), 6, False), ((4, 6), 3, False), ((4, 6), 2, False)],
)
def test_only_a_turn_by_90_degrees_shows_in_the_size(size: tuple[int, int], orientation: int, said: bool) -> None:
    assert says_how_it_lies(size, orientation) == said


@pytest.mark.parametrize("found", [(1440, 1920), (192, 256), (480, 640), (144, 192), (9, 12), (960, 1280)])
def test_size_of_the_photo_and_smaller_ones_of_its_proportions_fit(found: tuple[int, int]) -> None:
    check_fit((1440, 1920), found, names=NAMES)


def test_proportions_are_the_same_up_to_a_percent() -> None:
    check_fit((968, 1296), (480, 640), names=NAMES)  # ScanNet's
    with pytest.raises(InputError, match="proportions differ"):
        check_fit((1080, 1920), (192, 256), names=NAMES)
    with pytest.raises(InputError, match="proportions differ"):
        check_fit((1440, 1920), (1, 1), names=NAMES)


@pytest.mark.parametrize(
    ("size", "found", "orientation", "why"),
    [
        ((1920, 1440), (1440, 1920), 6, "EXIF orientation 6 turns the photo by 90 degrees.* Turn the map, too"),
        ((1920, 1440), (192, 256), 8, "EXIF orientation 8 turns the photo by 90 degrees"),
        ((1920, 1440), (1440, 1920), 1, "one of them lies on its side"),
        ((480, 640), (470, 627), 1, "the map is a little smaller.*Crop or resize the photo to 627 x 470"),
        ((480, 640), (960, 1280), 1, "the map is larger.*resize the map to 640 x 480 without mixing"),
        ((480, 640), (480, 600), 1, "their proportions differ"),
    ],
)
def test_error_says_why_sizes_differ_and_what_to_do(
    size: tuple[int, int], found: tuple[int, int], orientation: int, why: str
) -> None:
    sizes = re.escape(f"a.jpg is {size} and a.png is {found} (height, width): sizes must agree, but ")
    with pytest.raises(InputError, match=f"{sizes}.*{why}"):
        check_fit(size, found, names=NAMES, orientation=orientation)


def test_values_are_put_where_they_are_in_the_photo_and_nothing_between_them() -> None:
    points = spread(np.array([[1.0, 2.0], [3.0, 4.0]], np.float32), (4, 6))
    expected = np.zeros((4, 6), np.float32)
    expected[1, 1], expected[1, 4], expected[3, 1], expected[3, 4] = 1, 2, 3, 4
    np.testing.assert_array_equal(points, expected)
    assert points.dtype == np.float32


@pytest.mark.parametrize(("small", "size"), [((192, 256), (1440, 1920)), ((7, 9), (11, 14)), ((3, 4), (301, 399))])
def test_no_value_is_lost_and_each_is_nearest_to_its_own_place(small: tuple[int, int], size: tuple[int, int]) -> None:
    values = np.arange(1, small[0] * small[1] + 1).reshape(small)
    points = spread(values, size)
    np.testing.assert_array_equal(points[points > 0], values.ravel())
    for side in (0, 1):
        places = np.nonzero((points > 0).any(1 - side))[0]
        middles = (np.arange(small[side]) + 0.5) * size[side] / small[side] - 0.5
        assert np.abs(places - middles).max() <= 0.5


def test_map_of_the_photos_size_is_left_alone() -> None:
    values = np.ones((2, 3))
    assert spread(values, (2, 3)) is values
