import numpy as np
import pytest
from tests.synthetic.measuring import boxes, built, extent, loose

from zoedepth.synthetic.greenery import bush, hedge, tree
from zoedepth.synthetic.scene import Scene

SEEDS = range(30)


@pytest.mark.parametrize("bare", [False, True])
@pytest.mark.parametrize("height", [3.0, 12.0])
def test_tree_is_rooted_and_about_as_high_as_asked_for(height: float, bare: bool) -> None:
    for seed in SEEDS:
        scene = built(lambda frame, rng: tree(frame, rng, height, bare=bare), seed)
        low, high = extent(scene)
        assert -0.02 * height < low[2] < 0.01
        assert 0.75 * height < high[2] < 1.15 * height
        assert (high - low)[:2].max() < 1.1 * height
        assert not loose(scene, gap=0.1)
        leafy = {part[0] for part in scene.parts} & {"leaves0", "leaves1", "leaves2", "blob0", "conifer"}
        assert bool(leafy) != bare


def test_trunk_is_thin_and_its_crown_above_it() -> None:
    for seed in SEEDS:
        scene = built(lambda frame, rng: tree(frame, rng, 8.0), seed)
        bounds = boxes(scene)
        assert scene.parts[0][0] == "trunk"
        assert (bounds[0, 1] - bounds[0, 0])[:2].max() < 1.0
        leaves = [b for b, part in zip(bounds, scene.parts, strict=True) if part[0].startswith(("leaves", "conifer"))]
        assert np.mean([b.mean(0)[2] for b in leaves]) > 3


def test_tree_far_away_has_fewer_parts() -> None:
    counts = []
    for away in (5.0, 40.0, 120.0):
        scene = Scene()
        for seed in SEEDS:
            tree(scene.at(away, 0), np.random.default_rng(seed), 8.0)
        counts.append(len(scene.parts))
    assert counts[0] > 1.3 * counts[1]
    assert counts[1] > 1.3 * counts[2]


def test_bush_is_round_and_on_the_ground() -> None:
    for seed in SEEDS:
        low, high = extent(built(lambda frame, rng: bush(frame, rng, 1.5), seed))
        assert -0.2 < low[2] < 0
        assert 0.6 < high[2] < 1.6
        assert (high - low)[:2].max() < 3.5


def test_hedge_lies_along_x() -> None:
    for seed in SEEDS:
        low, high = extent(built(lambda frame, rng: hedge(frame, rng, 8.0), seed))
        assert low[2] == pytest.approx(0, abs=1e-6)
        assert 0.7 < high[2] < 2.2
        assert high[0] == pytest.approx(4, abs=0.3)
        assert low[0] == pytest.approx(-4, abs=0.3)
        assert (high - low)[1] < 1.3
