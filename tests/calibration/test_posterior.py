"""What readings tell of a scale: against the same integral by brute force, and at its limits."""

import math

import numpy as np
import pytest

from zoedepth.calibration.posterior import (
    OUTLIER,
    PHOTO_ERROR,
    PIXEL_ERROR,
    PIXEL_ERROR_SPREAD,
    SAME_LENS,
    SCALE_ERROR,
    fit_camera,
    fit_scale,
)


def student(x: float, size: float) -> float:
    """Return the density of Student's t with 4 degrees of freedom (its constant is 3/8)."""
    return 3 / 8 / size * (1 + (x / size) ** 2 / 4) ** -2.5


def prior(scale: float, size: float) -> float:
    """Return how likely a log scale and a size of errors are, as the constants say it."""
    total = 0.0
    for lens, share in (("same lens", SAME_LENS), ("other lens", 1 - SAME_LENS)):
        width = SCALE_ERROR[lens]
        if lens == "same lens":
            density = math.exp(-((scale / width) ** 2) / 2) / (width * math.sqrt(2 * math.pi))
        else:
            density = 1 / (math.pi * width * (1 + (scale / width) ** 2))
        total += share * density * math.exp(-((math.log(size / PIXEL_ERROR[lens]) / PIXEL_ERROR_SPREAD) ** 2) / 2)
    return total


@pytest.mark.parametrize("ratios", [[0.3], [0.3, 0.25, 0.5], [-0.6, -0.1, -0.5, -0.55, 1.0]])
def test_the_median_and_the_reach_are_those_of_the_plain_loops(ratios: list[float]) -> None:
    spread = [1.0, 1.5, 1.0, 2.0, 1.0][: len(ratios)]
    scales, sizes = np.linspace(-2, 2, 801), np.exp(np.linspace(math.log(0.03), math.log(0.8), 20))
    weights = np.zeros(len(scales))
    for i, scale in enumerate(scales):
        for size in sizes:
            likelihood = math.prod(student(y - scale, size * s) for y, s in zip(ratios, spread, strict=True))
            weights[i] += prior(float(scale), float(size)) * likelihood
    below = np.cumsum(weights) / weights.sum()
    middle = float(scales[np.searchsorted(below, 0.5)])
    order = np.argsort(np.abs(scales - middle))
    reach = float(np.abs(scales - middle)[order][np.searchsorted(np.cumsum(weights[order]) / weights.sum(), 0.9)])
    posterior, kept = fit_scale(np.array(ratios), np.array(spread))
    if kept.all():
        assert posterior.middle == pytest.approx(middle, abs=0.006)
        assert posterior.reach(0.9) == pytest.approx(reach, rel=0.03)
    else:
        assert ratios[4] == 1.0
        assert kept.tolist() == [True] * 4 + [False]


def test_the_reach_of_a_pixel_is_what_errors_reach_that_are_drawn() -> None:
    posterior, _ = fit_scale(np.array([0.2, 0.3, 0.1, 0.25]), np.ones(4))
    generator = np.random.default_rng(0)
    n_draws = 200_000
    flat = generator.choice(posterior.probability.size, size=n_draws, p=posterior.probability.ravel())
    scale = posterior.grid[flat // posterior.probability.shape[1]] - posterior.middle
    sizes = 0.14 * np.exp(np.linspace(-1.4, 1.7, 14))[flat % posterior.probability.shape[1]]
    spreads = np.array([1.0, 3.0])
    errors = scale + sizes * generator.choice(spreads, size=n_draws) * generator.standard_t(4, size=n_draws)
    for share in (0.5, 0.8, 0.9):
        assert posterior.pixel_reach(spreads, share) == pytest.approx(np.quantile(np.abs(errors), share), rel=0.05)
    assert posterior.pixel_reach(spreads, 0.8, photo_variance=0.04) > posterior.pixel_reach(spreads, 0.8)


def test_many_readings_say_it_alone() -> None:
    generator = np.random.default_rng(1)
    posterior, _ = fit_scale(0.4 + 0.15 * generator.standard_t(4, size=500), np.ones(500))
    assert posterior.middle == pytest.approx(0.4, abs=0.03)
    assert posterior.sigma == pytest.approx(0.15, rel=0.1)
    assert posterior.reach(0.95) < 0.03


def test_readings_less_sure_count_less() -> None:
    sure, unsure = (fit_scale(np.array([0.0, 0.5]), np.array([1.0, spread]))[0].middle for spread in (1.0, 5.0))
    assert unsure < sure / 2


def test_a_reading_is_left_out_beyond_so_many_spreads_of_the_others() -> None:
    ratios = np.append(np.random.default_rng(2).normal(0, 0.1, 30), 0)
    others, _ = fit_scale(ratios[:-1], np.ones(30))
    for factor, fits in ((0.9, True), (1.1, False)):
        ratios[-1] = others.middle + factor * OUTLIER * others.sigma
        assert fit_scale(ratios, np.ones(31))[1].tolist() == [True] * 30 + [fits]


def test_half_of_the_readings_or_more_are_never_left_out() -> None:
    _, kept = fit_scale(np.array([0.0, 0.0, 3.0, 3.0]), np.ones(4))
    assert kept.all()


class TestCamera:
    def test_one_photo_with_many_readings_is_one_photo(self) -> None:
        photos = np.arange(6)
        scales = np.array([0.3, 0.5, 0.4, 0.45, 0.35, 0.4])
        few = fit_camera(scales, np.ones(6), photos)[0]
        many = fit_camera(np.repeat(scales, 30), np.ones(180), np.repeat(photos, 30))[0]
        assert many.middle == pytest.approx(0.4, abs=0.1)
        assert few.middle == pytest.approx(0.4, abs=0.1)
        assert many.reach(0.68) > 0.6 * PHOTO_ERROR / math.sqrt(6)

    def test_a_photo_apart_from_the_others_is_left_out(self) -> None:
        scales = np.array([0.3, 0.5, 0.4, 0.45, 3.0])
        posterior, kept = fit_camera(scales, np.ones(5), np.arange(5))
        assert kept.tolist() == [True] * 4 + [False]
        assert posterior.middle == pytest.approx(0.4, abs=0.1)

    def test_a_wrong_reading_in_a_photo_is_left_out(self) -> None:
        ratios = np.array([0.3, 0.32, 0.31, 2.0, 0.4, 0.42, 0.41])
        _, kept = fit_camera(ratios, np.ones(7), np.array([0, 0, 0, 0, 1, 1, 1]))
        assert kept.tolist() == [True] * 3 + [False] + [True] * 3
