import math
from collections.abc import Callable

import numpy as np
import pytest
from tests.synthetic.measuring import boxes, built, corners, extent, loose, numbers

from zoedepth.synthetic import furniture
from zoedepth.synthetic.furniture import Style, room_style
from zoedepth.synthetic.palette import Random
from zoedepth.synthetic.scene import Frame, Scene

Build = Callable[[Frame, Random, Style], None]
SEEDS = range(25)
PIECES: dict[str, tuple[Build, tuple[float, float], tuple[float, float], float]] = {
    # build, (half width, half depth) of the footprint, (lowest, highest) top and slack in metres
    "table": (lambda f, r, s: furniture.table(f, r, s, 1.5, 0.9, 0.75, things=0), (0.75, 0.6), (0.74, 0.76), 0.02),
    **{f"chair {kind}": (
        (lambda f, r, s, kind=kind: furniture.chair(f, r, s, kind)), (0.25, 0.3), (0.85, 1.15), 0.08)
       for kind in range(5)},
    "stool": (lambda f, r, s: furniture.chair(f, r, s, 5), (0.25, 0.25), (0.47, 0.54), 0.03),
    "sofa": (lambda f, r, s: furniture.sofa(f, r, s, 2.0, 0.9), (1.0, 0.45), (0.68, 0.97), 0.05),
    "bed": (lambda f, r, s: furniture.bed(f, r, s, 1.5, 2.0), (0.75, 1.0), (0.74, 1.26), 0.08),
    "shelf": (lambda f, r, s: furniture.shelf(f, r, s, 1.2, 2.0, 0.3), (0.6, 0.15), (2.0, 2.06), 0.05),
    "cabinet": (lambda f, r, s: furniture.cabinet(f, r, s, 1.2, 1.0, 0.45, things=0), (0.6, 0.225), (1.0, 1.001), 0.05),
    "wardrobe": (lambda f, r, s: furniture.cabinet(f, r, s, 1.2, 2.1, 0.6), (0.6, 0.3), (2.1, 2.101), 0.05),
}  # fmt: skip


def piece(name: str, seed: int) -> Scene:
    return built(lambda frame, rng: PIECES[name][0](frame, rng, room_style(rng)), seed)


@pytest.mark.parametrize("name", PIECES)
def test_piece_stands_on_the_floor_within_its_footprint_and_at_its_height(name: str) -> None:
    _, half, (lowest, highest), slack = PIECES[name]
    for seed in SEEDS:
        low, high = extent(piece(name, seed))
        assert -0.003 <= low[2] <= 0.001
        assert lowest <= high[2] <= highest
        assert (np.abs([low[:2], high[:2]]).max(0) <= np.array(half) + slack).all()
        assert (high[:2] - low[:2]).max() > 1.6 * max(half) - 0.03  # as large as was asked for


@pytest.mark.parametrize("name", PIECES)
def test_all_parts_hang_together(name: str) -> None:
    """No part floats, but the back of an office chair: it is 3 cm above the seat."""
    for seed in SEEDS:
        assert not loose(piece(name, seed), gap=0.035 if name == "chair 3" else 0.025)


@pytest.mark.parametrize("name", ["chair 0", "chair 1", "chair 2", "chair 3", "chair 4", "sofa", "bed"])
def test_back_is_towards_positive_y(name: str) -> None:
    for seed in SEEDS:
        points = np.concatenate(corners(piece(name, seed)))
        top = points[points[:, 2] > points[:, 2].max() - 0.15]
        assert np.median(top[:, 1]) > 0.1


def test_front_of_a_cabinet_is_at_negative_y() -> None:
    for seed in SEEDS:
        low, high = extent(piece("wardrobe", seed))
        assert low[1] < -0.31
        assert high[1] == pytest.approx(0.3)


def test_seat_is_at_the_height_of_seats() -> None:
    for seed in SEEDS:
        for kind in range(6):
            bounds = boxes(piece("stool" if kind == 5 else f"chair {kind}", seed))
            size = bounds[:, 1] - bounds[:, 0]
            wide = bounds[(size[:, 0] > 0.4) & (size[:, 1] > 0.4) & (size[:, 2] < 0.15)]
            assert len(wide) == 1
            assert 0.4 < wide[0, 1, 2] < 0.58


def test_desk_has_a_chair_before_it_that_looks_at_it() -> None:
    leans = []
    for seed in SEEDS:
        scene = built(lambda frame, rng: furniture.desk(frame, rng, room_style(rng), 1.5, 0.7), seed)
        low, high = extent(scene)
        assert -0.003 <= low[2] <= 0.001
        assert high[1] < 0.38
        assert low[1] > -1.3
        bounds = boxes(scene)
        top = bounds[0]
        assert 0.69 < top[1, 2] < 0.78
        before = bounds[(bounds.mean(1)[:, 1] < -0.45)]
        if len(before):
            back = before[before[:, 1, 2].argmax()]
            leans.append(back.mean(0)[1] - before.mean((0, 1))[1])
    assert len(leans) > 15
    assert np.mean(leans) < -0.05  # the back is farther from the desk than the rest, but where the chair is turned


def test_things_stand_on_the_table_top() -> None:
    for seed in SEEDS:
        bare = len(piece("table", seed).parts)
        scene = built(lambda f, r: furniture.table(f, r, room_style(r), 1.5, 0.9, 0.75, things=6), seed)
        things = boxes(scene)[bare:]
        assert len(things) > 0
        assert (things[:, 0, 2] > 0.745).all()


def test_shelf_holds_its_things_between_its_boards() -> None:
    for seed in SEEDS:
        bounds = boxes(piece("shelf", seed))
        assert (bounds[:, 0, 0] > -0.66).all()
        assert (bounds[:, 1, 0] < 0.66).all()
        assert bounds[:, 1, 2].max() < 2.06
        assert len(bounds) > 15


def test_style_is_shared_and_the_seed_decides() -> None:
    for name in PIECES:
        assert numbers(piece(name, 3)) == numbers(piece(name, 3))
        assert len({numbers(piece(name, seed)) for seed in SEEDS}) == len(SEEDS)
    style = room_style(np.random.default_rng(0))
    materials = {material for _, material, _ in built(lambda f, r: furniture.chair(f, r, style, 1), 0).parts}
    assert materials <= {style.wood, style.metal, style.cloth, style.second_cloth}
    assert {room_style(np.random.default_rng(seed)).handles for seed in range(20)} == {0, 1, 2}


def test_turned_frame_turns_the_whole_piece() -> None:
    straight, other = Scene(), Scene()
    for scene, frame in ((straight, straight.at(0, 0)), (other, other.at(2, 3, 0.5, math.pi / 2))):
        rng = np.random.default_rng(1)
        furniture.sofa(frame, rng, room_style(rng), 2.0)
        del scene
    (low, high), (turned_low, turned_high) = extent(straight), extent(other)
    np.testing.assert_allclose(turned_low, [2 - high[1], 3 + low[0], 0.5 + low[2]], atol=1e-6)
    np.testing.assert_allclose(turned_high, [2 - low[1], 3 + high[0], 0.5 + high[2]], atol=1e-6)


def test_back_of_a_sofa_is_behind_its_seats() -> None:
    for seed in SEEDS:
        bounds = boxes(piece("sofa", seed))
        size = bounds[:, 1] - bounds[:, 0]
        (back,) = bounds[(size[:, 0] > 1.99) & (size[:, 1] < 0.3)]
        assert back[0, 1] > 0.2
