"""Pictures of training: photos, their known depth, and the depth that the model predicts."""

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
    """Draw a row for each sample: the photo, its known depth (grey: unknown), and the predicted depth.

    Both depths of a row share one scale of colours, in metres. Stage 1 shows disparity; its prediction gets the scale
    and shift of the truth by least squares.
    """
    training = model.training
    model.eval()
    try:
        predictor = Predictor(model, flip_average=False)
        return sheet([_prediction_row(predictor, sample, stage) for sample in samples])
    finally:
        model.train(training)


def data_sheet(samples: Sequence[Sample]) -> ImageArray:
    """Draw a row for each sample: the photo, and its known depth (grey: unknown)."""
    return sheet(
        [_row(sample, *_truth(sample, as_disparity=False), None, metres=sample.kind == "depth") for sample in samples]
    )


def _prediction_row(predictor: Predictor, sample: Sample, stage: Literal["relative", "metric"]) -> list[ImageArray]:
    photo = to_image(sample.image)
    truth, known = _truth(sample, as_disparity=stage == "relative")
    if stage == "relative":
        said = resize_depth(predictor.relative(photo), truth.shape)
        said = align_least_squares(said, truth, known) if known.any() else said
    else:
        names = [domain.name for domain in predictor.model.config.domains]
        domain = sample.domain if sample.domain in names and len(names) > 1 else None
        said = resize_depth(predictor(photo, domain=domain).depth, truth.shape)
    return _row(sample, truth, known, said, metres=stage == "metric")


def _truth(sample: Sample, *, as_disparity: bool) -> tuple[DepthArray, Bool[np.ndarray, "height width"]]:
    """Return the target at the width of a panel, and a mask of its known pixels."""
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
    said: DepthArray | None,
    *,
    metres: bool,
) -> list[ImageArray]:
    photo = F.interpolate(sample.image[None], truth.shape, mode="bilinear", antialias=True)[0].clamp(0, 1)
    name = sample.name if len(sample.name) <= 40 else "…" + sample.name[-39:]
    panels = [panel(to_image(photo), caption=f"{name} {sample.domain}")]
    if not known.any():
        return [*panels, panel(colorize(np.full_like(truth, np.nan), vmin=0.0, vmax=1.0), caption="nothing known")]
    vmin, vmax = depth_range(truth[known][None], percentiles=(1.0, 99.0))
    colormap, what = ("magma_r", "depth") if metres else ("magma", "disparity")
    bar = color_bar(truth.shape[0], vmin=vmin, vmax=vmax) if metres else None
    shown = colorize(np.where(known, truth, np.nan), vmin=vmin, vmax=vmax, colormap=colormap)
    panels.append(panel(shown, bar=bar, caption=f"{what}, known at {known.mean():.0%}"))
    if said is not None:
        panels.append(
            panel(colorize(said, vmin=vmin, vmax=vmax, colormap=colormap), bar=bar, caption=f"predicted {what}")
        )
    return panels
