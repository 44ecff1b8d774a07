"""A power of depth, for models that see near things too far and far things too near, or the other way round."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from zoedepth.calibration.posterior import Posterior, fit_scale

POWER = 0.2
"""Standard deviation of the power around 1, before any reading."""
LIMITS = (0.3, 3.0)
"""The least and the greatest power."""
MIN_READINGS = 5
"""Number of readings below which there is no power."""

_DEGREES = 4  # of freedom of Student's t
_PASSES, _ROUNDS = 4, 50
_CONVERGED = 1e-4
_PARTS = 10


class Line(NamedTuple):
    """log(truth / depth) = the middle of ``posterior`` + (power - 1) * (log depth - middle)."""

    power: float
    middle: float
    posterior: Posterior
    kept: Bool[np.ndarray, " readings"]

    def at(self, depth: Float[np.ndarray, " readings"]) -> Float[np.ndarray, " readings"]:
        return self.posterior.middle + (self.power - 1) * (depth - self.middle)


def fit_line(
    depth: Float[np.ndarray, " readings"],
    ratios: Float[np.ndarray, " readings"],
    spread: Float[np.ndarray, " readings"],
) -> Line:
    """Fit a power to readings, given the logarithm of depth: least squares, where what fits badly counts less."""
    slope, middle = 0.0, float(np.median(depth))
    posterior, kept = fit_scale(ratios, spread)
    for _ in range(_PASSES):  # the errors get smaller when the line is known, and what fits changes
        before = slope
        slope = _slope(depth[kept], ratios[kept], spread[kept] * posterior.sigma, slope)
        posterior, kept = fit_scale(ratios - slope * (depth - middle), spread)
        if abs(slope - before) < _CONVERGED:
            break
    return Line(1 + slope, middle, posterior, kept)


def _slope(
    x: Float[np.ndarray, " readings"],
    y: Float[np.ndarray, " readings"],
    size: Float[np.ndarray, " readings"],
    slope: float,
) -> float:
    """Return the slope of a line by weighted least squares, drawn towards 0 as ``POWER`` says."""
    offset = float(np.median(y - slope * x))
    for _ in range(_ROUNDS):
        tail = (_DEGREES + 1) / (_DEGREES + ((y - offset - slope * x) / size) ** 2)
        weights = tail / size**2
        x_mean, y_mean = np.average(x, weights=weights), np.average(y, weights=weights)
        covariance = np.sum(weights * (x - x_mean) * (y - y_mean))
        estimate = float(covariance / (np.sum(weights * (x - x_mean) ** 2) + POWER**-2))
        before, slope = slope, min(max(estimate, LIMITS[0] - 1), LIMITS[1] - 1)
        offset = float(y_mean - slope * x_mean)
        if abs(slope - before) < _CONVERGED:
            break
    return slope


def power_helps(
    depth: Float[np.ndarray, " readings"],
    ratios: Float[np.ndarray, " readings"],
    spread: Float[np.ndarray, " readings"],
    sigma: float,
) -> bool:
    """Return True if, of readings that were left out, a power predicts more than the scale alone does.

    Readings are left out one after the other, or in ten parts where they are many. The loss is that of Student's t; its
    mean must fall by more than one standard error.
    """
    gains = []
    for part in np.array_split(np.arange(len(depth)), min(len(depth), _PARTS)):
        others = np.ones(len(depth), bool)
        others[part] = False
        scale = fit_scale(ratios[others], spread[others])[0].middle
        line = fit_line(depth[others], ratios[others], spread[others])
        size = sigma * spread[part]
        by_scale, by_line = ratios[part] - scale, ratios[part] - line.at(depth[part])
        gains.append(np.log1p((by_scale / size) ** 2 / _DEGREES) - np.log1p((by_line / size) ** 2 / _DEGREES))
    gain = np.concatenate(gains)
    return bool(gain.mean() > gain.std(ddof=1) / math.sqrt(len(gain)))
