import math

import numpy as np
import pytest

pytest.importorskip("embreex")

from tests.synthetic.measuring import numbers

from zoedepth.synthetic import street as streets
from zoedepth.synthetic.scene import Frame
from zoedepth.synthetic.street import AHEAD, BEHIND, KINDS, STEP, Street, build_street
from zoedepth.synthetic.trace import Tracer

SEEDS = range(24)
BUILDERS = ("car", "truck", "house", "block", "tree", "bush", "hedge", "fence", "person", "sign", "street_lamp",
            "street_thing", "traffic_light")  # fmt: skip


@pytest.fixture(scope="module")
def bare() -> list[tuple[Street, list[tuple[str, Frame]]]]:
    """Streets of ground alone, and the places where things would stand."""
    found = []
    with pytest.MonkeyPatch.context() as patch:
        placed: list[tuple[str, Frame]] = []
        for name in BUILDERS:
            patch.setattr(streets, name, lambda frame, *args, name=name, **options: placed.append((name, frame)))
        for seed in SEEDS:
            placed.clear()
            street = build_street(np.random.default_rng(seed))
            street.scene.near = 1e9  # nothing is left out
            found.append((street, list(placed)))
    return found


def ground_below(street: Street, points: np.ndarray) -> np.ndarray:
    """Return the height of the ground at each (x, y, z), which is below; -inf where there is none."""
    origins = (points + np.array((0, 0, 3))).astype(np.float32)
    down = np.broadcast_to(np.array((0, 0, -1), np.float32), origins.shape)
    return origins[:, 2] - Tracer(street.scene.arrays((0, 0, 1))).hits(origins, down).distance


def heights(bare: list[tuple[Street, list[tuple[str, Frame]]]], *names: str) -> np.ndarray:
    """Return how far above the ground things of these names stand, metres."""
    found = []
    for street, placed in bare:
        points = np.array([(f.x, f.y, f.z) for name, f in placed if name in names]).reshape(-1, 3)
        if len(points):
            found.append(points[:, 2] - ground_below(street, points))
    return np.concatenate(found)


def test_road_starts_at_the_camera_and_bends_and_climbs_gently(bare: list) -> None:
    for street, _ in bare:
        along = np.arange(BEHIND, AHEAD + STEP, STEP)
        np.testing.assert_allclose(street.path[np.abs(along).argmin(), :3], 0, atol=1e-9)
        steps = np.diff(street.path[:, :3], axis=0)
        np.testing.assert_allclose(np.hypot(steps[:, 0], steps[:, 1]), STEP, rtol=1e-6)
        assert np.abs(steps[:, 2] / STEP).max() < 0.2
        heading = street.path[:-1, 3]
        np.testing.assert_allclose(steps[:, :2] / STEP, np.stack([np.cos(heading), np.sin(heading)], 1), atol=1e-9)
    assert {street.kind for street, _ in bare} <= set(KINDS)
    assert len({street.kind for street, _ in bare}) >= 4


def test_places_are_right_of_the_road_and_on_its_pavement(bare: list) -> None:
    for street, _ in bare:
        middle, right = street.at(20, 0), street.at(20, 2.0)
        ahead = np.array(middle.world(0, 1, 0)) - middle.world(0, 0, 0)
        offset = np.array((right.x - middle.x, right.y - middle.y))
        assert np.linalg.norm(offset) == pytest.approx(2)
        np.testing.assert_allclose(offset, (2 * ahead[1], -2 * ahead[0]), atol=1e-9)
        assert right.z == middle.z
        beside = street.at(20, street.half + 0.1)
        assert beside.z - middle.z == pytest.approx(0.13 if street.pavement else 0)


def test_vehicles_are_on_the_carriageway_and_on_its_ground(bare: list) -> None:
    above = heights(bare, "car", "truck")
    assert len(above) > 150
    assert np.abs(np.median(above)) < 0.002
    assert (np.abs(above) < 0.05).mean() > 0.97  # the others drive out of a garden
    assert above.min() > -0.03
    assert above.max() < 0.14
    for street, _ in bare:
        for along, right in street.parked:
            assert abs(right) + 0.8 < street.half + 0.1
            assert BEHIND < along < 131


def test_vehicles_keep_apart(bare: list) -> None:
    for street, _ in bare:
        for i, (along, right) in enumerate(street.parked):
            for other, across in street.parked[:i]:
                assert abs(along - other) > 5 or abs(right - across) > 1.7


def test_nothing_floats_or_sinks(bare: list) -> None:
    """People, signs and things whose pavement a side street cuts off stand 13 cm above it: about one in fifty."""
    above = heights(
        bare, "person", "sign", "street_lamp", "street_thing", "traffic_light", "tree", "bush", "hedge", "fence"
    )
    above = above[np.isfinite(above)]  # far off, on the outer side of a bend, the ground has gaps
    assert len(above) > 700
    assert np.abs(np.median(above)) < 0.01
    assert (np.abs(above) < 0.07).mean() > 0.95
    assert above.min() > -0.1
    assert above[above < 0.3].max() < 0.14
    sunk = heights(bare, "house", "block")
    sunk = sunk[np.isfinite(sunk)]
    assert (sunk < 0.05).all()
    assert np.median(sunk) == pytest.approx(-0.27, abs=0.01)  # buildings reach 30 cm into the ground


def test_buildings_and_trees_keep_off_the_road(bare: list) -> None:
    for street, placed in bare:
        near = street.path[(np.arange(len(street.path)) * STEP + BEHIND) < 150]
        fine = np.linspace(0, len(near) - 1, 400)
        road = np.stack([np.interp(fine, np.arange(len(near)), near[:, k]) for k in (0, 1)], 1)
        for name, frame in placed:
            if name in ("house", "block", "tree", "bush", "hedge", "fence"):
                away = np.hypot(*(road - (frame.x, frame.y)).T).min()
                assert away > street.half - 0.3


def test_fronts_look_at_the_road(bare: list) -> None:
    for street, placed in bare:
        for name, frame in placed:
            if name in ("house", "block") and frame.y < 100:
                front = np.array(frame.world(0, -1, 0)) - frame.world(0, 0, 0)
                nearest = street.path[np.hypot(street.path[:, 0] - frame.x, street.path[:, 1] - frame.y).argmin()]
                assert front[:2] @ (nearest[:2] - (frame.x, frame.y)) > 0


def test_camera_is_above_the_ground_as_that_of_a_car_or_a_walker(bare: list) -> None:
    for street, _ in bare:
        rng = np.random.default_rng(0)
        poses = [street.draw_pose(rng) for _ in range(25)]
        points = np.array([pose.position for pose in poses])
        above = points[:, 2] - ground_below(street, points)
        assert above.min() > 0.7  # beside a steep road one piece of the ground may stand out from the next
        assert (above > 1.1).mean() >= 0.9
        assert above.max() < 2.0
        assert all(50 <= math.degrees(pose.field_of_view) <= 90 for pose in poses)
        turn = [abs((pose.yaw - street.path[4, 3] + math.pi) % (2 * math.pi) - math.pi) for pose in poses]
        assert np.median(turn) < 0.3  # along the road


def test_seed_decides() -> None:
    first, again, other = (build_street(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert numbers(first.scene) == numbers(again.scene) != numbers(other.scene)
