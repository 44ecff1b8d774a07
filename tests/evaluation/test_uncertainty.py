"""Whether doubts are in the order of the errors, and cover them: cases with a known answer."""

import dataclasses
import math

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.evaluation.uncertainty import STEPS, UncertaintyScores, fit_std_factor, score_uncertainty

_RNG = np.random.default_rng(0)
TRUTH = _RNG.uniform(1, 9, size=4000)
DEPTH = TRUTH * np.exp(_RNG.normal(0, 0.2, size=4000))
ERROR = np.abs(DEPTH - TRUTH)


def doubts_in_the_order_of(values: np.ndarray) -> np.ndarray:
    """Make standard deviations that are in this order, relative to the depth."""
    return DEPTH * (values.argsort().argsort() + 1) / len(values)


def test_doubts_in_the_order_of_the_errors_are_0() -> None:
    assert score_uncertainty(DEPTH, TRUTH, doubts_in_the_order_of(ERROR / TRUTH)).ause == 0


def test_doubts_proportional_to_the_errors_of_one_depth_are_0() -> None:
    truth = np.full(500, 4.0)
    depth = truth + np.linspace(0, 1, 500)
    assert score_uncertainty(depth, truth, 0.5 * (depth - truth)).ause == pytest.approx(0, abs=1e-12)


def test_doubts_at_random_are_1() -> None:
    rng = np.random.default_rng(1)
    assert score_uncertainty(DEPTH, TRUTH, DEPTH * rng.uniform(0.1, 1, size=4000)).ause == pytest.approx(1, abs=0.1)


def test_same_doubt_everywhere_is_1() -> None:
    # No order: pixels as they come, which here is at random.
    assert score_uncertainty(DEPTH, TRUTH, 0.3 * DEPTH).ause == pytest.approx(1, abs=0.1)


def test_pixels_of_the_same_doubt_are_removed_as_they_come() -> None:
    rng = np.random.default_rng(1)
    n = 50 * STEPS
    truth = 4 / rng.uniform(1.1, 1.9, size=n)
    error = 4 / truth - 1
    remaining, best = ([values[50 * k :].mean() for k in range(STEPS)] for values in (error, np.sort(error)[::-1]))
    expected = (np.mean(remaining) - np.mean(best)) / (error.mean() - np.mean(best))
    assert score_uncertainty(np.full(n, 4.0), truth, np.ones(n)).ause == pytest.approx(expected, rel=1e-9)


def test_doubts_in_the_opposite_order_are_worse_than_at_random() -> None:
    assert score_uncertainty(DEPTH, TRUTH, doubts_in_the_order_of(-ERROR / TRUTH)).ause > 1.5


def test_better_order_is_lower() -> None:
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 1, size=4000)
    found = [
        score_uncertainty(DEPTH, TRUTH, doubts_in_the_order_of(ERROR / TRUTH + s * noise)).ause
        for s in (0, 0.05, 0.2, 1)
    ]
    assert found == sorted(found)
    assert len(set(found)) == 4


def test_doubts_are_relative_to_the_predicted_depth() -> None:
    rng = np.random.default_rng(1)
    std = doubts_in_the_order_of(rng.uniform(0, 1, size=4000))
    found = score_uncertainty(DEPTH, TRUTH, std)
    assert score_uncertainty(DEPTH, TRUTH, 7 * std).ause == found.ause
    assert score_uncertainty(3 * DEPTH, 3 * TRUTH, 3 * std).ause == pytest.approx(found.ause, rel=1e-9)


def test_area_by_hand() -> None:
    # Errors 0.1 to 2.0 in doubts' order but for the two worst, which change places.
    n = STEPS
    relative = np.arange(1, n + 1) / 10
    truth = np.ones(n)
    ranks = np.arange(1, n + 1)
    ranks[[-1, -2]] = ranks[[-2, -1]]
    depth = truth + relative
    # Taken away one by one: what is left differs only after the first, by the difference of the two over 19.
    best = [relative[: n - k].mean() for k in range(n)]
    expected = (0.1 / 19) / n / np.mean(relative.mean() - best)
    assert score_uncertainty(depth, truth, ranks * depth).ause == pytest.approx(expected, rel=1e-9)


