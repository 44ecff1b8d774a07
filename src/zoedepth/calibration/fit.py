"""The scale that brings depth to its readings, where some may be wrong; and how sure it is.

A reading is one sample of the model's errors, and no truth about its scale. So the scale is the mean of what the
readings and two pieces of experience say together (Bayes' rule, on a grid):

- log(truth / depth) at a pixel is spread around that of its photo as Student's t with 4 degrees of freedom: most pixels
  agree well, some err wildly. The spread differs from photo to photo, and where depth changes fast it is larger.
- The scale itself is mostly about right (another room), and sometimes far off (another lens).

One reading that is a little off moves the scale a part of the way, one that is far off, or many that agree, all of the
way; one among many that is far off hardly moves it, and is named. All is reckoned in the logarithm of depth, for the
error of a depth is a factor rather than a number of metres.
"""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from zoedepth.calibration.calibration import Calibration
from zoedepth.calibration.readings import Distance, Measured, Point, Reading, measure, roughness_at, spread_of
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import check_size, known_depth
from zoedepth.images import DepthArray

Form = Literal["scale", "scale-shift"]
"""scale: depth * scale. scale-shift: scale and shift of the logarithm of depth, which is scale * depth ** power."""

PIXEL_ERROR = 0.12
"""Scale of Student's t of log(truth / depth) at pixels of a photo, around that of the photo, where depth is smooth.
Measured with zoed-lite, the mean over photos: 0.08 on KITTI 2015, 0.11 on NYU's test set, 0.13 in a kitchen, 0.14 on a
street with traffic, 0.20 in a rendered apartment."""
PIXEL_ERROR_SPREAD = 0.45
"""Standard deviation of the logarithm of the same between photos: 0.4 over all photos of these five sets."""
SAME_LENS = (0.6, 0.12)
"""Share of photos whose scale is about right, and standard deviation of their log scale: 0.12 on NYU's test set."""
OTHER_LENS = 0.3
"""Scale of Cauchy's distribution of the log scale of the others: half of all lenses are within a factor of 1.35."""
OUTLIER = 3.5
"""Number of spreads beyond which a reading is said not to fit the others, and is left out."""

POWER = 0.2
"""Standard deviation of the power around 1, before any reading."""
MIN_FOR_POWER = 5
"""Number of readings below which there is no power."""
LEVEL = 0.9
"""Probability, by this experience, that is stated as ``COVERAGE``: photos have more ways to be wrong than it knows."""

_DEGREES = 4  # of freedom
_MIN_TO_JUDGE = 3  # of two readings that differ nobody knows which is wrong
_SIGMAS = PIXEL_ERROR * np.exp(np.linspace(-3, 3.5, 14) * PIXEL_ERROR_SPREAD)
_REACHES = np.geomspace(0.01, 5, 100)
_STEPS = 601  # of the grid of log scales
_MARGIN = 1.0  # of the grid on both sides of the readings
_UNLIKELY = 1e-9
_ROUNDS = 50
_PARTS = 10
_PLACES = 16  # pixels along a side of the photo at which roughness is looked at


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
    return Calibration(
        scale=fit.scale,
        power=fit.power,
        scale_error=math.expm1(fit.posterior.reach(LEVEL)),
        expected_error=math.expm1(fit.posterior.pixel_reach(_spreads(depth, known), LEVEL)),
        n_readings=len(before),
        readings=tuple(
            Reading(points, float(metres), float(one), float(other), not fits, bool(at_jump))
            for points, metres, one, other, fits, at_jump in zip(
                measured.points, measured.metres, before, after, fit.kept, measured.at_jump, strict=True
            )
        ),
        camera=camera,
    )


