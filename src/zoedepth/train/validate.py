"""Validate while training, on pairs held out from the training data."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from statistics import fmean
from typing import Literal

import numpy as np

from zoedepth.alignment import align_least_squares, resize_depth
from zoedepth.data.augment import to_disparity
from zoedepth.data.sample import Sample, Samples
from zoedepth.evaluation.predictions import ModelSource, predict
from zoedepth.evaluation.protocols import protocol_of
from zoedepth.evaluation.scoring import Score, score
from zoedepth.metrics import mean_metrics
from zoedepth.model.interface import DepthModel
from zoedepth.predict import Predictor
from zoedepth.train.tolerant import readable


def validate(
    model: DepthModel, validation: Mapping[str, Samples], *, stage: Literal["relative", "metric"]
) -> dict[str, float]:
    """Measure the model on each held-out data set.

    Args:
        model: the model; it is left in the mode (training or evaluation) that it was in.
        validation: name of a data set → its held-out samples.
        stage: "metric" measures REL, RMSE and delta1 under the paper's protocol, and the share of images sent to the
            right head ("router"). A model in a canonical camera is told the camera of each photo, where it is known.
            "relative" measures the RMSE of the disparity ("disparity_rmse"): the prediction gets its scale and shift by
            least squares, and the true disparity of each image is scaled to [0, 1], as MiDaS v3.1 compares its
            trainings.

    Returns:
        ``validation/{name}/{metric}`` → value. Metrics without any pixel to measure are left out.
    """
    training = model.training
    model.eval()
    numbers = {}
    for name, subset in validation.items():
        samples = readable(subset)
        found = _relative(model, samples) if stage == "relative" else _metric(model, samples)
        numbers |= {f"validation/{name}/{metric}": value for metric, value in found.items()}
    model.train(training)
    return numbers


def _metric(model: DepthModel, samples: Iterator[Sample]) -> dict[str, float]:
    scores = [_score(model, sample) for sample in samples]
    scored = [s.sums.metrics() for s in scores if s.sums is not None]
    numbers = {}
    if scored:  # sparse depth may have no pixel inside the crop
        means = asdict(mean_metrics(scored))
        numbers = {metric: means[metric] for metric in ("rel", "rmse", "delta1")}
    if routed := [s for s in scores if s.routed is not None]:
        numbers["router"] = sum(s.routed == s.domain for s in routed) / len(routed)
    return numbers


def _score(model: DepthModel, sample: Sample) -> Score:
    protocol = protocol_of(sample.domain)
    known = model.config.canonical_camera and sample.camera is not None
    prediction, shown = predict(ModelSource(model, camera="data" if known else "none"), sample, protocol)
    return score(prediction, shown, protocol)


def _relative(model: DepthModel, samples: Iterator[Sample]) -> dict[str, float]:
    errors = []
    predictor = Predictor(model, pad=False, upsampling="bilinear")
    for sample in samples:
        if sample.mask.any():
            truth = to_disparity()(sample, np.random.default_rng())  # draws nothing
            known = truth.mask[0].numpy()
            target = truth.target[0].numpy().astype(np.float64)
            said = resize_depth(predictor.relative(sample.image), target.shape).astype(np.float64)
            errors.append(float(np.sqrt(np.mean((align_least_squares(said, target, known) - target)[known] ** 2))))
    return {"disparity_rmse": fmean(errors)} if errors else {}
