"""Agreement of depth edges on steps whose edges are known."""

from collections.abc import Callable

import numpy as np
import pytest

from zoedepth.evaluation.boundaries import MIN_PAIRS, THRESHOLDS, boundary_f1

HEIGHT, WIDTH = 120, 60


def step(*, at: int = 30, near: float = 2.0, far: float = 4.0) -> np.ndarray:
    """Make a depth that is near on the left and far from column ``at`` on: 120 edges."""
    return np.where(np.arange(WIDTH) < at, near, far) * np.ones((HEIGHT, 1))


def f1(depth: np.ndarray, truth: np.ndarray, known: np.ndarray | None = None) -> float | None:
    return boundary_f1(depth, truth, np.ones(truth.shape, dtype=bool) if known is None else known)


def rough(seed: int = 0) -> np.ndarray:
    """Make a depth with edges of all heights in all directions."""
    return np.exp(np.random.default_rng(seed).normal(0, 0.15, size=(40, 50)))


def test_perfect_depth_is_1() -> None:
    assert f1(step(), step()) == 1
    assert f1(rough(), rough()) == pytest.approx(1, abs=1e-12)


def test_perfect_depth_is_1_also_where_no_edge_is_as_high_as_the_last_thresholds() -> None:
    low = step(near=2.0, far=2.25)  # 12.5 %: above 5 and 10 %
    assert f1(low, low) == 1


def test_edge_that_is_not_there_or_falls_the_other_way_is_0() -> None:
    assert f1(np.full_like(step(), 3.0), step()) == 0
    assert f1(step(near=4.0, far=2.0), step()) == 0


@pytest.mark.parametrize("shift", [-1, 1])
def test_edge_beside_the_true_one_is_0(shift: int) -> None:
    assert f1(step(at=30 + shift), step()) == 0


def test_blurred_step_is_worse_the_wider_it_is() -> None:
    def blurred(width: int) -> np.ndarray:
        ramp = np.clip((np.arange(WIDTH) + 0.5 - 30) / width + 0.5, 0, 1)
        return (2.0 + 2.0 * ramp) * np.ones((HEIGHT, 1))

    scores = [f1(blurred(width), step()) for width in (1, 3, 5, 9)]
    assert scores[0] == 1
    assert scores == sorted(scores, reverse=True)
    assert len(set(scores)) == 4


def test_thresholds_count_by_how_far_they_are_above_1() -> None:
    # 12.5 % where 100 % is true: found at 5 and 10 of 5, 10, 15, 20, 25 %.
    assert f1(step(near=2.0, far=2.25), step()) == pytest.approx((5 + 10) / (5 + 10 + 15 + 20 + 25))


def test_thresholds_at_which_only_the_prediction_has_an_edge_count() -> None:
    assert f1(step(), step(near=2.0, far=2.25)) == pytest.approx((5 + 10) / (5 + 10 + 15 + 20 + 25))


def test_edge_is_more_than_the_threshold() -> None:
    # 25 % is not more than 25 %; 1.25 and these depths are exact.
    assert f1(step(near=2.0, far=2.5), step()) == pytest.approx((5 + 10 + 15 + 20) / (5 + 10 + 15 + 20 + 25))


def test_false_edges_and_missing_ones_count_alike() -> None:
    two = step()
    two[:, 45:] = 8.0
    # Of two edges in a row one is common: precision 1/2 and recall 1, or the other way round.
    assert f1(two, step()) == pytest.approx(2 / 3)
    assert f1(step(), two) == pytest.approx(2 / 3)


@pytest.mark.parametrize("factor", [0.5, 1.25, 30.0])
def test_factor_on_the_depth_changes_nothing(factor: float) -> None:
    depth, truth = rough(1) * rough(), rough()
    expected = f1(depth, truth)
    assert expected is not None
    assert 0 < expected < 1
    assert f1(factor * depth, truth) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("turn", [np.fliplr, np.flipud, np.transpose, np.rot90])
def test_mirrored_and_turned_pictures_score_the_same(turn: Callable[[np.ndarray], np.ndarray]) -> None:
    depth, truth = rough(1) * rough(), rough()
    known = np.random.default_rng(2).random(truth.shape) < 0.9
    expected = f1(depth, truth, known)
    assert expected is not None
    assert f1(turn(depth), turn(truth), turn(known)) == pytest.approx(expected, abs=1e-12)


def test_only_pairs_of_known_neighbours_count() -> None:
    truth, depth = step(), step()
    depth[:10, 30:] = 1.0  # falls the other way in ten rows, and towards the eleventh
    known = np.ones(truth.shape, dtype=bool)
    assert f1(depth, truth, known) < 0.9
    known[:10, 30] = known[9, 30:] = False
    assert f1(depth, truth, known) == 1


def test_what_is_unknown_may_be_anything() -> None:
    truth, known = step(), np.ones(step().shape, dtype=bool)
    known[:, ::7] = False
    depth = np.where(known, truth, np.nan)
    assert f1(depth, np.where(known, truth, 0.0), known) == 1


def test_truth_without_edges_has_no_score() -> None:
    plane = np.linspace(2, 4, WIDTH) * np.ones((HEIGHT, 1))  # 3 % from one to the next
    assert f1(step(), plane) is None


def test_sparse_truth_has_no_score() -> None:
    truth, known = rough(), np.zeros((40, 50), dtype=bool)
    known[::2, ::2] = True
    assert f1(truth, truth, known) is None


def test_too_few_edges_have_no_score() -> None:
    assert f1(step()[: MIN_PAIRS - 1], step()[: MIN_PAIRS - 1]) is None
    assert f1(step()[:MIN_PAIRS], step()[:MIN_PAIRS]) == 1


def test_counts_are_those_of_a_plain_loop_over_pairs() -> None:
    rng = np.random.default_rng(1)
    truth, depth = rough(1), rough(1) * np.exp(rng.normal(0, 0.05, size=(40, 50)))
    known = rng.random(truth.shape) < 0.9
    truth[~known] = np.nan  # what is unknown is never looked at
    pairs = [
        ((y, x), (y + dy, x + dx))
        for y in range(40)
        for x in range(50)
        for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0))
        if 0 <= y + dy < 40 and 0 <= x + dx < 50 and known[y, x] and known[y + dy, x + dx]
    ]
    scores = []
    for threshold in THRESHOLDS:
        true, found = ({(a, b) for a, b in pairs if map_[b] > threshold * map_[a]} for map_ in (truth, depth))
        scores.append(2 * len(true & found) / (len(true) + len(found)))
    expected = np.average(scores, weights=[threshold - 1 for threshold in THRESHOLDS])
    assert 0.2 < expected < 0.95
    assert f1(depth, truth, known) == pytest.approx(expected, rel=1e-12)
