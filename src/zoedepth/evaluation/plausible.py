"""Doubt depth maps in files before they are scored: is it depth or its inverse, and how many steps are a metre?"""

import numpy as np
from jaxtyping import Float

from zoedepth.alignment import resize_depth
from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.evaluation.predictions import FolderSource, predict
from zoedepth.evaluation.protocols import Protocol
from zoedepth.evaluation.scoring import scored_pixels

SCALES = (1000.0, 256.0, 100.0, 5000.0, 4000.0, 512.0, 200.0, 1.0)
"""Stored values of one metre that are in use: millimetres, KITTI, centimetres, TUM, ICL-NUIM, and others."""

MAX_RATIO = 20.0
"""Medians of prediction and truth that differ by this factor are in different units."""

_OPPOSITE = -0.5  # correlation of ranks, below which near and far are exchanged


def check_predictions(source: FolderSource, sample: Sample, protocol: Protocol) -> str | None:
    """Compare a depth map with the truth of its photo, to tell whether it can be what it is taken for.

    What the user said of the folder, its kind or scale, is not refused.

    Args:
        source: the folder.
        sample: a photo of the data, not cropped yet.
        protocol: how it is to be scored.

    Returns:
        A sentence where the depth is in another unit than the user said; None where nothing is wrong or can be told.

    Raises:
        InputError: the map is inverse depth, is in another unit than metres, or nobody says its scale; or it is
            relative and is not aligned. The message proposes the option.
    """
    if source.kind == "disparity" and protocol.alignment != "disparity":
        raise InputError(f"{source.folder} has relative depth, which has no metres: score it with --align disparity")
    try:  # as numbers without a unit
        bare = FolderSource(source.folder, scale=1.0, kind="disparity")
        prediction, shown = predict(bare, sample, protocol)
        unit = None if source.kind == "disparity" else source.unit(sample.name)
    except InputError:
        return None  # this image will fail, and say why
    truth = shown.target[0].numpy()
    known = scored_pixels(shown, protocol)
    values = resize_depth(prediction.depth, truth.shape)
    known &= np.isfinite(values) & (values > 0)
    if not known.any():
        return None
    values, truth, file = values[known], truth[known], prediction.file
    if source.kind is None and _rank_correlation(values, truth) < _OPPOSITE:
        raise InputError(
            f"{file} is large where {sample.name} is near: it is inverse depth. Add --predictions-kind disparity. If "
            "it is depth after all, add --predictions-kind depth"
        )
    if source.kind == "disparity" or protocol.alignment != "none":
        return None
    median = float(np.median(truth))
    ratio = float(np.median(values)) / median
    nearest = min(SCALES, key=lambda scale: abs(np.log(ratio / scale)))
    fits = max(ratio / nearest, nearest / ratio) < 1.4
    if unit is None:
        advice = f"{nearest:g} fits" if fits else "give that of one metre"
        raise InputError(
            f"{file} does not say how many of its steps are one metre. They are {ratio:.3g} times the true depth of "
            f"{sample.name}: add --predictions-scale, {advice}"
        )
    if 1 / MAX_RATIO < ratio / unit < MAX_RATIO:
        return None
    odd = f"{file}: the median depth is {_metres(ratio / unit * median)}, and the true one {_metres(median)}"
    if source.scale is not None:
        return odd
    advice = f"{nearest:g} fits" if fits else f"{unit:g} if it is right as it is"
    raise InputError(f"{odd}. Add --predictions-scale, the stored value of one metre: {advice}")


def _metres(value: float) -> str:
    return f"{value:,.0f} m" if value >= 100 else f"{value:.3g} m"


def _rank_correlation(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> float:
    """Return Spearman's correlation, of some thousand pixels; 0 where one of them is the same everywhere."""
    x, y = (values[:: max(1, len(values) // 4096)] for values in (x, y))
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return 0.0
    ranks = [np.searchsorted(np.sort(values), values).astype(np.float64) for values in (x, y)]
    first, second = (rank - rank.mean() for rank in ranks)
    return float(first @ second / np.sqrt((first @ first) * (second @ second)))
