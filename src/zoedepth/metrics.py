"""The paper's metrics, in float64, image by image (section 4.3)."""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float

from zoedepth.errors import InputError


@dataclass(frozen=True)
class Metrics:
    """Errors of one image, or their means over images."""

    rel: float
    """Mean of |truth - prediction| / truth."""
    rmse: float
    """Root mean squared error, metres."""
    log10: float
    """Mean of |log10 truth - log10 prediction|."""
    delta1: float
    """Share of pixels with max(truth / prediction, prediction / truth) < 1.25."""
    delta2: float
    """The same below 1.25 ** 2."""
    delta3: float
    """The same below 1.25 ** 3."""


def compute_metrics(prediction: Float[np.ndarray, " pixels"], truth: Float[np.ndarray, " pixels"]) -> Metrics:
    """Errors of the known pixels of one image, both in metres and > 0.

    Raises:
        InputError: no pixels, different numbers of them, or values that are not finite and positive.
    """
    prediction, truth = prediction.astype(np.float64), truth.astype(np.float64)
    if prediction.shape != truth.shape or prediction.ndim != 1 or not len(truth):
        raise InputError(f"need two equally long lists of pixels; got {prediction.shape} and {truth.shape}")
    for name, values in (("prediction", prediction), ("truth", truth)):
        if not (np.isfinite(values) & (values > 0)).all():
            raise InputError(f"the {name} must be finite and > 0 metres at every pixel that is scored")
    ratio = np.maximum(truth / prediction, prediction / truth)
    return Metrics(
        rel=float(np.mean(np.abs(truth - prediction) / truth)),
        rmse=float(np.sqrt(np.mean((truth - prediction) ** 2))),
        log10=float(np.mean(np.abs(np.log10(truth) - np.log10(prediction)))),
        delta1=float(np.mean(ratio < 1.25)),
        delta2=float(np.mean(ratio < 1.25**2)),
        delta3=float(np.mean(ratio < 1.25**3)),
    )


def mean_metrics(images: list[Metrics]) -> Metrics:
    """Mean over images, as the paper reports them.

    Raises:
        InputError: there are none.
    """
    if not images:
        raise InputError("no image to average: none has a known pixel under this protocol")
    return Metrics(**{f.name: float(np.mean([getattr(image, f.name) for image in images])) for f in fields(Metrics)})
