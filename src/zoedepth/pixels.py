"""Photos as tensors of the size that a network takes: resized, and padded by their own mirror image."""

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from zoedepth.errors import InputError

_MAX_OVERSHOOT = 0.5  # beyond [0, 1]: resizing leads to less, pixels that are normalised or in 0..255 have more


def check_pixels(pixels: Tensor) -> None:
    """Check that a tensor holds photos, as their pixels are.

    Raises:
        InputError: it is not float (batch, 3, height, width), it is empty, or its values are not in [0, 1].
    """
    if pixels.ndim != 4 or pixels.shape[1] != 3 or not pixels.is_floating_point() or 0 in pixels.shape:
        shape = tuple(pixels.shape)
        raise InputError(f"pixels must be float (batch, 3, height, width) in [0, 1]; got {pixels.dtype} {shape}")
    low, high = (float(value) for value in pixels.detach().aminmax())
    if not (low > -_MAX_OVERSHOOT and high < 1 + _MAX_OVERSHOOT):  # also when one of them is not a number
        raise InputError(
            f"pixels are in [{low:.4g}, {high:.4g}] and must be RGB in [0, 1]: divide 8 bits by 255, and leave out "
            "ImageNet's mean and deviation, which the model applies itself"
        )


def resize_pixels(
    pixels: Float[Tensor, "batch 3 _ _"], size: tuple[int, int], *, antialias: bool
) -> Float[Tensor, "batch 3 height width"]:
    """Resize to what the network takes: bilinear with corners aligned, as released, or with a filter."""
    if antialias:
        return F.interpolate(pixels, size, mode="bilinear", align_corners=False, antialias=True).clamp(0, 1)
    return F.interpolate(pixels, size, mode="bilinear", align_corners=True)


def reflect_pad(x: Shaped[Tensor, "batch channels _ _"], vertical: int, horizontal: int) -> Shaped[Tensor, "..."]:
    """Mirror the borders outwards without repeating the edge itself, as often as a tiny picture needs it."""
    if vertical == horizontal == 0:
        return x
    rows = _reflected(x.shape[2], vertical, x.device)
    columns = _reflected(x.shape[3], horizontal, x.device)
    return x.index_select(2, rows).index_select(3, columns)


def _reflected(side: int, padding: int, device: torch.device) -> Int[Tensor, " padded"]:
    """Return the pixel that each place of a padded side shows: 2 1 0 1 2 3 2 1 for a side of 4 padded by 2."""
    places = torch.arange(-padding, side + padding, device=device)
    period = max(2 * (side - 1), 1)
    places = places.remainder(period)
    return torch.minimum(places, period - places) if side > 1 else torch.zeros_like(places)
