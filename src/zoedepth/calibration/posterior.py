"""Tell the scale from readings, by Bayes' rule, on top of what is known of the errors of models.

A reading is one sample of the model's errors, and no truth about its scale. So the scale is what is as likely
too large as too small, by the readings and two pieces of experience together:

- log(truth / depth) at a pixel is spread around that of its photo as Student's t with 4 degrees of freedom: most pixels
  agree well, some err wildly. The spread differs from photo to photo, and where depth changes fast it is larger.
- The scale of a photo is about right where the lens is like that of the training photos, and can be anything where it
  is not; there, pixels err more, too.

One reading that is a little off moves the scale half of the way, one that is far off, or many that agree, nearly all of
it; one among many that is far off hardly moves it, and is named. All is reckoned in the logarithm of depth, for the
error of a depth is a factor rather than a number of metres.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

PIXEL_ERROR = {"same lens": 0.12, "other lens": 0.2}
"""Scale of Student's t of log(truth / depth) at pixels of a photo, around that of the photo, where depth is smooth.
Measured with zoed-lite, the mean over photos: 0.08 on KITTI 2015, 0.11 on NYU's test set, 0.13 in another room with the
same lens, 0.14 on another street; 0.20 in a rendered apartment through a lens of 90 degrees."""
PIXEL_ERROR_SPREAD = 0.45
"""Standard deviation of the logarithm of the same between photos: 0.4 over the photos of these five sets."""
SAME_LENS = 0.4
"""Probability of a lens like that of the training photos, before any reading."""
SCALE_ERROR = {"same lens": 0.1, "other lens": 0.4}
"""Standard deviation of the log scale of photos with the same lens (measured: 0.03 on KITTI 2015, 0.12 on NYU's test
set), and half width of Cauchy's distribution of that of others: half of those are within a factor of 1.5."""
PHOTO_ERROR = 0.15
"""Standard deviation of the log scale of the photos of one camera around that of the camera. Measured: 0.03 on KITTI
2015, 0.12 on NYU's test set, 0.15 in the kitchen and in the apartment."""
OUTLIER = 3.5
"""Number of spreads beyond which a reading is said not to fit the others, and is left out."""

_DEGREES = 4  # of freedom
_MIN_TO_JUDGE = 3  # of two readings that differ nobody knows which is wrong
_SIGMAS = 0.14 * np.exp(np.linspace(-1.4, 1.7, 14))  # sizes of errors
_REACHES = np.geomspace(0.01, 5, 100)
_STEPS = 401  # of the grid of log scales
_MARGIN = 1.0  # of the grid on both sides of the readings
_UNLIKELY = 1e-9


class Posterior(NamedTuple):
    """The probability of each log scale and each size of the errors, given the readings."""

    grid: Float[np.ndarray, " scales"]
    probability: Float[np.ndarray, "scales sigmas"]

    @property
    def middle(self) -> float:
        """The median of the log scale: it is as likely larger as smaller."""
        scales = self.probability.sum(axis=1)
        return float(np.interp(0.5, np.cumsum(scales) - scales / 2, self.grid))

    @property
    def variance(self) -> float:
        """The mean square of the distance of the log scale from its median."""
        return float(self.probability.sum(axis=1) @ (self.grid - self.middle) ** 2)

    @property
    def sigma(self) -> float:
        """The geometric mean of the scale of Student's t of the errors."""
        return math.exp(float(self.probability.sum(axis=0) @ np.log(_SIGMAS)))

    def reach(self, probability: float) -> float:
        """Return the distance from the median within which the log scale lies with this probability."""
        distance = np.abs(self.grid - self.middle)
        order = np.argsort(distance)
        return float(np.interp(probability, np.cumsum(self.probability.sum(axis=1)[order]), distance[order]))

    def pixel_reach(
        self, spreads: Float[np.ndarray, " pixels"], probability: float, *, photo_variance: float = 0.0
    ) -> float:
        """Return the same for log(truth / depth), after calibration, at a pixel that has one of these spreads.

        Args:
            spreads: number of times as uncertain as on smooth ground pixels are.
            probability: share of the pixels whose truth lies within.
            photo_variance: variance of the log scale of the pixel's photo around the one that was found.
        """
        sizes = np.sqrt((_SIGMAS[:, None] * spreads) ** 2 + self.variance + photo_variance)
        beyond = 1 - _t_below(_REACHES[:, None, None] / sizes)  # on one side
        outside = 2 * np.einsum("rsp,s->r", beyond, self.probability.sum(axis=0)) / len(spreads)
        return float(np.interp(1 - probability, outside[::-1], _REACHES[::-1]))


def fit_scale(
    ratios: Float[np.ndarray, " readings"], spread: Float[np.ndarray, " readings"]
) -> tuple[Posterior, Bool[np.ndarray, " readings"]]:
    """Return what readings tell of the log scale of their photo, and which of them fit.

    Args:
        ratios: log(measured / depth).
        spread: number of times as uncertain as a pixel on smooth ground each reading is.
    """
    kept = np.ones(len(ratios), bool)
    posterior = _posterior(ratios, spread)
    while kept.sum() >= _MIN_TO_JUDGE and 2 * (kept.sum() - 1) > len(ratios):
        error = np.abs(ratios - posterior.middle) / spread
        fits = kept & (error <= OUTLIER * posterior.sigma)
        if (fits == kept).all():  # a wrong one may hide behind the size of errors that it makes itself
            fits[np.where(kept, error, 0).argmax()] = False
        if 2 * fits.sum() <= len(ratios):
            break
        posterior_of_others = _posterior(ratios[fits], spread[fits])
        error = np.abs(ratios - posterior_of_others.middle) / spread
        fits = kept & (error <= OUTLIER * posterior_of_others.sigma)
        if (fits == kept).all() or 2 * fits.sum() <= len(ratios):
            break
        kept, posterior = fits, _posterior(ratios[fits], spread[fits])
    return posterior, kept


