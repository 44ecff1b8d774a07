import colorsys
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zoedepth.synthetic import palette
from zoedepth.synthetic.textures import PATTERNS

UNIT = st.floats(0, 1)
DRAWS = {
    **{name: getattr(palette, name) for name in (
        "wood", "cloth", "leather", "metal", "plastic", "ceramic", "glass", "wall_paint", "bricks", "floor_covering",
        "leaves", "bark", "picture")},
    "writing": partial(palette.writing, size=0.1),
}  # fmt: skip


@pytest.mark.parametrize("name", DRAWS)
def test_materials_are_ones_that_can_be_rendered(name: str) -> None:
    rng = np.random.default_rng(1)
    found = [DRAWS[name](rng) for _ in range(200)]
    for material in found:
        assert material.pattern in PATTERNS
        assert all(0 <= value <= 1 for value in (*material.color, *material.second))
        assert 0.01 < material.scale < 5
        assert 0 <= material.gloss <= 1
        assert 0 <= material.mirror <= 1
        assert material.known
        assert material.glow == 0
    assert len({material.color for material in found}) > (4 if name == "metal" else 100)


def test_metal_and_glass_mirror_more_than_wood_and_cloth() -> None:
    rng = np.random.default_rng(2)
    mirrors = {name: max(DRAWS[name](rng).mirror for _ in range(50)) for name in ("metal", "glass", "wood", "cloth")}
    assert min(mirrors["metal"], mirrors["glass"]) > 0.2
    assert mirrors["wood"] == mirrors["cloth"] == 0


def test_leaves_are_mostly_green_and_glass_is_dark() -> None:
    rng = np.random.default_rng(3)
    colors = np.array([DRAWS["leaves"](rng).color for _ in range(300)])
    assert (colors.argmax(1) == 1).mean() > 0.75
    assert max(max(DRAWS["glass"](rng).color) for _ in range(100)) < 0.2


def test_writing_is_as_large_as_asked_for_and_legible() -> None:
    rng = np.random.default_rng(4)
    dark_on_light = 0
    for _ in range(100):
        material = palette.writing(rng, 0.07)
        assert material.scale == 0.07
        dark_on_light += max(material.color) > max(material.second)
    assert 50 < dark_on_light < 90


@given(UNIT, UNIT, UNIT, st.integers(-3, 3))
def test_hue_goes_round(hue: float, saturation: float, value: float, turns: int) -> None:
    expected = colorsys.hsv_to_rgb(hue, saturation, value)
    np.testing.assert_allclose(palette.hsv(hue + turns, saturation, value), expected, atol=1e-9)


def test_colours_out_of_range_are_clipped() -> None:
    assert palette.hsv(0, 2, 5) == (1, 0, 0)
    assert palette.hsv(0, -1, -1) == (0, 0, 0)
    assert palette.scaled((0.2, 0.5, 0.9), 2) == (0.4, 1, 1)


def test_colours_are_mixed_half_and_half() -> None:
    assert palette.mixed((0, 0.2, 1), (1, 0.4, 0)) == pytest.approx((0.5, 0.3, 0.5))


def test_scaled_material_changes_both_colours_alone() -> None:
    material = palette.Material("tiles", (0.4, 0.4, 0.4), (0.2, 0.2, 0.2), gloss=0.3)
    darker = palette.scaled_material(material, 0.5)
    assert darker == material._replace(color=(0.2, 0.2, 0.2), second=(0.1, 0.1, 0.1))


def test_every_choice_is_drawn_about_as_often() -> None:
    rng = np.random.default_rng(5)
    counts = np.unique([palette.pick(rng, "a", "b", "c") for _ in range(900)], return_counts=True)[1]
    assert counts.min() > 240


def test_any_color_keeps_to_its_ranges() -> None:
    rng = np.random.default_rng(6)
    for _ in range(200):
        _, saturation, value = colorsys.rgb_to_hsv(*palette.any_color(rng, saturation=(0.2, 0.4), value=(0.5, 0.6)))
        assert 0.2 - 1e-9 <= saturation <= 0.4 + 1e-9
        assert 0.5 <= value <= 0.6
