"""Upsampling: bilinear, as the decoder and the metric heads do it, and convex, which keeps edges sharp."""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


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


class ConvexWeights(nn.Module):
    """Predict the weights of ``convex_upsample`` (Teed & Deng 2020; not in the paper).

    They are predicted from the last decoder map and the four pixels of the photo at each of its places. A new one
    upsamples bilinearly.

    Args:
        features: channels of the last decoder map.
        width: hidden channels.
    """

    def __init__(self, features: int, *, width: int = 16) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(features + 3 * 2**2, width, kernel_size=3, padding=1)
        self.conv2 = nn.Conv2d(width, 9 * 2**2, kernel_size=1)
        line = torch.tensor([[0.25, 0.75, 0.0], [0.0, 0.75, 0.25]])
        bilinear = torch.einsum("yi,xj->ijyx", line, line).clamp(min=1e-3)
        bias: Any = self.conv2.bias
        with torch.no_grad():
            self.conv2.weight.zero_()
            bias.copy_(bilinear.log().flatten())

    def forward(
        self, last: Float[Tensor, "batch features rows columns"], pixels: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 9 4 rows columns"]:
        """Predict for each pixel the weights, > 0, of the nine values around its place in a map of half the size.

        Args:
            last: the last decoder map, at stride 2.
            pixels: the photo as the encoder sees it, in [-1, 1].
        """
        seen = torch.cat([last, F.pixel_unshuffle(pixels.to(last.dtype), 2)], dim=1)
        return self.conv2(F.relu(self.conv1(seen))).float().unflatten(1, (9, 4)).softmax(dim=1)


def convex_upsample(
    x: Float[Tensor, "batch 1 rows columns"], weights: Float[Tensor, "batch 9 4 rows columns"]
) -> Float[Tensor, "batch 1 height width"]:
    """Double the size of a map. Each new pixel is a weighted mean of the nine values around it.

    No value comes out that does not lie between its neighbours, and edges can be sharp.

    Args:
        x: the map.
        weights: the weights of the nine values, row by row, for each of the four new pixels; they sum to 1.
    """
    rows, columns = x.shape[-2:]
    padded = F.pad(x.float(), (1, 1, 1, 1), mode="replicate")
    around = [padded[:, :, i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
    return F.pixel_shuffle((weights * torch.stack(around, dim=1)).sum(dim=1), 2)
