"""Photos and maps resized as torch does, up to rounding, in NumPy and Pillow: what ``pixels`` does for tensors.

An exported model runs without torch, whose import takes longer than everything else that a photo needs.
"""

from typing import Literal

import numpy as np
from jaxtyping import Float32, Shaped, UInt8
from PIL import Image

Mode = Literal["bicubic", "bilinear"]


def to_pixels(
    image: UInt8[np.ndarray, "_ _ 3"], size: tuple[int, int], *, antialias: bool
) -> Float32[np.ndarray, "3 height width"]:
    """Resize a photo to what a network takes, in [0, 1]; see ``pixels.resize_pixels``."""
    if antialias:
        height, width = size
        channels = [
            np.asarray(Image.fromarray(channel).convert("F").resize((width, height), Image.Resampling.BILINEAR))
            for channel in np.moveaxis(image, 2, 0)
        ]
        return (np.stack(channels) / np.float32(255)).clip(0, 1)
    resized = resize(image.astype(np.float32), size, "bilinear")
    return np.ascontiguousarray(np.moveaxis(resized, 2, 0)) / np.float32(255)


def resize(
    x: Float32[np.ndarray, "_ _ *channels"], size: tuple[int, int], mode: Mode
) -> Float32[np.ndarray, "height width *channels"]:
    """Resize as ``torch.nn.functional.interpolate`` does: "bicubic", or "bilinear" with corners aligned.

    Nothing is smoothed where sides become smaller.
    """
    axes = (0, 1) if size[0] < x.shape[0] else (1, 0)  # what makes less of it first
    for axis in axes:
        x = _along(x, axis, size[axis], mode)
    return x


def reflect_pad(
    x: Shaped[np.ndarray, "_ _ channels"], vertical: int, horizontal: int
) -> Shaped[np.ndarray, "height width channels"]:
    """Mirror the borders outwards, see ``pixels.reflect_pad``."""
    if vertical == horizontal == 0:
        return x
    return np.pad(x, ((vertical, vertical), (horizontal, horizontal), (0, 0)), mode="reflect")


def _along(x: np.ndarray, axis: int, new: int, mode: Mode) -> np.ndarray:
    """Resize one axis: each new place is the weighted sum of two or four old ones."""
    old, news = x.shape[axis], np.arange(new, dtype=np.float32)  # rounded as torch rounds
    if mode == "bicubic":
        place = (news + np.float32(0.5)) * (np.float32(old) / np.float32(new)) - np.float32(0.5)
        near = np.floor(place)
        offsets = (-1, 0, 1, 2)
        weights = [_cubic(np.abs(place - near - offset)) for offset in offsets]
    else:
        place = news * (np.float32(old - 1) / np.float32(max(new - 1, 1)))
        near = np.floor(place)
        offsets = (0, 1)
        weights = [1 - (place - near), place - near]
    along = [1] * x.ndim
    along[axis] = new
    total: np.ndarray | None = None
    for offset, weight in zip(offsets, weights, strict=True):
        # The edge repeats itself beyond the edge.
        part = x.take((near + offset).astype(int).clip(0, old - 1), axis=axis)
        part *= weight.reshape(along)
        total = part if total is None else np.add(total, part, out=total)
    assert total is not None
    return total


def _cubic(distance: np.ndarray) -> np.ndarray:
    """Return the weights of places within a distance of two: Keys' cubic convolution, A = -0.75, as torch has it."""
    inside = (1.25 * distance - 2.25) * distance**2 + 1
    outside = ((-0.75 * distance + 3.75) * distance - 6) * distance + 3
    return np.where(distance <= 1, inside, outside)
