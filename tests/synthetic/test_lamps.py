import math

import numpy as np
import pytest
from tests.synthetic.measuring import boxes, built, extent, loose

from zoedepth.synthetic.lamps import ceiling_lamps, floor_lamp, table_lamp
from zoedepth.synthetic.scene import Scene

SEEDS = range(60)


@pytest.mark.parametrize(("build", "low", "high"), [(table_lamp, 0.3, 0.62), (floor_lamp, 1.38, 2.05)])
def test_lamp_stands_and_its_light_is_in_its_shade(build, low: float, high: float) -> None:
    on = 0
    for seed in SEEDS:
        scene = built(build, seed)
        bounds = boxes(scene)
        assert bounds[:, 0, 2].min() == pytest.approx(0, abs=0.002)
        assert low < bounds[:, 1, 2].max() < high
        assert not loose(scene, gap=0.01)
        shade = bounds[-1]
        glows = scene.parts[-1][1].glow > 0
        assert glows == (len(scene.lights) == 1)
        on += glows
        for light in scene.lights:
            assert (shade[0] < light.centre).all()
            assert (light.centre < shade[1]).all()
            assert light.facing is None
            assert 0.1 < light.power[0] < 0.7
            assert light.power[0] >= light.power[1]
    assert 15 < on < 45


def ceiling(seed: int, *, forced: bool = False, width: float = 4.0, depth: float = 3.0) -> tuple[Scene, float]:
    scene = Scene()
    power = ceiling_lamps(scene.at(0, 0, 2.5), np.random.default_rng(seed), width, depth, forced=forced)
    return scene, power


def test_lamps_hang_from_the_ceiling_within_the_room() -> None:
    for seed in SEEDS:
        low, high = extent(ceiling(seed)[0])
        assert high[2] == pytest.approx(2.5, abs=0.011)
        assert low[2] > 2.5 - 1.3
        assert (np.abs(low[:2]) < (2.0, 1.5)).all()
        assert (high[:2] < (2.0, 1.5)).all()


def test_power_is_that_of_the_lights_and_grows_with_the_room() -> None:
    for seed in SEEDS:
        scene, power = ceiling(seed)
        assert sum(light.power[0] for light in scene.lights) == pytest.approx(power)
        assert (power > 0) == bool(scene.lights) == any(material.glow > 0 for _, material, _ in scene.parts)
        _, forced = ceiling(seed, forced=True)
        assert forced > 0
        _, large = ceiling(seed, forced=True, width=8.0, depth=6.0)
        assert large == pytest.approx(2 * forced)
    assert 0.35 < np.mean([ceiling(seed)[1] > 0 for seed in SEEDS]) < 0.75


def test_lights_are_just_below_their_lamps_and_flat_ones_shine_down() -> None:
    directions = set()
    for seed in SEEDS:
        scene, _ = ceiling(seed, forced=True)
        low, _ = extent(scene)
        for light in scene.lights:
            assert low[2] - 0.13 < light.centre[2] < 2.5
            assert math.hypot(*light.centre[:2]) < 2.5
            directions.add(light.facing)
    assert directions == {None, (0, 0, -1.0)}


def test_large_rooms_have_rows_of_lamps() -> None:
    for seed in range(10):
        scene, _ = ceiling(seed, forced=True, width=7.2, depth=4.8)
        assert len({light.centre[:2] for light in scene.lights}) == 6
