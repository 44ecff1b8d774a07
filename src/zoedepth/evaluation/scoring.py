"""Score one prediction against the truth: which pixels, which errors, and what else there is to say of them."""

import itertools
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float

from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.evaluation.boundaries import boundary_f1
from zoedepth.evaluation.predictions import Prediction
from zoedepth.evaluation.protocols import Protocol, crop_mask
from zoedepth.evaluation.uncertainty import Calibration, calibration
from zoedepth.metrics import Sums, pixel_sums

RANGES = (0.0, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 40.0, 80.0, 1000.0)
"""Edges, metres, of the ranges of true depth that errors are broken down by."""


@dataclass(frozen=True)
class Score:
    """What is known of one image under a protocol."""

    name: str
    """Of the photo, as its data set lists it."""
    domain: str
    """Scene type the data set gives it."""
    routed: str | None
    """Domain of the head the image was routed to, where there was a choice."""
    sums: Sums | None
    """Of all scored pixels; None where no pixel is known under the protocol."""
    ranges: tuple[Sums, ...] = ()
    """The same by true depth, between consecutive ``RANGES``."""
    calibration: Calibration | None = None
    """How the model's own uncertainty goes with its errors, where it has one and its depth is not aligned."""
    boundary_f1: float | None = None
    """Agreement of depth edges, where the truth is dense enough to have any."""

    def to_json(self) -> dict[str, Any]:
        """Plain values, of which ``from_json`` makes the same again."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> "Score":
        """The inverse of ``to_json``."""
        return cls(
            values["name"],
            values["domain"],
            values["routed"],
            None if values["sums"] is None else Sums(**values["sums"]),
            tuple(Sums(**entry) for entry in values["ranges"]),
            None if values["calibration"] is None else Calibration(**values["calibration"]),
            values["boundary_f1"],
        )


def score(prediction: Prediction, sample: Sample, protocol: Protocol) -> Score:
    """Errors of a prediction at the known pixels of a sample that the protocol scores."""
    scored = scored_pixels(sample, protocol)
    if not scored.any():
        return Score(sample.name, sample.domain, prediction.domain, None)
    truth = sample.target[0].numpy()
    depth = aligned_depth(prediction, truth, scored, protocol)
    sums = pixel_sums(depth[scored], truth[scored])
    ranges = tuple(
        pixel_sums(depth[part], truth[part])
        for part in (scored & (truth >= low) & (truth < high) for low, high in itertools.pairwise(RANGES))
    )
    found = None
    if prediction.std is not None and protocol.alignment == "none":
        std = fit(prediction.std, truth.shape)
        found = calibration(depth[scored], truth[scored], std[scored])
    edges = boundary_f1(depth, truth, scored)
    return Score(sample.name, sample.domain, prediction.domain, sums, ranges, found, edges)


def scored_pixels(sample: Sample, protocol: Protocol) -> Bool[np.ndarray, "height width"]:
    """True where the truth is known, in range, and inside the crop."""
    truth = sample.target[0].numpy()
    known = sample.mask[0].numpy() if protocol.use_mask else np.isfinite(truth)
    return known & (truth > protocol.min_depth) & (truth < protocol.max_depth) & crop_mask(truth.shape, protocol.crop)


def aligned_depth(
    prediction: Prediction,
    truth: Float[np.ndarray, "height width"],
    scored: Bool[np.ndarray, "height width"],
    protocol: Protocol,
) -> Float[np.ndarray, "height width"]:
    """The prediction at the truth's size, aligned if the protocol says so, clipped to its range; metres.

    Raises:
        InputError: relative depth under a protocol that does not align the inverse depth.
    """
    low, high = max(protocol.min_depth, 1e-6), protocol.max_depth
    depth, truth = fit(prediction.depth, truth.shape).astype(np.float64), truth.astype(np.float64)
    if prediction.relative and protocol.alignment != "disparity":
        raise InputError("relative depth has no metres: score it with --align disparity")
    # As released: what is not a number counts as nearest, what is infinite as farthest.
    if protocol.alignment == "disparity":
        inverse = depth if prediction.relative else 1 / np.maximum(depth, 1e-6)
        inverse = np.nan_to_num(inverse, nan=1 / low, posinf=1 / low, neginf=0.0)
        # A disparity of 0 or less is infinitely far.
        depth = 1 / np.maximum(least_squares(inverse, 1 / np.maximum(truth, 1e-6), scored), 1 / high)
    depth = np.nan_to_num(depth, nan=low, posinf=high, neginf=low)
    if protocol.alignment == "median":
        depth = depth * (np.median(truth[scored]) / max(float(np.median(depth[scored])), 1e-6))
    return depth.clip(low, high)


def fit(x: Float[np.ndarray, "_ _"], size: tuple[int, ...]) -> Float[np.ndarray, "height width"]:
    """Resized bilinearly, corners aligned, as released; nothing at equal size."""
    if x.shape == size:
        return x
    resized = F.interpolate(torch.from_numpy(x)[None, None].float(), size, mode="bilinear", align_corners=True)
    return resized[0, 0].numpy()


def least_squares(x: np.ndarray, target: np.ndarray, where: np.ndarray) -> np.ndarray:
    """x * scale + shift with the least squared distance to the target at the given pixels."""
    values, wanted = x[where], target[where]
    centred = values - values.mean()
    variance = float(np.mean(centred**2))
    scale = float(np.mean(centred * (wanted - wanted.mean()))) / variance if variance > 0 else 0.0
    return scale * x + float(wanted.mean()) - scale * float(values.mean())
