"""Validation while training: the paper's protocol on pairs held out from the training data."""

from collections.abc import Mapping
from dataclasses import asdict

from zoedepth.data.sample import Samples
from zoedepth.evaluation.evaluate import evaluate
from zoedepth.evaluation.predictions import ModelSource
from zoedepth.evaluation.protocols import protocol_of
from zoedepth.metrics import mean_metrics
from zoedepth.model.zoedepth import ZoeDepth


def validate(model: ZoeDepth, validation: Mapping[str, Samples]) -> dict[str, float]:
    """``validation/{data}/{metric}`` of each held-out set, and the share of its images sent to the right head."""
    training = model.training
    model.eval()
    numbers = {}
    for name, subset in validation.items():
        domains = {subset[i].domain for i in range(len(subset))}
        scores = evaluate(ModelSource(model), subset, {domain: protocol_of(domain) for domain in domains}).scores
        scored = [score.sums.metrics() for score in scores if score.sums is not None]
        if scored:  # sparse depth may have no pixel inside the crop
            means = asdict(mean_metrics(scored))
            numbers |= {f"validation/{name}/{metric}": means[metric] for metric in ("rel", "rmse", "delta1")}
        if routed := [score for score in scores if score.routed is not None]:
            numbers[f"validation/{name}/router"] = sum(s.routed == s.domain for s in routed) / len(routed)
    model.train(training)
    return numbers
