"""Depth that cannot be right: marks for "unknown", wrong units, single maps in another unit; and depth that can."""

import numpy as np
import pytest

from zoedepth.data.plausible import Doubts, Glance, Mark, doubts, find_mark, glance


def slope(near: float, far: float, *, n: int = 96) -> np.ndarray:
    """Depth of a picture whose rows go from near to far."""
    return np.linspace(near, far, n, dtype=np.float32).repeat(20)


def marked(value: float, share: float, *, near: float = 1.0, far: float = 4.0) -> Glance:
    depth = slope(near, far)
    depth[: round(share * len(depth))] = value
    return glance("a", "indoor", depth)


@pytest.mark.parametrize("value", [65504.0, 65.535, 1e10, 655.35, 3.4e38, 25.0])
def test_one_value_far_beyond_all_others_is_a_mark(value: float) -> None:
    found = find_mark([marked(value, 0.2), glance("b", "indoor", slope(1, 4))])
    assert found is not None
    assert found.value == np.float32(value)
    assert found.share == pytest.approx(0.1, abs=0.001)
    assert found.certain
    assert 0 < found.max_depth <= np.float32(value)
    assert found.max_depth == pytest.approx(value, rel=1e-3)
    assert f'{{"max_depth": {found.max_depth:g}}}' in str(found)


def test_values_where_a_sensor_ends_are_asked_about() -> None:
    for glances in ([marked(5.0, 0.1)], [glance("a", "outdoor", np.minimum(slope(1, 90, n=9000), np.float32(80)))]):
        found = find_mark(glances)
        assert found is not None
        assert not found.certain
        assert "does it stand for unknown?" in str(found)


@pytest.mark.parametrize(
    "depth",
    [
        slope(1, 4),  # its last row holds the largest value, as each other row holds one
        slope(2, 2),
        np.append(slope(1, 4), 65.0),  # one outlier
        np.array([], np.float32),
        np.round(slope(1, 4) * 10) / 10,  # a coarse sensor
    ],
    ids=["slope", "flat", "outlier", "nothing", "coarse"],
)
def test_depth_without_a_mark(depth: np.ndarray) -> None:
    assert find_mark([glance("a", "indoor", depth)]) is None
    assert find_mark([]) is None


def test_a_mark_does_not_count_in_medians_and_a_max_depth_that_is_said_leaves_none() -> None:
    far = marked(65.535, 0.6)
    found = doubts([far])
    assert found.medians["indoor"] < 4
    assert (found.impossible, found.unlikely) == ([], [])
    assert doubts([far], max_depth=100.0).mark is None


@pytest.mark.parametrize(("factor", "wrong"), [(1e6, True), (1000, True), (1e-3, True), (1, False), (0.1, False)])
def test_medians_beyond_a_kilometre_or_below_a_centimetre_are_impossible(factor: float, wrong: bool) -> None:
    found = doubts([glance("a", "", factor * slope(1, 4))])
    assert bool(found.impossible) == wrong
    assert found.unlikely == []
    if wrong:
        assert "a sensor says 0.001 metres a unit" in found.impossible[0]


def test_data_may_say_that_it_is_far() -> None:
    far = glance("a", "", slope(1500, 4000))
    assert doubts([far]).impossible
    assert not doubts([far], max_depth=5000.0).impossible


@pytest.mark.parametrize(
    ("domain", "near", "far", "asked"),
    [
        ("indoor", 7, 98, True),
        ("indoor", 0.01, 0.2, True),
        ("indoor", 0.5, 9, False),
        ("outdoor", 0.1, 1.5, True),
        ("outdoor", 3, 80, False),
        ("attic", 7, 98, False),
    ],
)
def test_medians_unusual_for_their_domain_are_asked_about(domain: str, near: float, far: float, asked: bool) -> None:
    found = doubts([glance("a", domain, slope(near, far))])
    assert found.impossible == []
    assert bool(found.unlikely) == asked
    if asked:
        assert f"its {domain} photos" in found.unlikely[0]


def test_a_map_in_another_unit_than_the_others_is_named() -> None:
    glances = [glance(f"{i}.png", "indoor", slope(1, 4 + 0.1 * i)) for i in range(5)]
    glances[3] = glance("3.png", "indoor", slope(10, 45))
    found = doubts(glances)
    assert list(found.unlike) == ["3.png"]
    assert found.unlikely == [found.unlike["3.png"]]
    assert "3.png: its median depth is 27.5 m, and that of the others is 2.6" in found.unlike["3.png"]
    assert doubts(glances[2:4]).unlike == {}, "of two, nobody knows which is right"
    assert doubts([*glances[:3], glance("street", "outdoor", slope(10, 80))]).unlike == {}


def test_many_such_maps_are_named_in_part() -> None:
    found = Doubts(unlike={str(i): f"{i} is unlike" for i in range(8)})
    assert found.unlikely[-2:] == ["4 is unlike", "and 3 more maps unlike the others"]


@pytest.mark.parametrize(
    ("value", "proposed"), [(65.535, 65.53), (80.0, 80.0), (0.5, 0.5), (1e10, 1e10), (9.9999, 9.999)]
)
def test_proposal_is_never_beyond_the_mark(value: float, proposed: float) -> None:
    assert Mark(value, 0.1, 1.0).max_depth == proposed


@pytest.mark.parametrize(
    "sky",
    [
        np.random.default_rng(0).uniform(999.5, 1000.5, 200),  # noise
        np.repeat([1000.0, 1010.0, 1020.0, 1030.0], 50),  # another in each file
        np.repeat([65.534, 65.535], 100),  # two marks
    ],
    ids=["noise", "several", "two"],
)
def test_what_lies_together_far_from_all_depth_is_one_mark(sky: np.ndarray) -> None:
    depth = np.append(slope(1, 4), sky).astype(np.float32)
    found = find_mark([glance("a", "indoor", depth)])
    assert found is not None
    assert found.certain
    assert (found.value, found.greatest) == (np.float32(sky.min()), np.float32(sky.max()))
    assert f"are {sky.min():.6g} to {sky.max():.6g} m away" in str(found)
    assert doubts([glance("a", "indoor", depth)]).medians["indoor"] < 4


@pytest.mark.parametrize(
    "far",
    [
        np.random.default_rng(0).uniform(30, 300, 200),  # what a window shows
        np.full(3, 1000.0) + np.arange(3),  # a few outliers
        np.random.default_rng(0).uniform(14.0, 16.0, 200),  # a hall behind the door
    ],
    ids=["window", "outliers", "hall"],
)
def test_what_is_far_and_may_be_depth_is_no_mark(far: np.ndarray) -> None:
    assert find_mark([glance("a", "indoor", np.append(slope(1, 4), far).astype(np.float32))]) is None


@pytest.mark.parametrize("least", [1e-6, 0.001, 0.1])
def test_the_floor_of_a_program_that_clips_is_named(least: float) -> None:
    depth = np.append(slope(1, 4), np.full(300, least)).astype(np.float32)
    (said,) = doubts([glance("a", "indoor", depth)]).unlikely
    assert f"hold the smallest value, {least:.4g} m" in said
    assert "store 0 there" in said
    for fine in (np.append(slope(1, 4), np.float32(least)), np.append(slope(1, 4), np.full(300, np.float32(0.9)))):
        assert doubts([glance("a", "indoor", fine)]).unlikely == []
