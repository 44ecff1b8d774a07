"""The field's metrics, in float64: for one image, as a mean over images (the paper's way), or over all pixels."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float

from zoedepth.errors import InputError


@dataclass(frozen=True)
class Metrics:
    """Errors of one image or of a set of pixels, or their means over images."""

    rel: float
    """Mean of |truth - prediction| / truth."""
    rmse: float
    """Root mean squared error, metres."""
    log10: float
    """Mean of |log10 truth - log10 prediction|."""
    delta1: float
    """Share of pixels with max(truth / prediction, prediction / truth) < 1.25."""
    delta2: float
    """Share of pixels with that ratio below 1.25 ** 2."""
    delta3: float
    """Share of pixels with that ratio below 1.25 ** 3."""
    silog: float
    """100 times the standard deviation of ln prediction - ln truth: the error that no factor could remove."""
    sq_rel: float
    """Mean of (truth - prediction) ** 2 / truth, metres."""
    rmse_log: float
    """Root mean square of ln prediction - ln truth."""


HEADINGS = {
    "rel": "REL", "rmse": "RMSE (m)", "log10": "log10", "delta1": "delta1", "delta2": "delta2", "delta3": "delta3",
    "silog": "SILog", "sq_rel": "SqRel (m)", "rmse_log": "RMSE log",
}  # fmt: skip
"""Column headings of tables, with units."""

HIGHER_IS_BETTER = frozenset({"delta1", "delta2", "delta3"})
"""Metrics that measure agreement; the others measure error."""


@dataclass(frozen=True)
class Sums:
    """Sums that the metrics of a set of pixels are made of. ``add_sums`` joins those of several sets."""

    n_pixels: int = 0
    rel: float = 0.0
    square: float = 0.0
    log10: float = 0.0
    delta1: int = 0
    delta2: int = 0
    delta3: int = 0
    log: float = 0.0
    log_deviation: float = 0.0
    """Sum of squared deviations of ln prediction - ln truth from their own mean."""
    sq_rel: float = 0.0

    def metrics(self) -> Metrics:
        """Compute the metrics of these pixels.

        Raises:
            InputError: there are no pixels.
        """
        n = self.n_pixels
        if not n:
            raise InputError("there is no pixel to score: no depth is known in the range and crop that are scored")
        variance = self.log_deviation / n
        return Metrics(
            rel=self.rel / n,
            rmse=math.sqrt(self.square / n),
            log10=self.log10 / n,
            delta1=self.delta1 / n,
            delta2=self.delta2 / n,
            delta3=self.delta3 / n,
            silog=100 * math.sqrt(variance),
            sq_rel=self.sq_rel / n,
            rmse_log=math.sqrt(variance + (self.log / n) ** 2),
        )


def pixel_sums(prediction: Float[np.ndarray, " pixels"], truth: Float[np.ndarray, " pixels"]) -> Sums:
    """Sum up the errors of the known pixels of one image, both maps in metres and > 0.

    Raises:
        InputError: different numbers of pixels, or values that are not finite and positive.
    """
    prediction, truth = prediction.astype(np.float64), truth.astype(np.float64)
    if prediction.shape != truth.shape or prediction.ndim != 1:
        raise InputError(
            f"prediction and truth must be two lists of the same pixels; got {prediction.shape} and {truth.shape}"
        )
    for name, values in (("prediction", prediction), ("truth", truth)):
        if not (np.isfinite(values) & (values > 0)).all():
            raise InputError(f"the {name} must be finite and > 0 metres at every pixel that is scored; mask the others")
    error = prediction - truth
    log = np.log(prediction) - np.log(truth)
    ratio = np.maximum(truth / prediction, prediction / truth)
    return Sums(
        n_pixels=len(truth),
        rel=float(np.sum(np.abs(error) / truth)),
        square=float(np.sum(error**2)),
        log10=float(np.sum(np.abs(log))) / math.log(10),
        delta1=int(np.sum(ratio < 1.25)),
        delta2=int(np.sum(ratio < 1.25**2)),
        delta3=int(np.sum(ratio < 1.25**3)),
        log=float(np.sum(log)),
        # sum(log ** 2) - n mean ** 2 would be wrong by 1e-7 where the prediction is off by one factor everywhere.
        log_deviation=float(np.sum((log - log.mean()) ** 2)) if len(log) else 0.0,
        sq_rel=float(np.sum(error**2 / truth)),
    )


def compute_metrics(prediction: Float[np.ndarray, " pixels"], truth: Float[np.ndarray, " pixels"]) -> Metrics:
    """Compute the errors of the known pixels of one image, both maps in metres and > 0.

    Raises:
        InputError: no pixels, different numbers of them, or values that are not finite and positive.
    """
    return pixel_sums(prediction, truth).metrics()


def mean_metrics(images: Sequence[Metrics]) -> Metrics:
    """Average over images, as the paper does. The sum is exact: the order of the images does not matter.

    Raises:
        InputError: there are no images.
    """
    if not images:
        raise InputError("no image to average: none has a known pixel under this protocol")
    return Metrics(**{f.name: math.fsum(getattr(image, f.name) for image in images) / len(images)
                      for f in fields(Metrics)})  # fmt: skip


def pooled_metrics(images: Sequence[Sums]) -> Metrics:
    """Compute the metrics of all pixels of all images at once, exactly and in any order.

    Raises:
        InputError: there is no pixel.
    """
    return add_sums(images).metrics()


def add_sums(sums: Sequence[Sums]) -> Sums:
    """Join the sums of several sets of pixels, whatever their order."""
    columns = {f.name: [getattr(one, f.name) for one in sums] for f in fields(Sums)}
    totals = {name: sum(values) if name in _COUNTS else math.fsum(values) for name, values in columns.items()}
    mean = totals["log"] / max(totals["n_pixels"], 1)
    between = (one.n_pixels * (one.log / one.n_pixels - mean) ** 2 for one in sums if one.n_pixels)
    return Sums(**{**totals, "log_deviation": math.fsum([totals["log_deviation"], *between])})


_COUNTS = ("n_pixels", "delta1", "delta2", "delta3")