class Posterior(NamedTuple):
    """The probability of each log scale and each size of the errors, given the readings."""

    grid: Float[np.ndarray, " scales"]
    probability: Float[np.ndarray, "scales sigmas"]

    @property
    def mean(self) -> float:
        """The mean of the log scale."""
        return float(self.probability.sum(axis=1) @ self.grid)

    @property
    def sigma(self) -> float:
        """The geometric mean of the scale of Student's t of the errors."""
        return math.exp(float(self.probability.sum(axis=0) @ np.log(_SIGMAS)))

    def reach(self, probability: float) -> float:
        """Return the distance from the mean within which the log scale lies with this probability."""
        distance = np.abs(self.grid - self.mean)
        order = np.argsort(distance)
        return float(np.interp(probability, np.cumsum(self.probability.sum(axis=1)[order]), distance[order]))

    def pixel_reach(self, spreads: Float[np.ndarray, " pixels"], probability: float) -> float:
        """Return the same for log(truth / depth), after calibration, at a pixel that has one of these spreads."""
        variance = float(self.probability.sum(axis=1) @ (self.grid - self.mean) ** 2)
        sizes = np.sqrt((_SIGMAS[:, None] * spreads) ** 2 + variance)
        beyond = 1 - _t_below(_REACHES[:, None, None] / sizes)  # on one side
        outside = 2 * np.einsum("rsp,s->r", beyond, self.probability.sum(axis=0)) / len(spreads)
        return float(np.interp(1 - probability, outside[::-1], _REACHES[::-1]))


def fit_scale(
    ratios: Float[np.ndarray, " readings"], spread: Float[np.ndarray, " readings"]
) -> tuple[Posterior, Bool[np.ndarray, " readings"]]:
    """Return what readings tell of the log scale, and which of them fit.

    Args:
        ratios: log(measured / depth).
        spread: number of times as uncertain as a pixel on smooth ground each reading is.
    """
    kept = np.ones(len(ratios), bool)
    posterior = _posterior(ratios, spread)
    while kept.sum() >= _MIN_TO_JUDGE and 2 * (kept.sum() - 1) > len(ratios):
        error = np.where(kept, np.abs(ratios - posterior.mean) / spread, 0)
        fits = kept & (error <= OUTLIER * posterior.sigma)
        if (fits == kept).all():  # a wrong one may hide behind the size of errors that it makes itself
            fits[error.argmax()] = False
        if 2 * fits.sum() <= len(ratios):
            break
        others = _posterior(ratios[fits], spread[fits])
        if (np.abs(ratios - others.mean) / spread)[kept & ~fits].min() <= OUTLIER * others.sigma:
            break
        kept, posterior = fits, others
    return posterior, kept


class _Fit(NamedTuple):
    scale: float
    power: float
    posterior: Posterior
    kept: Bool[np.ndarray, " readings"]


def _fit(measured: Measured, form: Form) -> _Fit:
    """Fit the scale, and the power where it is asked for and predicts readings better that were left out."""
    spread = measured.spread
    ratios = np.log(measured.metres / measured.compared(1.0))
    posterior, kept = fit_scale(ratios, spread)
    scale_alone = _Fit(math.exp(posterior.mean), 1.0, posterior, kept)
    if form == "scale":
        return scale_alone
    if not measured.single:
        raise InputError("a distance of two points tells the scale alone: for scale-shift, give points")
    depth = np.log(measured.depth[:, 0])
    if len(depth) < MIN_FOR_POWER or not _power_helps(depth, ratios, spread, posterior.sigma):
        return scale_alone
    line = _fit_line(depth, ratios, spread)
    scale = math.exp(line.posterior.mean - (line.power - 1) * line.middle)
    return _Fit(scale, line.power, line.posterior, line.kept)


class _Line(NamedTuple):
    """log(truth / depth) = the mean of ``posterior`` + (power - 1) * (log depth - middle)."""

    power: float
    middle: float
    posterior: Posterior
    kept: Bool[np.ndarray, " readings"]

    def at(self, depth: Float[np.ndarray, " readings"]) -> Float[np.ndarray, " readings"]:
        return self.posterior.mean + (self.power - 1) * (depth - self.middle)


