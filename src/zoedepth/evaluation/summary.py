"""Summarise the scores of one source on one data set."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from statistics import fmean
from typing import Any

from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import Protocol
from zoedepth.evaluation.scoring import RANGES, Score
from zoedepth.metrics import Metrics, add_sums, mean_metrics, pooled_metrics


@dataclass(frozen=True)
class Summary:
    """The numbers that are reported for one source on one data set."""

    source: str
    """Label of the source of predictions."""
    data: str
    """Name of the data set."""
    protocols: dict[str, str]
    """Domain → name#hash of its protocol."""
    n_images: int
    """Images that were read and predicted, with or without a known pixel."""
    n_scored: int
    """Images with a known pixel under the protocol; the others are counted, and are in no mean."""
    n_failed: int
    """Images that could not be read or predicted."""
    metrics: Metrics | None
    """Means of the kind that the protocol asks for; None where nothing could be scored."""
    other_mean: Metrics | None
    """Means of the other kind."""
    mean: str
    """"images" or "pixels": the protocol's kind of mean."""
    domains: dict[str, Metrics]
    """Domain of the data → metrics, where there are several domains."""
    ranges: dict[str, dict[str, float]]
    """"1-2" (metres of true depth) → share of the scored pixels, and metrics over these pixels."""
    router: float | None
    """Share of images that were routed to the head of their own domain, where there is a choice."""
    uncertainty: dict[str, float]
    """Means over images of the fields of ``UncertaintyScores``; empty where the source has no uncertainty."""
    boundary_f1: float | None
    """Mean over the images whose truth is dense enough; None where there are none."""
    alignment: str
    """"none", or how the prediction was aligned with the truth first."""
    holes: float = 0.0
    """Share of the scored pixels for which the prediction has no depth. They are scored as the nearest depth there is
    (infinity: as the farthest)."""
    camera: str = "none"
    """"none", or "data" where the model was told the camera that the data set says."""
    fast: str = ""
    """Library and numbers that computed, where what is fastest here was chosen: "OpenVINO, bfloat16". Else empty."""

    def to_json(self) -> dict[str, Any]:
        """Return plain values; ``uncertainty`` is called "calibration" there, as in the first version."""
        return {"calibration" if name == "uncertainty" else name: value for name, value in asdict(self).items()}


def summarise(
    source: str,
    data: str,
    scores: Sequence[Score],
    protocols: Mapping[str, Protocol],
    *,
    n_failed: int = 0,
    camera: str = "none",
    fast: str = "",
) -> Summary:
    """Average the scores of one source on one data set. The order of the scores does not matter.

    Args:
        source: label of the source of predictions.
        data: name of the data set.
        scores: one for each image that did not fail.
        protocols: domain → protocol.
        n_failed: number of images that failed.
        camera: the knowledge of the cameras that the source was given, "none" or "data".
        fast: see ``Summary``.

    Raises:
        InputError: the domains' protocols average or align in different ways.
    """
    means = {protocol.mean for protocol in protocols.values()}
    alignments = {protocol.alignment for protocol in protocols.values()}
    if len(means) > 1 or len(alignments) > 1:
        raise InputError(
            f"the protocols of {data} must average and align in one way; "
            f"they have mean {sorted(means)} and alignment {sorted(alignments)}"
        )
    mean, alignment = means.pop(), alignments.pop()
    scored = [score for score in scores if score.sums is not None]
    images, pixels = _means(scored)
    domains = sorted({score.domain for score in scored})
    routed = [score for score in scores if score.routed is not None]
    edges = [score.boundary_f1 for score in scored if score.boundary_f1 is not None]
    return Summary(
        source=source,
        data=data,
        protocols={domain: protocol.label for domain, protocol in sorted(protocols.items())},
        n_images=len(scores),
        n_scored=len(scored),
        n_failed=n_failed,
        metrics=images if mean == "images" else pixels,
        other_mean=pixels if mean == "images" else images,
        mean=mean,
        domains={
            domain: found
            for domain in domains
            if (found := _means([s for s in scored if s.domain == domain])[mean == "pixels"]) and len(domains) > 1
        },
        ranges=_ranges(scored),
        router=sum(score.routed == score.domain for score in routed) / len(routed) if routed else None,
        uncertainty=_uncertainty(scored),
        boundary_f1=fmean(edges) if edges else None,
        alignment=alignment,
        holes=_holes(scored),
        camera=camera,
        fast=fast,
    )


def _means(scored: Sequence[Score]) -> tuple[Metrics | None, Metrics | None]:
    """Return the mean over images, and the metrics over all pixels."""
    sums = [score.sums for score in scored if score.sums is not None]
    if not sums:
        return None, None
    return mean_metrics([one.metrics() for one in sums]), pooled_metrics(sums)


def _holes(scored: Sequence[Score]) -> float:
    n_pixels = sum(score.sums.n_pixels for score in scored if score.sums is not None)
    return sum(score.n_holes for score in scored) / n_pixels if n_pixels else 0.0


def _uncertainty(scored: Sequence[Score]) -> dict[str, float]:
    found = [score.uncertainty for score in scored if score.uncertainty is not None]
    return {f.name: fmean(getattr(one, f.name) for one in found) for f in fields(found[0])} if found else {}


def _ranges(scored: Sequence[Score]) -> dict[str, dict[str, float]]:
    total = sum(score.sums.n_pixels for score in scored if score.sums is not None)
    found = {}
    for i, (low, high) in enumerate(pairwise(RANGES)):
        sums = add_sums([score.ranges[i] for score in scored if score.ranges])
        if sums.n_pixels:
            found[f"{low:g}-{high:g}"] = {"share": sums.n_pixels / total, **asdict(sums.metrics())}
    return found
