"""Bilinear upsampling, as the decoder and the metric heads do it."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def upsample(x: Float[Tensor, "batch channels _ _"], size: torch.Size) -> Float[Tensor, "batch channels height width"]:
    """Resize maps bilinearly with ``align_corners=True``; return them as they are if they have the size already."""
    return x if x.shape[-2:] == size else F.interpolate(x, size=size, mode="bilinear", align_corners=True)


def upsample_rows(
    x: Float[Tensor, "batch channels _ _"], size: torch.Size, rows: slice
) -> Float[Tensor, "batch channels rows width"]:
    """Compute some rows of ``upsample(x, size)`` without computing the others."""
    n_rows, height = x.shape[2], size[0]
    if rows == slice(None):
        return upsample(x, size)
    places = torch.arange(rows.start, rows.stop, device=x.device) * ((n_rows - 1) / max(height - 1, 1))
    above = places.floor().long().clamp(max=n_rows - 1)
    below = (above + 1).clamp(max=n_rows - 1)
    lines = x.permute(0, 2, 3, 1)  # channels last in memory, which indexing along another axis would not keep
    band = torch.lerp(lines[:, above], lines[:, below], (places - above).to(x.dtype)[:, None, None])
    return upsample(band.permute(0, 3, 1, 2), torch.Size([len(places), size[1]]))
