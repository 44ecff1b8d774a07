"""Validation while training: the paper's protocol on pairs held out from the training data."""

from collections.abc import Mapping
from dataclasses import asdict

from zoedepth.data.sample import Sample, Samples
from zoedepth.evaluation.evaluate import predict
from zoedepth.evaluation.predictions import ModelSource
from zoedepth.evaluation.protocols import protocol_of
from zoedepth.evaluation.scoring import Score, score
from zoedepth.metrics import mean_metrics
from zoedepth.model.zoedepth import ZoeDepth


def validate(model: ZoeDepth, validation: Mapping[str, Samples]) -> dict[str, float]:
    """``validation/{data}/{metric}`` of each held-out set, and the share of its images sent to the right head."""
    training = model.training
    model.eval()
    numbers = {}
    for name, subset in validation.items():
        scores = [_score(model, subset[i]) for i in range(len(subset))]
        scored = [s.sums.metrics() for s in scores if s.sums is not None]
        if scored:  # sparse depth may have no pixel inside the crop
            means = asdict(mean_metrics(scored))
            numbers |= {f"validation/{name}/{metric}": means[metric] for metric in ("rel", "rmse", "delta1")}
        if routed := [s for s in scores if s.routed is not None]:
            numbers[f"validation/{name}/router"] = sum(s.routed == s.domain for s in routed) / len(routed)
    model.train(training)
    return numbers


def _score(model: ZoeDepth, sample: Sample) -> Score:
    protocol = protocol_of(sample.domain)
    prediction, shown = predict(ModelSource(model), sample, protocol)
    return score(prediction, shown, protocol)
