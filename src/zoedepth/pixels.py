"""Photos as tensors of the size that a network takes: resized, and padded by their own mirror image."""

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int, Shaped
from torch import Tensor


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
