"""Score one prediction against the truth: which pixels count, what their errors are, and what else can be measured."""

import itertools
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from zoedepth.alignment import align_least_squares, align_median, resize_depth
from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.evaluation.boundaries import boundary_f1
from zoedepth.evaluation.predictions import Prediction
from zoedepth.evaluation.protocols import Protocol, crop_mask
from zoedepth.evaluation.uncertainty import UncertaintyScores, score_uncertainty
from zoedepth.metrics import Sums, pixel_sums

RANGES = (0.0, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 40.0, 80.0, 1000.0)
"""Edges, in metres, of the ranges of true depth for which errors are reported one by one."""


@dataclass(frozen=True)
class Score:
    """Everything that is measured on one image under a protocol."""

    name: str
    """Name of the photo, as its data set lists it."""
    domain: str
    """Scene type that the data set gives it."""
    routed: str | None
    """Domain of the head that the image was routed to, where there was a choice."""
    sums: Sums | None
    """Errors of all scored pixels; None where no pixel is known under the protocol."""
    ranges: tuple[Sums, ...] = ()
    """Errors of the pixels whose true depth lies between two consecutive ``RANGES``."""
    uncertainty: UncertaintyScores | None = None
    """Scores of the model's own uncertainty, where it has one and its depth is not aligned."""
    boundary_f1: float | None = None
    """Agreement of depth edges, where the truth is dense enough to have any."""
    n_holes: int = 0
    """Scored pixels without a depth in the prediction: it is 0 there, or no number."""

    def to_json(self) -> dict[str, Any]:
        """Return plain values, from which ``from_json`` makes an equal score."""
        values = asdict(self)
        # Files have had this name since the first version; they must still be read, and by it, too.
        return {"calibration" if name == "uncertainty" else name: value for name, value in values.items()}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> "Score":
        """Make a score from what ``to_json`` returned."""
        uncertainty = values["calibration"]
        return cls(
            values["name"],
            values["domain"],
            values["routed"],
            None if values["sums"] is None else Sums(**values["sums"]),
            tuple(Sums(**entry) for entry in values["ranges"]),
            None if uncertainty is None else UncertaintyScores(**uncertainty),
            values["boundary_f1"],
            values.get("n_holes", 0),  # scores of earlier versions do not count them
        )


def score(prediction: Prediction, sample: Sample, protocol: Protocol) -> Score:
    """Measure a prediction at the known pixels of a sample that the protocol scores.

    Args:
        prediction: at any size.
        sample: cropped already; see ``zoedepth.evaluation.predictions.prepare``.
        protocol: which pixels are scored, and how the prediction is aligned first.

    Raises:
        InputError: relative depth under a protocol that does not align the inverse depth.
    """
    scored = scored_pixels(sample, protocol)
    if not scored.any():
        return Score(sample.name, sample.domain, prediction.domain, None)
    truth = sample.target[0].numpy()
    prediction = prediction._replace(depth=resize_depth(prediction.depth, truth.shape))  # once, for all that follows
    depth = aligned_depth(prediction, truth, scored, protocol)
    found, known = depth[scored], truth[scored]
    sums = pixel_sums(found, known)
    ranges = tuple(
        pixel_sums(found[part], known[part])
        for part in ((known >= low) & (known < high) for low, high in itertools.pairwise(RANGES))
    )
    uncertainty = None
    if prediction.std is not None and protocol.alignment == "none":  # an aligned depth is not the one it speaks of
        std = resize_depth(prediction.std, truth.shape)
        uncertainty = score_uncertainty(found, known, std[scored])
    edges = boundary_f1(depth, truth, scored)
    n_holes = int((scored & ~_has_depth(prediction.depth, relative=prediction.relative)).sum())
    return Score(sample.name, sample.domain, prediction.domain, sums, ranges, uncertainty, edges, n_holes)


def _has_depth(depth: Float[np.ndarray, "height width"], *, relative: bool) -> Bool[np.ndarray, "height width"]:
    """Return False where a map has no depth: where it is not finite, or, unless it is relative, not above 0."""
    return np.isfinite(depth) if relative else np.isfinite(depth) & (depth > 0)


def scored_pixels(sample: Sample, protocol: Protocol) -> Bool[np.ndarray, "height width"]:
    """Return True where the truth is known, in the protocol's range, and inside its crop."""
    truth = sample.target[0].numpy()
    known = sample.mask[0].numpy() if protocol.use_mask else np.isfinite(truth)
    return known & (truth > protocol.min_depth) & (truth < protocol.max_depth) & crop_mask(truth.shape, protocol.crop)


def aligned_depth(
    prediction: Prediction,
    truth: Float[np.ndarray, "height width"],
    scored: Bool[np.ndarray, "height width"],
    protocol: Protocol,
) -> Float[np.ndarray, "height width"]:
    """Resize a prediction to the truth, align it if the protocol says so, and clip it to the range; metres.

    Raises:
        InputError: relative depth under a protocol that does not align the inverse depth.
    """
    low, high = max(protocol.min_depth, 1e-6), protocol.max_depth
    depth, truth = resize_depth(prediction.depth, truth.shape).astype(np.float64), truth.astype(np.float64)
    if prediction.relative and protocol.alignment != "disparity":
        raise InputError("relative depth has no metres: score it with --align disparity")
    # As released: NaN counts as the nearest depth, infinity as the farthest. Neither they nor holes, which are 0 in
    # maps of depth, decide on the alignment: one inverse depth of 1e6 would outweigh all others.
    known = scored & _has_depth(depth, relative=prediction.relative)
    if protocol.alignment == "disparity":
        inverse = depth if prediction.relative else 1 / np.maximum(depth, 1e-6)
        inverse = np.nan_to_num(inverse, nan=1 / low, posinf=1 / low, neginf=0.0)
        wanted = 1 / np.maximum(truth, 1e-6)
        # A disparity of 0 or less is infinitely far.
        depth = 1 / np.maximum(align_least_squares(inverse, wanted, known if known.any() else scored), 1 / high)
    if protocol.alignment == "median":  # before that, since its unit may be any
        depth = align_median(depth, truth, known) if known.any() else depth
    return np.nan_to_num(depth, nan=low, posinf=high, neginf=low).clip(low, high)