def _fit_line(
    depth: Float[np.ndarray, " readings"],
    ratios: Float[np.ndarray, " readings"],
    spread: Float[np.ndarray, " readings"],
) -> _Line:
    """Fit a power to readings, given the logarithm of depth: least squares, where what fits badly counts less."""
    posterior, kept = fit_scale(ratios, spread)
    x, y, size = depth[kept], ratios[kept], spread[kept] * posterior.sigma
    slope, tail = 0.0, np.ones(len(x))
    for _ in range(_ROUNDS):
        weights = tail / size**2
        x_mean, y_mean = np.average(x, weights=weights), np.average(y, weights=weights)
        covariance = np.sum(weights * (x - x_mean) * (y - y_mean))
        before, slope = slope, float(covariance / (np.sum(weights * (x - x_mean) ** 2) + POWER**-2))
        tail = (_DEGREES + 1) / (_DEGREES + ((y - y_mean - slope * (x - x_mean)) / size) ** 2)
        if abs(slope - before) < 1e-6:
            break
    middle = float(np.median(x))
    return _Line(1 + slope, middle, *fit_scale(ratios - slope * (depth - middle), spread))


def _power_helps(
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
        scale = fit_scale(ratios[others], spread[others])[0].mean
        line = _fit_line(depth[others], ratios[others], spread[others])
        size = sigma * spread[part]
        by_scale, by_line = ratios[part] - scale, ratios[part] - line.at(depth[part])
        gains.append(np.log1p((by_scale / size) ** 2 / _DEGREES) - np.log1p((by_line / size) ** 2 / _DEGREES))
    gain = np.concatenate(gains)
    return bool(gain.mean() > gain.std(ddof=1) / math.sqrt(len(gain)))


def _posterior(ratios: Float[np.ndarray, " readings"], spread: Float[np.ndarray, " readings"]) -> Posterior:
    low, high = min(ratios.min(), 0) - _MARGIN, max(ratios.max(), 0) + _MARGIN
    everywhere = _on_grid(np.linspace(low, high, _STEPS), ratios, spread)
    likely = everywhere.grid[everywhere.probability.sum(axis=1) > _UNLIKELY]
    step = (high - low) / (_STEPS - 1)
    return _on_grid(np.linspace(likely[0] - step, likely[-1] + step, _STEPS), ratios, spread)


def _on_grid(
    grid: Float[np.ndarray, " scales"], ratios: Float[np.ndarray, " readings"], spread: Float[np.ndarray, " readings"]
) -> Posterior:
    log = _log_prior(grid)
    square = ((ratios[:, None] - grid) / spread[:, None]) ** 2 / _DEGREES
    for column, sigma in enumerate(_SIGMAS):
        each = -(_DEGREES + 1) / 2 * np.log1p(square / sigma**2)
        log[:, column] += each.sum(axis=0) - len(ratios) * math.log(sigma)
    probability = np.exp(log - log.max())
    return Posterior(grid, probability / probability.sum())


def _log_prior(grid: Float[np.ndarray, " scales"]) -> Float[np.ndarray, "scales sigmas"]:
    """Return the logarithm, up to a constant, of how likely log scales and sizes of errors are before any reading."""
    share, deviation = SAME_LENS
    same = share * np.exp(-((grid / deviation) ** 2) / 2) / (deviation * math.sqrt(2 * math.pi))
    other = (1 - share) / (math.pi * OTHER_LENS * (1 + (grid / OTHER_LENS) ** 2))
    size = -((np.log(_SIGMAS / PIXEL_ERROR) / PIXEL_ERROR_SPREAD) ** 2) / 2
    return np.log(same + other)[:, None] + size


def _t_below(x: np.ndarray) -> np.ndarray:
    """Return the probability that Student's t with 4 degrees of freedom is below x (it has a closed form)."""
    y = x / np.sqrt(4 + x**2)
    return 0.5 + 0.75 * y - 0.25 * y**3


def _spreads(depth: DepthArray, known: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, " pixels"]:
    """Return the spread of the error at pixels evenly spread over the photo."""
    rows, columns = (np.linspace(0, side - 1, min(side, _PLACES)).round().astype(int) for side in depth.shape)
    rows, columns = (places.ravel() for places in np.meshgrid(rows, columns, indexing="ij"))
    here = known[rows, columns]
    if not here.any():
        return np.ones(1)
    return spread_of(roughness_at(depth, known, rows[here], columns[here]))
