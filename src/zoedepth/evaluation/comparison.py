"""Several models side by side, as in the paper's qualitative comparisons: depth, and the squared error of each."""

from collections.abc import Mapping, Sequence

import numpy as np

from zoedepth.alignment import resize_depth
from zoedepth.colors import color_bar, colorize, depth_range, panel, sheet
from zoedepth.data.sample import Sample, Samples
from zoedepth.evaluation.pixels import spread_values
from zoedepth.evaluation.predictions import PredictionSource, predict, prepare
from zoedepth.evaluation.protocols import Protocol
from zoedepth.evaluation.scoring import aligned_depth, scored_pixels
from zoedepth.images import ImageArray, to_image

_WIDTH, _WIDE = 280, 480
"""Width of a panel, pixels: of photos like NYU's, and of those that are more than twice as wide as high."""


def compared(
    sources: Mapping[str, PredictionSource],
    data: Samples,
    indices: Sequence[int],
    protocols: Mapping[str, Protocol],
) -> ImageArray:
    """Draw a row for each photo: photo, truth, the depth of every source, and the squared error of every source.

    All depths of a row share one scale of colours, and so do all squared errors: from dark blue, none, to dark red, the
    98th percentile of the row's. Where nothing is known, or nothing is scored, it is grey. (Paper Fig. 4.)

    Args:
        sources: label → what predicts.
        data: photos with depth.
        indices: numbers of the photos to show, each with a pixel to score.
        protocols: domain → protocol, which crops the photo and the part that is scored.

    Returns:
        uint8 (height, width, 3). Rows of wide photos take two lines: the depths, and below them the squared errors.

    Raises:
        InputError: a photo cannot be read, or a source cannot predict it.
    """
    rows: list[list[ImageArray]] = []
    for index in indices:
        rows += _row(sources, data[index], protocols)
    return sheet(rows)


def _row(
    sources: Mapping[str, PredictionSource], sample: Sample, protocols: Mapping[str, Protocol]
) -> list[list[ImageArray]]:
    protocol = protocols[sample.domain]
    shown = prepare(sample, protocol)
    truth, scored = shown.target[0].numpy(), scored_pixels(shown, protocol)
    depths = {
        label: aligned_depth(predict(source, sample, protocol)[0], truth, scored, protocol)
        for label, source in sources.items()
    }
    wide = truth.shape[1] > 2 * truth.shape[0]
    width = _WIDE if wide else _WIDTH
    size = (max(1, round(truth.shape[0] * width / truth.shape[1])), width)
    known = np.where(shown.mask[0].numpy(), truth, np.nan)
    vmin, vmax = depth_range(truth[scored][None], percentiles=(1.0, 99.0))
    squared = {label: np.where(scored, np.square(depth - truth), np.nan) for label, depth in depths.items()}
    most = max(float(np.percentile([each[scored] for each in squared.values()], 98)), 1e-6)
    bar = color_bar(size[0], vmin=vmin, vmax=vmax)
    error_bar = color_bar(size[0], vmin=0.0, vmax=most, colormap="turbo", unit="m^2")
    photo = panel(to_image(shown.image), size=size, caption=shown.name[-36:])
    measured = panel(colorize(spread_values(known, size), vmin=vmin, vmax=vmax), size=size, caption="measured")
    last = list(sources)[-1]
    predicted = [
        panel(
            colorize(resize_depth(depth, size), vmin=vmin, vmax=vmax),
            size=size,
            bar=bar if label == last else None,
            caption=label[:32],
        )
        for label, depth in depths.items()
    ]
    wrong = [
        panel(
            _colored(spread_values(each, size), most),
            size=size,
            bar=error_bar if label == last else None,
            caption=f"{label[:18]}: squared error",
        )
        for label, each in squared.items()
    ]
    if not wide:
        return [[photo, measured, *predicted, *wrong]]
    blank = panel(np.full((*size, 3), 255, np.uint8), caption=" ")
    return [[photo, measured, *predicted], [blank, blank, *wrong]]


def _colored(squared: np.ndarray, most: float) -> ImageArray:
    # colorize shows values that are not positive as unknown, and an error of 0 is the best there is.
    shifted = np.where(np.isfinite(squared), squared + most, np.nan)
    return colorize(shifted, vmin=most, vmax=2 * most, colormap="turbo")