def test_coverages_by_hand() -> None:
    truth = np.full(8, 4.0)
    depth = truth + np.array([0, 0.5, -0.5, 0.75, 1.0, -1.0, 1.25, -3.0])
    # The border counts as within.
    found = score_uncertainty(depth, truth, np.full(8, 0.5))
    assert (found.coverage1, found.coverage2) == (3 / 8, 6 / 8)


def test_normal_errors_are_covered_as_they_must() -> None:
    rng = np.random.default_rng(1)
    truth = np.full(100_000, 10.0)
    found = score_uncertainty(truth + rng.normal(0, 0.5, size=100_000), truth, np.full(100_000, 0.5))
    assert (found.coverage1, found.coverage2) == (pytest.approx(0.6827, abs=0.01), pytest.approx(0.9545, abs=0.01))


@pytest.mark.filterwarnings("error")
def test_perfect_prediction_and_no_doubt_divide_nothing_by_zero() -> None:
    assert score_uncertainty(TRUTH, TRUTH, np.zeros(4000)) == UncertaintyScores(0.0, 1.0, 1.0)
    assert score_uncertainty(DEPTH, TRUTH, np.zeros(4000)).coverage2 == 0


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("n", [1, 2, STEPS - 1, STEPS + 1])
def test_few_pixels_have_numbers_too(n: int) -> None:
    found = score_uncertainty(DEPTH[:n], TRUTH[:n], ERROR[:n])
    assert np.isfinite(dataclasses.astuple(found)).all()
    assert found.coverage1 == 1


@pytest.mark.parametrize("levels", [1, 7, 3000, 10**9])
def test_equal_doubts_are_taken_as_they_come(levels: int) -> None:
    """So that the score is the same on every processor, whatever its way of sorting."""
    rng = np.random.default_rng(1)
    doubts = np.ceil(rng.uniform(0, levels, size=len(DEPTH)))
    found = score_uncertainty(DEPTH, TRUTH, DEPTH * doubts)
    relative = (ERROR / TRUTH)[np.argsort(-(DEPTH * doubts / DEPTH), kind="stable")]
    worst = np.sort(ERROR / TRUTH)[::-1]
    starts = np.arange(STEPS) * len(DEPTH) // STEPS
    one, other = ([float(np.mean(errors[start:])) for start in starts] for errors in (relative, worst))
    chance = np.mean(worst) - np.mean(other)
    assert found.ause == pytest.approx((np.mean(one) - np.mean(other)) / chance, rel=1e-9)


def test_factor_makes_errors_as_large_as_the_deviation_says() -> None:
    rng = np.random.default_rng(1)
    std = 0.2 * TRUTH
    errors = [np.abs(rng.normal(0, 3 * std)) / std for _ in range(5)]
    factor = fit_std_factor(errors)
    assert factor == pytest.approx(3, rel=0.03)
    assert fit_std_factor([of_photo / factor for of_photo in errors]) == pytest.approx(1)
    assert np.mean(np.concatenate(errors) <= factor) == pytest.approx(0.6827, abs=0.02)


def test_each_photo_counts_the_same_for_the_factor() -> None:
    assert fit_std_factor([np.full(1000, 1.0), np.full(10, 7.0)]) == pytest.approx(5)  # the root of (1 + 49) / 2


@pytest.mark.parametrize("errors", [[], [np.array([0.0, 0.0])], [np.array([1.0, math.inf])]])
def test_there_is_no_factor_without_errors_or_with_deviations_of_0(errors: list[np.ndarray]) -> None:
    with pytest.raises(InputError, match="factor on the standard deviation"):
        fit_std_factor(errors)
