import numpy as np
import pytest
from tests.synthetic.measuring import boxes, built, extent, loose, numbers

from zoedepth.synthetic.fittings import FITTINGS, floor_thing, kitchen_units
from zoedepth.synthetic.furniture import room_style
from zoedepth.synthetic.scene import Scene

SEEDS = range(25)
SIZES = {
    "bath": (1.7, 0.75, 0.58), "toilet": (0.43, 0.69, 0.82), "sink": (0.8, 0.5, 0.86), "fridge": (0.6, 0.65, 1.8),
    "boxes": (1.2, 0.6, 1.5), "tv": (1.5, 0.42, 0.5),
}  # fmt: skip
TOPS = {"bath": (0.72, 0.74), "toilet": (0.79, 0.81), "sink": (1.85, 1.87), "fridge": (1.8, 2.5), "boxes": (1.3, 1.76),
        "tv": (1.0, 1.4)}  # fmt: skip
"""Heights above the floor, metres: with the tap, the mirror above the sink, things on the fridge, and the screen."""


def item(name: str, seed: int) -> Scene:
    return built(lambda frame, rng: FITTINGS[name](frame, rng, room_style(rng), SIZES[name]), seed)


def kitchen(seed: int, ceiling: float = 2.5) -> Scene:
    return built(lambda frame, rng: kitchen_units(frame, rng, room_style(rng), (1.5, 0.63, 0.9), ceiling), seed)


def test_every_fitting_is_tested() -> None:
    assert set(FITTINGS) == set(SIZES)


@pytest.mark.parametrize("name", SIZES)
def test_item_stands_on_the_floor_in_its_place(name: str) -> None:
    wide, deep, _ = SIZES[name]
    for seed in SEEDS:
        low, high = extent(item(name, seed))
        assert -0.001 <= low[2] <= 0.001
        assert TOPS[name][0] <= high[2] <= TOPS[name][1]
        assert -wide / 2 - 0.05 <= low[0]
        assert high[0] <= wide / 2 + 0.05
        assert -deep / 2 - 0.05 <= low[1]
        assert high[1] <= deep / 2 + 0.03


@pytest.mark.parametrize("name", SIZES)
def test_parts_hang_together(name: str) -> None:
    """The mirror above a sink hangs on the wall, 30 cm above; a screen is 3 cm above its foot."""
    gap = {"sink": 0.31, "tv": 0.035}.get(name, 0.02)
    assert not [seed for seed in SEEDS if loose(item(name, seed), gap=gap)]


def test_bath_is_hollow() -> None:
    bounds = boxes(item("bath", 0))[:5]
    over_the_middle = ((bounds[:, 0, :2] < 0) & (bounds[:, 1, :2] > 0)).all(1)
    assert bounds[over_the_middle][:, 1, 2].max() == pytest.approx(0.15)


def test_doors_of_a_fridge_are_at_its_front_and_its_mirror_over_the_sink_at_the_back() -> None:
    fridge = boxes(item("fridge", 1))
    assert fridge[1, 0, 1] < fridge[0, 0, 1]
    assert fridge[2, 0, 1] < fridge[0, 0, 1]
    for seed in SEEDS:
        scene = item("sink", seed)
        (mirror,) = [bounds for bounds, part in zip(boxes(scene), scene.parts, strict=True) if part[1].mirror == 0.85]
        assert mirror[1, 1] == pytest.approx(0.25 + 0.0075)


def test_worktop_is_at_its_height_and_cupboards_hang_above_it_below_the_ceiling() -> None:
    upper = 0
    for seed in SEEDS:
        scene = kitchen(seed)
        bounds = boxes(scene)
        low, high = extent(scene)
        assert low[2] == pytest.approx(0, abs=1e-3)
        assert high[2] <= 2.5 + 1e-6
        top = [b for b in bounds if b[1, 0] - b[0, 0] == pytest.approx(1.5) and abs(b[1, 2] - 0.905) < 1e-6]
        assert len(top) == 1
        hung = bounds[(bounds[:, 0, 2] > 1.4) & (bounds[:, 1, 0] - bounds[:, 0, 0] > 1.4)]
        upper += len(hung) > 0
        assert (hung[:, 1, 1] <= 0.63 / 2 + 0.01).all()
    assert 5 < upper < 25


def test_hood_reaches_up_to_the_ceiling() -> None:
    for seed in SEEDS:
        scene = kitchen(seed, ceiling=3.1)
        hoods = [i for i, part in enumerate(scene.parts) if part[0] == "taper"]
        if hoods:
            bounds = boxes(scene)
            assert bounds[hoods[0] + 1, 1, 2] == pytest.approx(3.1)
            assert bounds[hoods[0] + 1, 0, 2] == pytest.approx(bounds[hoods[0], 1, 2])
            return
    pytest.fail("no stove was drawn")


def test_piled_boxes_stand_on_each_other() -> None:
    for seed in SEEDS:
        bounds = boxes(item("boxes", seed))
        for box in bounds:
            below = bounds[np.abs(bounds[:, 1, 2] - box[0, 2]) < 1e-6]
            assert box[0, 2] == pytest.approx(0) or len(below)


def test_things_on_the_floor_stand_on_it_and_are_small() -> None:
    shapes = set()
    for seed in range(60):
        scene = built(floor_thing, seed)
        low, high = extent(scene)
        assert -0.001 < low[2] < 0.003
        assert (high - low).max() < 0.65
        shapes |= {part[0] for part in scene.parts}
    assert shapes >= {"box", "sphere", "cup", "cushion", "torso", "soft"}


def test_seed_decides() -> None:
    assert numbers(kitchen(1)) == numbers(kitchen(1)) != numbers(kitchen(2))
