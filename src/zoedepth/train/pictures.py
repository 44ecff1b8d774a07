"""Pictures of a training: the photos, their known depth, and the depth that the model predicts."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch.nn.functional as F
from jaxtyping import Bool

from zoedepth.alignment import align_least_squares, resize_depth
from zoedepth.colors import color_bar, colorize, depth_range, panel, sheet
from zoedepth.data.sample import Sample
from zoedepth.images import DepthArray, ImageArray, to_image
from zoedepth.model.interface import DepthModel
from zoedepth.predict import Predictor

_WIDTH = 320


def predictions_sheet(
    model: DepthModel, samples: Sequence[Sample], *, stage: Literal["relative", "metric"]
) -> ImageArray:
    """Draw a row for each sample: the photo, its known depth (grey where unknown), and the predicted depth.

    Both depths of a row share one scale of colours. "metric" shows metres. "relative" shows disparity: the prediction
    is first given the scale and shift that bring it closest to the known disparity, by least squares.

    Args:
        model: the model to show. Afterwards it is in training or evaluation mode as before.
        samples: the photos, with their known depth or disparity.
        stage: the stage of training.

    Returns:
        The picture: uint8 (height, width, 3).
    """
    training = model.training
    model.eval()
    try:
        predictor = Predictor(model, flip_average=False)
        return sheet([_prediction_row(predictor, sample, stage) for sample in samples])
    finally:
        model.train(training)


def data_sheet(samples: Sequence[Sample]) -> ImageArray:
    """Draw a row for each sample: the photo, and its known depth or disparity (grey where unknown)."""
    return sheet(
        [_row(sample, *_truth(sample, as_disparity=False), None, metres=sample.kind == "depth") for sample in samples]
    )


def _prediction_row(predictor: Predictor, sample: Sample, stage: Literal["relative", "metric"]) -> list[ImageArray]:
    photo = to_image(sample.image)
    truth, known = _truth(sample, as_disparity=stage == "relative")
    if stage == "relative":
        predicted = resize_depth(predictor.relative(photo), truth.shape)
        predicted = align_least_squares(predicted, truth, known) if known.any() else predicted
    else:
        names = [domain.name for domain in predictor.model.config.domains]
        domain = sample.domain if sample.domain in names and len(names) > 1 else None
        # Samples that are augmented already have no camera, and the depth of the canonical one.
        told = predictor.model.config.canonical_camera and sample.camera is not None
        camera = sample.camera if told else "none"
        predicted = resize_depth(predictor(photo, domain=domain, camera=camera).depth, truth.shape)
    return _row(sample, truth, known, predicted, metres=stage == "metric")


def _truth(sample: Sample, *, as_disparity: bool) -> tuple[DepthArray, Bool[np.ndarray, "height width"]]:
    """Return the target at the width of a panel, and a mask that is True where it is known.

    ``as_disparity`` turns metres into disparity, 1 / depth.
    """
    scale = _WIDTH / sample.image.shape[2]
    size = (max(1, round(sample.image.shape[1] * scale)), max(1, round(sample.image.shape[2] * scale)))
    truth, known = (
        F.interpolate(x[None].float(), size, mode="nearest-exact")[0, 0].numpy() for x in (sample.target, sample.mask)
    )
    known = known > 0.5
    if as_disparity and sample.kind == "depth":
        truth = np.where(known, 1 / np.maximum(truth, 1e-3), 0).astype(np.float32)
    return truth, known


def _row(
    sample: Sample,
    truth: DepthArray,
    known: Bool[np.ndarray, "height width"],
    predicted: DepthArray | None,
    *,
    metres: bool,
) -> list[ImageArray]:
    photo = F.interpolate(sample.image[None], truth.shape, mode="bilinear", antialias=True)[0].clamp(0, 1)
    name = sample.name if len(sample.name) <= 40 else "…" + sample.name[-39:]
    panels = [panel(to_image(photo), caption=f"{name} {sample.domain}")]
    colormap, what = ("magma_r", "depth") if metres else ("magma", "disparity")
    if not known.any():
        grey = colorize(np.full_like(truth, np.nan), vmin=0.0, vmax=1.0)
        return [*panels, panel(grey, caption=f"no known {what}")]
    vmin, vmax = depth_range(truth[known][None], percentiles=(1.0, 99.0))
    bar = color_bar(truth.shape[0], vmin=vmin, vmax=vmax) if metres else None
    shown = colorize(np.where(known, truth, np.nan), vmin=vmin, vmax=vmax, colormap=colormap)
    panels.append(panel(shown, bar=bar, caption=f"{what}, known at {known.mean():.0%}"))
    if predicted is not None:
        panels.append(
            panel(colorize(predicted, vmin=vmin, vmax=vmax, colormap=colormap), bar=bar, caption=f"predicted {what}")
        )
    return panels
