import pytest
from hypothesis import given
from hypothesis import strategies as st

from zoedepth.sizes import network_focal, network_size

SIDES = st.integers(min_value=1, max_value=5000)


@pytest.mark.parametrize(
    ("size", "target", "expected"),
    [
        # Measured in the released code, whose photos are padded first: 480x640 becomes 572x746, and so on.
        ((572, 746), (384, 512), (384, 512)),
        ((457, 1390), (384, 512), (384, 1152)),
        ((513, 661), (384, 512), (384, 512)),
        ((1218, 2104), (384, 512), (384, 672)),
        # Not padded.
        ((480, 640), (384, 512), (384, 512)),
        ((1080, 1920), (384, 512), (384, 672)),
        ((640, 480), (384, 512), (672, 512)),  # the width changes least, so it is the one that fits
        ((384, 512), (384, 512), (384, 512)),
    ],
)
def test_sizes_of_the_released_models(size: tuple[int, int], target: tuple[int, int], expected: tuple[int, int]):
    assert network_size(size, target) == expected


def test_halves_are_rounded_to_even():
    assert network_size((64, 80), (64, 512)) == (64, 64)  # 2.5 times 32
    assert network_size((64, 112), (64, 512)) == (64, 128)  # 3.5 times 32


def test_no_side_is_less_than_one_multiple():
    assert network_size((1000, 10), (384, 512)) == (384, 32)
    assert network_size((10, 1000), (384, 512)) == (32, 512)


def test_fixed_size_takes_no_notice_of_the_photo():
    assert network_size((1080, 1920), (256, 256), keep_aspect_ratio=False) == (256, 256)


def test_multiple_is_the_callers():
    assert network_size((100, 100), (99, 99), multiple=14) == (98, 98)


@given(height=SIDES, width=SIDES, target=st.tuples(st.integers(1, 20), st.integers(1, 20)))
def test_sides_are_multiples_and_one_fits_the_target(height: int, width: int, target: tuple[int, int]):
    target = (32 * target[0], 32 * target[1])
    found = network_size((height, width), target)
    assert all(side >= 32 and side % 32 == 0 for side in found)
    assert found[0] == target[0] or found[1] == target[1]


@given(height=SIDES, width=SIDES)
def test_a_turned_photo_gets_a_turned_size(height: int, width: int):
    found = network_size((height, width), (384, 512))
    turned = network_size((width, height), (512, 384))
    assert turned == (found[1], found[0]) or abs(1 - 384 / height) == abs(1 - 512 / width)


# --- the focal length that the network sees ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("focal_px", "height", "network_height", "expected"),
    [
        (500.0, 480, 480, 500.0),
        (500.0, 480, 240, 250.0),
        (500.0, 960, 480, 250.0),  # a photo of 480 rows that is padded by 240 on each side looks half as large
        (519.4696, 480, 384, 415.58),  # NYU in the released models
    ],
)
def test_focal_length_follows_the_height(focal_px: float, height: int, network_height: int, expected: float):
    assert network_focal(focal_px, height, network_height) == pytest.approx(expected, abs=0.005)
