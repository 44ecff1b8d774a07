"""Score a model on a data set under a protocol."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from zoedepth.data.augment import kitti_crop
from zoedepth.data.sample import Sample
from zoedepth.evaluation.protocols import Protocol, crop_mask
from zoedepth.metrics import Metrics, compute_metrics
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor


@dataclass(frozen=True)
class Score:
    """One image's result."""

    name: str
    domain: str
    """Domain of the head the image was routed to."""
    metrics: Metrics | None
    """None where no pixel is known under the protocol."""


def evaluate(model: ZoeDepth, samples: Iterable[Sample], protocol: Protocol) -> Iterator[Score]:
    """Score a model image by image; ``metrics.mean_metrics`` of the results is what papers print.

    As in the original's ``evaluate.py`` the photos are not padded, and depth is resized bilinearly.
    """
    predictor = Predictor(model, flip_average=protocol.flip_average, pad=False, upsampling="bilinear")
    for sample in samples:
        if protocol.kitti_crop:
            sample = kitti_crop()(sample, np.random.default_rng())
        result = predictor(sample.image)
        yield Score(sample.name, result.domain, score(result.depth, sample, protocol))


def score(depth: Float[np.ndarray, "height width"], sample: Sample, protocol: Protocol) -> Metrics | None:
    """Errors of a prediction (metres) at the known pixels of a sample that the protocol scores; None without any."""
    truth = sample.target[0].numpy()
    low, high = protocol.min_depth, protocol.max_depth
    scored = sample.mask[0].numpy() & (truth > low) & (truth < high) & crop_mask(truth.shape, protocol.crop)
    if not scored.any():
        return None
    # As released: what is not a number counts as nearest, what is infinite as farthest.
    prediction = np.clip(np.nan_to_num(depth[scored], nan=low, posinf=high, neginf=low), low, high)
    return compute_metrics(prediction, truth[scored])
