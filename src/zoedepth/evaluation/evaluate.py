"""Score a model on a data set under a protocol."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from zoedepth.data.augment import kitti_crop
from zoedepth.data.sample import Sample
from zoedepth.evaluation.protocols import Protocol, crop_mask
from zoedepth.metrics import Metrics, compute_metrics
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.sizes import network_size


@dataclass(frozen=True)
class Score:
    """One image's result."""

    name: str
    domain: str
    """Domain of the head the image was routed to."""
    metrics: Metrics | None
    """None where no pixel is known under the protocol."""


def evaluate(model: ZoeDepth, samples: Iterable[Sample], protocol: Protocol) -> Iterator[Score]:
    """Score a model image by image; ``metrics.mean_metrics`` of the results is what papers print."""
    for sample in samples:
        if protocol.kitti_crop:
            sample = kitti_crop()(sample, np.random.default_rng())
        depth, domain = predict_depth(model, sample.image, flip_average=protocol.flip_average)
        yield Score(sample.name, model.config.domains[domain].name, score(depth, sample, protocol))


@torch.inference_mode()
def predict_depth(
    model: ZoeDepth, image: Float[Tensor, "3 height width"], *, flip_average: bool
) -> tuple[Float[np.ndarray, "height width"], int]:
    """Depth in metres at the photo's size, and the index of its domain, as the original's ``evaluate.py`` makes them.

    Unlike ``Predictor``: no padding, the mirrored prediction is averaged at network resolution, and depth is resized
    bilinearly (align_corners=True).
    """
    config = model.config
    size = network_size(
        tuple(image.shape[-2:]), config.size, multiple=config.multiple, keep_aspect_ratio=config.keep_aspect_ratio
    )
    pixels = image[None].to(model.device)
    if config.antialias:
        pixels = F.interpolate(pixels, size, mode="bilinear", antialias=True, align_corners=False).clamp(0, 1)
    else:
        pixels = F.interpolate(pixels, size, mode="bilinear", align_corners=True)
    output = model(pixels)
    depth = output.depth
    if flip_average:
        # The photo's own head for its mirror image too: a mean over two heads is no depth of either.
        mirrored = model(pixels.flip(-1), domain=output.domain).depth.flip(-1)
        depth = (depth + mirrored) / 2
    depth = F.interpolate(depth, image.shape[-2:], mode="bilinear", align_corners=True)
    return depth[0, 0].float().cpu().numpy(), int(output.domain[0])


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
