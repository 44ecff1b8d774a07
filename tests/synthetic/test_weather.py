import math

import numpy as np

from zoedepth.synthetic.scene import Scene
from zoedepth.synthetic.weather import daylight, weather

SEEDS = range(300)


def skies(give: object, n: range = SEEDS) -> list[Scene]:
    found = []
    for seed in n:
        scene = Scene()
        give(scene, np.random.default_rng(seed))
        found.append(scene)
    return found


def test_sun_stands_above_the_horizon_in_any_direction() -> None:
    for give, low, high in ((weather, 0.2, 1.2), (daylight, 0.25, 1.0)):
        suns = np.array([scene.sun.towards for scene in skies(give) if scene.sun is not None])
        np.testing.assert_allclose(np.linalg.norm(suns, axis=1), 1, atol=1e-9)
        assert math.sin(low) < suns[:, 2].min() < math.sin(low + 0.1)
        assert math.sin(high - 0.1) < suns[:, 2].max() < math.sin(high)
        turns = np.histogram(np.arctan2(suns[:, 1], suns[:, 0]), 4, (-math.pi, math.pi))[0]
        assert turns.min() > 0.15 * len(suns)


def test_low_sun_is_warm_and_dull_days_have_a_weak_one_or_none() -> None:
    scenes = skies(weather)
    strong = [scene for scene in scenes if scene.sun is not None and scene.sun.spread < 0.05]
    dull = [scene for scene in scenes if scene not in strong]
    assert 0.2 < len(dull) / len(scenes) < 0.5
    for scene in strong:
        red, green, blue = scene.sun.color
        assert 1.8 <= red <= 3.5
        assert red > green > blue
    for scene in dull:
        assert scene.sun is None or scene.sun.color[0] < 1
        assert scene.sky.clouds >= 0.7
    ratio = [s.sun.color[2] / s.sun.color[0] for s in strong]
    height = [s.sun.towards[2] for s in strong]
    assert np.corrcoef(ratio, height)[0, 1] > 0.9


def test_colours_of_the_sky_are_those_of_light() -> None:
    for scene in skies(weather) + skies(daylight):
        for color in (*scene.sky[:3], scene.ambient):
            assert all(0 < value < 1.6 for value in color)
        assert 0 <= scene.sky.clouds <= 1
        assert scene.sky.haze == 0 or 120 <= scene.sky.haze <= 3000


def test_rooms_have_a_sun_in_three_of_five() -> None:
    share = np.mean([scene.sun is not None for scene in skies(daylight)])
    assert 0.5 < share < 0.7
