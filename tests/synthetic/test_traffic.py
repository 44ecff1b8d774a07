import math
from collections.abc import Callable

import numpy as np
import pytest
from tests.synthetic.measuring import boxes, built, corners, extent, loose, numbers

from zoedepth.synthetic import traffic
from zoedepth.synthetic.scene import Scene

SEEDS = range(40)
THINGS: dict[str, tuple[Callable[..., object], tuple[float, float, float], tuple[float, float, float], float]] = {
    # build, smallest and largest extent along x, y, z and the widest gap between parts, metres
    "car": (traffic.car, (1.7, 3.6, 1.3), (2.4, 5.7, 2.4), 0.01),
    "truck": (traffic.truck, (2.4, 5.9, 2.6), (2.6, 12.1, 3.8), 0.05),
    "bicycle": (traffic.bicycle, (0.5, 1.7, 1.0), (0.6, 1.8, 1.05), 0.01),
    "person": (traffic.person, (0.3, 0.2, 1.0), (0.7, 1.0, 1.95), 0.01),
    "lamp": (lambda f, r: traffic.street_lamp(f, r, 4.0, 0.0), (0.39, 0.39, 4.4), (0.5, 0.5, 4.6), 0.01),
    "lamp with arm": (lambda f, r: traffic.street_lamp(f, r, 8.0, 1.5), (1.9, 0.2, 8.2), (2.0, 0.3, 8.35), 0.01),
    "sign": (traffic.sign, (0.5, 0.05, 2.2), (1.7, 0.12, 3.4), 0.02),
    "traffic light": (traffic.traffic_light, (0.29, 0.2, 3.29), (0.31, 0.4, 3.31), 0.01),
    "fence": (lambda f, r: traffic.fence(f, r, 8.0), (7.99, 0.04, 0.7), (8.1, 0.35, 1.8), 0.01),
}  # fmt: skip


@pytest.mark.parametrize("name", THINGS)
def test_thing_stands_on_the_ground_at_its_real_size(name: str) -> None:
    build, smallest, largest, gap = THINGS[name]
    for seed in SEEDS:
        scene = built(build, seed)
        low, high = extent(scene)
        assert low[2] == pytest.approx(0, abs=0.01)
        assert (high - low >= smallest).all()
        assert (high - low <= largest).all()
        assert not loose(scene, gap=gap)
        assert numbers(scene) == numbers(built(build, seed))


@pytest.mark.parametrize("build", [traffic.car, traffic.truck])
def test_length_is_the_one_returned(build: Callable[..., float]) -> None:
    for seed in SEEDS:
        scene = Scene()
        length = build(scene.at(0, 0), np.random.default_rng(seed))
        low, high = extent(scene)
        assert (high - low)[1] == pytest.approx(length, abs=0.06)


def test_car_looks_ahead_on_four_wheels() -> None:
    for seed in SEEDS:
        scene = built(traffic.car, seed)
        bounds, parts = boxes(scene), scene.parts
        wheels = np.array([b for b, part in zip(bounds, parts, strict=True) if part[1] == traffic.RUBBER])
        assert len(wheels) == 4
        np.testing.assert_allclose(wheels[:, 0, 2], 0, atol=1e-3)
        size = wheels[:, 1] - wheels[:, 0]
        assert ((size[:, 1] > 0.58) & (size[:, 1] < 0.74)).all()  # they roll along y
        np.testing.assert_allclose(size[:, 0], 0.22, atol=1e-6)
        lit = [b.mean(0)[1] for b, part in zip(bounds, parts, strict=True) if part[1].color == (0.9, 0.9, 0.85)
               and part[0] == "soft"]  # fmt: skip
        red = [b.mean(0)[1] for b, part in zip(bounds, parts, strict=True) if part[1].color == (0.6, 0.03, 0.03)]
        assert len(lit) == len(red) == 2
        assert min(lit) > 1.5
        assert max(red) < -1.5
        body, cabin = bounds[0], bounds[1]
        assert 0.19 < body[0, 2] < 0.21
        assert cabin[0, 2] < body[1, 2] < cabin[1, 2]


def test_cab_of_a_lorry_is_in_front() -> None:
    cabs = 0
    for seed in SEEDS:
        scene = built(traffic.truck, seed)
        for bounds, part in zip(boxes(scene), scene.parts, strict=True):
            if part[0] == "soft":
                assert bounds[0, 1] > 0.5
                cabs += 1
    assert 10 < cabs < 70


def test_limbs_of_a_person_are_where_they_belong() -> None:
    for seed in SEEDS:
        scene = built(traffic.person, seed)
        _, high = extent(scene)
        bounds = boxes(scene)
        feet = bounds[[i for i, part in enumerate(scene.parts) if part[1] == traffic.RUBBER]]
        assert len(feet) == 2
        np.testing.assert_allclose(feet[:, 0, 2], 0, atol=1e-6)
        assert feet[0].mean(0)[0] < 0 < feet[1].mean(0)[0]
        heads = [
            b for b, part in zip(bounds, scene.parts, strict=True) if part[0] == "sphere" and b[0, 2] > 0.75 * high[2]
        ]
        assert len(heads) == 2  # a head and its hair
        assert max(b[1, 2] for b in heads) == pytest.approx(high[2])
        assert heads[1].mean(0)[1] < heads[0].mean(0)[1]  # the face looks towards +y


@pytest.mark.parametrize("arm", [1.5, -1.5])
def test_arm_of_a_lamp_reaches_to_its_side(arm: float) -> None:
    low, high = extent(built(lambda f, r: traffic.street_lamp(f, r, 8.0, arm), 0))
    reach = high[0] if arm > 0 else -low[0]
    assert reach == pytest.approx(1.85, abs=0.02)
    assert (low if arm > 0 else high)[0] == pytest.approx(math.copysign(0.11, -arm), abs=0.01)


def test_sign_and_lights_are_read_from_negative_y() -> None:
    for seed in SEEDS:
        scene = built(traffic.sign, seed)
        plates = [points for points, part in zip(corners(scene), scene.parts, strict=True) if part[0] != "rod"]
        assert all(points[:, 1].max() < 0 for points in plates)
        scene = built(traffic.traffic_light, seed)
        lamps = [(b, part[1]) for b, part in zip(boxes(scene), scene.parts, strict=True) if part[0] == "sphere"]
        assert [material.glow > 0 for _, material in lamps].count(True) == 1
        assert all(b[0, 1] < -0.21 for b, _ in lamps)
        red = max(lamps, key=lambda lamp: lamp[0][0, 2])[1].color
        assert red[0] > 5 * red[1]  # at the top


def test_street_things_stand_on_the_pavement() -> None:
    """A wheeled bin hangs 8 cm above it; the bench of a bus shelter and its poster 35 cm at its posts."""
    kinds = set()
    for seed in range(80):
        scene = built(traffic.street_thing, seed)
        low, high = extent(scene)
        assert 0 <= low[2] + 1e-3 < 0.09
        assert 0.55 < high[2] < 2.5
        assert (high - low)[0] < 4.2
        kinds.add((scene.parts[0][0], len(scene.parts)))
    assert len(kinds) >= 9
