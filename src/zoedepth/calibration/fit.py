"""The scale that brings depth to its readings, where some may be wrong; and how sure it is.

The error of a depth is a factor far rather than a number of metres, so that all is reckoned in the logarithm of depth.
There a network errs with heavy tails, and people mistype: readings that fit the others badly count less, those that do
not fit at all count nothing and are named.
"""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from zoedepth.calibration.calibration import Calibration
from zoedepth.calibration.readings import Distance, Measured, Point, Reading, measure
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import check_size, known_depth
from zoedepth.images import DepthArray

Form = Literal["scale", "scale-shift"]
"""scale: depth * scale. scale-shift: scale and shift of the logarithm of depth, which is scale * depth ** power."""

PIXEL_ERROR = 0.15
"""Standard deviation of the logarithm of depth over truth at one pixel, in a photo whose scale is right."""
PRIOR_READINGS = 4.0
"""Number of readings that count as much as ``PIXEL_ERROR`` does in telling how much the readings scatter."""

_CUTOFF = 4.0  # standard deviations from which on a reading does not fit the others
_QUANTILE_SCALE, _QUANTILE_PIXEL = 1.3, 1.3  # standard deviations that hold the truth in ``COVERAGE`` of the cases
_ROUNDS = 30


def calibrate(
    depth: DepthArray,
    readings: Sequence[Point | Distance] | Float[np.ndarray, "_ _"],
    *,
    camera: Camera | None = None,
    valid: Bool[np.ndarray, "height width"] | None = None,
    along_ray: bool = False,
    form: Form = "scale",
) -> Calibration:
    """Find the scale that brings a depth map to what was measured.

    Args:
        depth: (height, width), metres, as the model gives it.
        readings: (x, y, metres) of pixels, and ((x, y), (x, y), metres) of the distance of two points, in any mixture;
            or a sparse depth map of the depth's size, metres, 0 or NaN where nothing was measured; or an array (N, 3)
            of x, y and metres. The centre of the top left pixel is at (0, 0).
        camera: the camera of the photo at this size. Distances and ``along_ray`` need it.
        valid: True where depth can be compared; elsewhere readings are refused, and those of a map passed over.
        along_ray: readings of single points are the length of the ray from the lens to the thing, as a tape measure or
            a laser at the camera gives it, and not depth along the optical axis.
        form: "scale-shift" also fits a power, where the readings, left out one after the other, say that this predicts
            them better; elsewhere, the scale alone.

    Raises:
        InputError: no reading; one that is outside of the photo, at a pixel without valid depth, or not above 0; or a
            camera that is missing or of another size.
    """
    depth = np.asarray(depth)
    if depth.ndim != 2 or depth.size == 0:
        raise InputError(f"depth must be an array (height, width), got one of shape {depth.shape}")
    if camera is not None:
        check_size(depth, camera)
    if valid is not None and valid.shape != depth.shape:
        raise InputError(f"valid has shape {valid.shape}, and depth {depth.shape}: they must be the same")
    known = known_depth(depth) if valid is None else known_depth(depth) & valid
    measured = measure(depth, readings, camera, known, along_ray=along_ray)
    fit = _fit(measured, form)
    before, after = measured.compared(1.0), fit.scale * measured.compared(fit.power)
    outliers = fit.weights == 0
    return Calibration(
        scale=fit.scale,
        power=fit.power,
        scale_error=fit.scale_error,
        expected_error=fit.expected_error,
        n_readings=len(before),
        readings=tuple(
            Reading(points, float(metres), float(one), float(other), bool(outlier), bool(at_jump))
            for points, metres, one, other, outlier, at_jump in zip(
                measured.points, measured.metres, before, after, outliers, measured.at_jump, strict=True
            )
        ),
        camera=camera,
    )


class _Fit(NamedTuple):
    scale: float
    power: float
    scale_error: float
    expected_error: float
    weights: Float[np.ndarray, " readings"]
    """From 0 for outliers to 1."""


def _fit(measured: Measured, form: Form) -> _Fit:
    """Find the scale, and the power where it is asked for and helps."""
    spread = measured.spread
    metres = np.log(measured.metres)
    ratios = metres - np.log(measured.compared(1.0))
    shift, sigma, weights = _location(ratios, spread)
    power = 1.0
    if form == "scale-shift":
        if not measured.single:
            raise InputError("the distance of two points tells the scale alone: give points and their depth, too")
    n = float(np.sum(weights / spread**2))
    scale_error = math.expm1(_QUANTILE_SCALE * sigma / math.sqrt(max(n, 1e-3)))
    expected = math.expm1(_QUANTILE_PIXEL * sigma * math.sqrt(1 + 1 / max(n, 1e-3)))
    return _Fit(math.exp(shift), power, scale_error, expected, weights)


def _location(
    y: Float[np.ndarray, " readings"], spread: Float[np.ndarray, " readings"]
) -> tuple[float, float, Float[np.ndarray, " readings"]]:
    """Return the robust mean of y, its standard deviation at one pixel, and the weights, 0 for outliers (Tukey's)."""
    center, sigma, weights = _weighted_median(y, 1 / spread), PIXEL_ERROR, np.ones(len(y))
    for _ in range(_ROUNDS):
        error = (y - center) / spread
        sigma = _pixel_error(error)
        weights = np.maximum(0, 1 - (error / (_CUTOFF * sigma)) ** 2) ** 2
        if not weights.any():
            break
        before, center = center, float(np.average(y, weights=weights / spread**2))
        if abs(center - before) < 1e-9:
            break
    return center, sigma, weights


def _pixel_error(error: Float[np.ndarray, " readings"]) -> float:
    """Return the standard deviation of errors, of which some are wrong, and of what is known of models."""
    n = len(error)
    spread = 1.4826 * float(np.median(np.abs(error))) if n > 1 else 0.0
    known = PRIOR_READINGS * PIXEL_ERROR**2
    return math.sqrt((known + (n - 1) * spread**2) / (PRIOR_READINGS + n - 1))


def _weighted_median(y: Float[np.ndarray, " readings"], weights: Float[np.ndarray, " readings"]) -> float:
    order = np.argsort(y)
    share = np.cumsum(weights[order]) / np.sum(weights)
    low, high = (y[order[np.searchsorted(share, 0.5 + offset)]] for offset in (-1e-9, 1e-9))
    return float(low + high) / 2
