"""The power of depth: found where it is there, and taken only where readings that were left out ask for it."""

import numpy as np
import pytest

from zoedepth.calibration.power import LIMITS, fit_line, power_helps


def line(n: int, *, slope: float, noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return log depths, log ratios that lie on a line, and their spread."""
    generator = np.random.default_rng(seed)
    depth = generator.uniform(0, 2, n)
    return depth, 0.3 + slope * (depth - 1) + noise * generator.normal(size=n), np.ones(n)


def test_finds_a_line() -> None:
    depth, ratios, spread = line(40, slope=0.4, noise=0.02)
    found = fit_line(depth, ratios, spread)
    assert found.power == pytest.approx(1.4, abs=0.03)
    np.testing.assert_allclose(found.at(np.array([0.0, 2.0])), [-0.1, 0.7], atol=0.05)


def test_a_wrong_reading_does_not_turn_it() -> None:
    depth, ratios, spread = line(20, slope=0.3, noise=0.05)
    before = fit_line(depth, ratios, spread).power
    ratios[depth.argmax()] += 2
    found = fit_line(depth, ratios, spread)
    assert found.power == pytest.approx(before, abs=0.05)
    assert found.kept.sum() == 19


def test_few_readings_are_not_believed_much() -> None:
    depth, ratios, spread = line(3, slope=0.5, noise=0.0)
    assert 1 < fit_line(depth, ratios, spread).power < 1.5


@pytest.mark.parametrize(("slope", "limit"), [(-1.5, LIMITS[0]), (2.5, LIMITS[1])])
def test_is_bounded(slope: float, limit: float) -> None:
    depth, ratios, spread = line(100, slope=slope, noise=0.02)
    assert fit_line(depth, ratios, spread).power == pytest.approx(limit)


def test_helps_where_it_is_there_only() -> None:
    assert power_helps(*line(12, slope=0.4, noise=0.05), sigma=0.1)
    helped = [power_helps(*line(12, slope=0.0, noise=0.1, seed=seed), sigma=0.1) for seed in range(5)]
    assert np.mean(helped) < 0.4