def fit_camera(
    ratios: Float[np.ndarray, " readings"],
    spread: Float[np.ndarray, " readings"],
    photos: Int[np.ndarray, " readings"],
) -> tuple[Posterior, Bool[np.ndarray, " readings"]]:
    """Return what readings in several photos tell of the log scale of their camera, and which of them fit.

    Readings of one photo are off together, by ``PHOTO_ERROR``: ten of them in one photo tell less than one in each of
    ten photos.

    Args:
        ratios: log(measured / depth).
        spread: number of times as uncertain as a pixel on smooth ground each reading is.
        photos: number of the photo of each reading.
    """
    grid = _grid(ratios)
    kept = np.ones(len(ratios), bool)
    log = _log_prior(grid)
    among_photos = np.exp(-(((grid[:, None] - grid) / PHOTO_ERROR) ** 2) / 2)
    for photo in np.unique(photos):
        here = photos == photo
        kept[here] = fit_scale(ratios[here], spread[here])[1]
        here &= kept
        likelihood = _log_likelihood(grid, ratios[here], spread[here])
        # The scale of a photo is that of the camera and something of its own.
        most = likelihood.max(axis=0)
        log += np.log(among_photos @ np.exp(likelihood - most)) + most
    posterior = _normalized(grid, log)
    size = np.hypot(posterior.sigma * spread, PHOTO_ERROR)
    if len(ratios) >= _MIN_TO_JUDGE:
        kept &= np.abs(ratios - posterior.middle) <= OUTLIER * size
    return posterior, kept


def _posterior(ratios: Float[np.ndarray, " readings"], spread: Float[np.ndarray, " readings"]) -> Posterior:
    wide = _grid(ratios)
    everywhere = _on_grid(wide, ratios, spread)
    likely = wide[everywhere.probability.sum(axis=1) > _UNLIKELY]
    step = wide[1] - wide[0]
    return _on_grid(np.linspace(likely[0] - step, likely[-1] + step, _STEPS), ratios, spread)


def _grid(ratios: Float[np.ndarray, " readings"]) -> Float[np.ndarray, " scales"]:
    return np.linspace(min(ratios.min(), 0) - _MARGIN, max(ratios.max(), 0) + _MARGIN, _STEPS)


def _on_grid(
    grid: Float[np.ndarray, " scales"], ratios: Float[np.ndarray, " readings"], spread: Float[np.ndarray, " readings"]
) -> Posterior:
    return _normalized(grid, _log_prior(grid) + _log_likelihood(grid, ratios, spread))


def _normalized(grid: Float[np.ndarray, " scales"], log: Float[np.ndarray, "scales sigmas"]) -> Posterior:
    probability = np.exp(log - log.max())
    return Posterior(grid, probability / probability.sum())


def _log_likelihood(
    grid: Float[np.ndarray, " scales"], ratios: Float[np.ndarray, " readings"], spread: Float[np.ndarray, " readings"]
) -> Float[np.ndarray, "scales sigmas"]:
    """Return the logarithm, up to a constant, of how likely the readings are, given log scales and sizes of errors."""
    square = ((ratios[:, None] - grid) / spread[:, None]) ** 2 / _DEGREES
    log = np.empty((len(grid), len(_SIGMAS)))
    for column, sigma in enumerate(_SIGMAS):
        log[:, column] = -(_DEGREES + 1) / 2 * np.log1p(square / sigma**2).sum(axis=0) - len(ratios) * math.log(sigma)
    return log


def _log_prior(grid: Float[np.ndarray, " scales"]) -> Float[np.ndarray, "scales sigmas"]:
    """Return the logarithm of how likely log scales and sizes of errors are before any reading."""
    same, other = (_log_scale(grid, lens)[:, None] + _log_size(lens) for lens in SCALE_ERROR)
    return np.logaddexp(same, other)


def _log_scale(grid: Float[np.ndarray, " scales"], lens: str) -> Float[np.ndarray, " scales"]:
    """Return the logarithm of how likely a lens and its log scales are before any reading."""
    width = SCALE_ERROR[lens]
    if lens == "same lens":
        return math.log(SAME_LENS / (width * math.sqrt(2 * math.pi))) - (grid / width) ** 2 / 2
    return math.log((1 - SAME_LENS) / (math.pi * width)) - np.log1p((grid / width) ** 2)


def _log_size(lens: str) -> Float[np.ndarray, " sigmas"]:
    """Return the logarithm of how likely sizes of errors are with a lens, before any reading."""
    log = -((np.log(_SIGMAS / PIXEL_ERROR[lens]) / PIXEL_ERROR_SPREAD) ** 2) / 2
    return log - np.log(np.exp(log).sum())


def _t_below(x: np.ndarray) -> np.ndarray:
    """Return the probability that Student's t with 4 degrees of freedom is below x (it has a closed form)."""
    y = x / np.sqrt(4 + x**2)
    return 0.5 + 0.75 * y - 0.25 * y**3
