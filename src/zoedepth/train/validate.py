"""Validation while training: the paper's protocol on pairs held out from the training data."""

from collections.abc import Mapping
from dataclasses import asdict

from zoedepth.data.sample import Samples
from zoedepth.evaluation.evaluate import evaluate
from zoedepth.evaluation.protocols import protocol_of
from zoedepth.metrics import mean_metrics
from zoedepth.model.zoedepth import ZoeDepth


def validate(model: ZoeDepth, validation: Mapping[str, Samples]) -> dict[str, float]:
    """``validation/{data}/{metric}`` of each held-out set, and the share of its images sent to the right head."""
    training = model.training
    model.eval()
    numbers = {}
    for name, subset in validation.items():
        samples = [subset[i] for i in range(len(subset))]
        scores = list(evaluate(model, samples, protocol_of(samples[0].domain)))
        scored = [score.metrics for score in scores if score.metrics is not None]
        if scored:  # sparse depth may have no pixel inside the crop
            means = asdict(mean_metrics(scored))
            numbers |= {f"validation/{name}/{metric}": means[metric] for metric in ("rel", "rmse", "delta1")}
        if len(model.config.domains) > 1:
            right = [score.domain == sample.domain for score, sample in zip(scores, samples, strict=True)]
            numbers[f"validation/{name}/router"] = sum(right) / len(right)
    model.train(training)
    return numbers
