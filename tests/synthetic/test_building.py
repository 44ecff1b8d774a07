import numpy as np
import pytest
from tests.synthetic.measuring import boxes, built, extent, loose, numbers

from zoedepth.synthetic.building import block, house, shop
from zoedepth.synthetic.traffic import WINDOW

SEEDS = range(30)


@pytest.mark.parametrize("near", [True, False])
def test_block_stands_behind_its_front_and_has_its_floors(near: bool) -> None:
    for seed in SEEDS:
        scene = built(lambda frame, rng: block(frame, rng, 15, 10, 4, near=near), seed)
        low, high = extent(scene)
        wall = boxes(scene)[0]
        np.testing.assert_allclose(wall[0], (-7.5, 0, 0), atol=1e-6)
        np.testing.assert_allclose(wall[1, :2], (7.5, 10), atol=1e-6)
        assert 4 * 2.8 < wall[1, 2] < 4 * 3.5 + 0.51
        assert scene.parts[0][1].scale == pytest.approx((wall[1, 2] - 0.3) / 4, abs=0.06)  # windows at each storey
        assert low[2] == pytest.approx(0, abs=1e-6)
        assert high[2] < wall[1, 2] + 5.2
        assert low[1] > -1.5
        assert high[1] < 10.5
        assert not loose(scene, gap=0.11)  # the sign of a shop hangs 10 cm before the wall
        assert near or len(scene.parts) < 6


def test_house_has_a_door_windows_and_a_roof_above_its_walls() -> None:
    for seed in SEEDS:
        scene = built(lambda frame, rng: house(frame, rng, 9, 8), seed)
        bounds = boxes(scene)
        low, high = extent(scene)
        wall = bounds[0]
        assert 2.6 < wall[1, 2] < 6.1
        assert low[2] == pytest.approx(0, abs=1e-6)
        assert wall[1, 2] + 1.9 < high[2] < wall[1, 2] + 5.6
        roofs = [b for b, part in zip(bounds, scene.parts, strict=True) if part[0] in ("gable", "hip")]
        assert all(b[0, 2] >= wall[1, 2] - 0.03 for b in roofs)
        panes = [b for b, part in zip(bounds, scene.parts, strict=True) if part[1] == WINDOW]
        assert len(panes) >= 2
        for b in panes:
            assert b[0, 1] < 0 < b[1, 1]  # in the front wall, and standing out of it
            assert 0.85 < b[0, 2] % 2.6 < 1.35
        assert not loose(scene, gap=0.035)  # shutters stand 3 cm off the wall


def test_show_windows_are_in_the_ground_floor() -> None:
    for seed in SEEDS:
        scene = built(lambda frame, rng: shop(frame, rng, 10, 3.0), seed)
        low, high = extent(scene)
        assert high[2] < 3.95
        assert low[2] >= 0
        assert np.abs([low[0], high[0]]).max() < 5.1
        assert low[1] > -1.5
        board = boxes(scene)[next(i for i, part in enumerate(scene.parts) if part[2][3] == pytest.approx(9))]
        assert 2.3 < board[0, 2] < 2.5


def test_seed_decides() -> None:
    scenes = [numbers(built(lambda frame, rng: block(frame, rng, 15, 10, 4, near=True), seed)) for seed in (1, 1, 2)]
    assert scenes[0] == scenes[1] != scenes[2]
