"""Bring a prediction to the truth before the two are compared: to its size, its median, or its scale and shift."""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float


def resize_depth(depth: Float[np.ndarray, "_ _"], size: tuple[int, ...]) -> Float[np.ndarray, "height width"]:
    """Resize a map of depth, disparity or uncertainty bilinearly with aligned corners, as the released evaluation does.

    Args:
        depth: any unit.
        size: (height, width) of the truth.

    Returns:
        float32; the very same array where the size is right already.
    """
    if depth.shape == size:
        return depth
    resized = F.interpolate(torch.from_numpy(depth)[None, None].float(), size, mode="bilinear", align_corners=True)
    return resized[0, 0].numpy()


def align_median(
    x: Float[np.ndarray, "*shape"], target: Float[np.ndarray, "*shape"], where: Bool[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*shape"]:
    """Multiply by the factor that makes the medians equal over the pixels that are True in ``where``."""
    return x * (np.median(target[where]) / max(float(np.median(x[where])), 1e-6))


def align_least_squares(
    x: Float[np.ndarray, "*shape"], target: Float[np.ndarray, "*shape"], where: Bool[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*shape"]:
    """Return ``x * scale + shift`` with the least squared distance to the target over the pixels of ``where``.

    This is how relative depth gets a scale and a shift: both arrays are then inverse depth. The scale is 0 where ``x``
    is the same at all those pixels.
    """
    values, wanted = x[where], target[where]
    centred = values - values.mean()
    variance = float(np.mean(centred**2))
    scale = float(np.mean(centred * (wanted - wanted.mean()))) / variance if variance > 0 else 0.0
    return scale * x + float(wanted.mean()) - scale * float(values.mean())
