"""BTS's head: depth from planes at strides 8, 4 and 2, by local planar guidance (Lee et al. 2019).

The decoder of BTS itself, with dense ASPP, is in ``baselines/bts.py``; what both share is here.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.config import BtsConfig, Domain
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures, upsample
from zoedepth.model.heads.output import HeadOutput

Planes = Float[Tensor, "batch 4 rows columns"]
"""A plane at every pixel: its unit normal (n1, n2, n3), and its distance as a fraction of the farthest depth."""


def plane_coefficients(x: Float[Tensor, "batch 3 rows columns"]) -> Planes:
    """Planes of free numbers: tilt up to 60 degrees, any direction, distance up to the farthest depth.

    theta = s(x1) pi / 3, phi = s(x2) 2 pi, n = (sin theta cos phi, sin theta sin phi, cos theta), n4 = s(x3), with s
    the sigmoid (BTS section 3.3; ``bts.py::reduction_1x1``).
    """
    x1, x2, n4 = x.sigmoid().split(1, dim=1)
    theta, phi = x1 * math.pi / 3, x2 * 2 * math.pi
    return torch.cat([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos(), n4], dim=1)


def planar_depth(planes: Planes, *, factor: int) -> Float[Tensor, "batch 1 height width"]:
    """Each plane as the depths of the ``factor`` x ``factor`` fine pixels under it: n4 / (n1 u + n2 v + n3).

    u and v are the columns and rows of a fine pixel from the middle of the plane's cell, whose side is 1. (BTS Eq. 1;
    ``bts.py::local_planar_guidance``. It is singular where a plane of nearly 60 degrees ends at a corner of 8 x 8.)

    Returns:
        Fractions of the farthest depth, for distances that are.
    """
    k = factor
    offsets = (torch.arange(k, device=planes.device, dtype=planes.dtype) - (k - 1) / 2) / k
    u, v = offsets, offsets[:, None, None]
    n1, n2, n3, n4 = planes[:, :, :, None, :, None].unbind(dim=1)
    depth = n4 / (n1 * u + n2 * v + n3)  # batch, rows, k, columns, k
    return depth.flatten(3, 4).flatten(1, 2)[:, None]


def narrowing(channels: int, hidden: int, output_channels: int) -> nn.Sequential:
    """1x1 convolutions to ``hidden`` channels and on to ever half as many, down to 8 or a few more, then to the output.

    ELU between them, no biases (``bts.py::reduction_1x1``).
    """
    layers: list[nn.Module] = []
    while hidden >= 8:
        layers += [nn.Conv2d(channels, hidden, 1, bias=False), nn.ELU()]
        channels, hidden = hidden, hidden // 2
    return nn.Sequential(*layers, nn.Conv2d(channels, output_channels, 1, bias=False))


class PlanarGuidance(nn.Module):
    """A coarse map as a depth map ``factor`` times as fine, made of planes."""

    def __init__(self, channels: int, hidden: int, *, factor: int) -> None:
        super().__init__()
        self.planes = narrowing(channels, hidden, 3)
        self.factor = factor

    def forward(self, x: Float[Tensor, "batch channels rows columns"]) -> Float[Tensor, "batch 1 height width"]:
        """Depth as a fraction of the farthest, float32."""
        return planar_depth(plane_coefficients(self.planes(x).float()), factor=self.factor)


def convolution(channels: int, output_channels: int) -> nn.Sequential:
    """3x3, no bias, ELU."""
    return nn.Sequential(nn.Conv2d(channels, output_channels, 3, padding=1, bias=False), nn.ELU())


class BtsHead(nn.Module):
    """Metric depth of one domain: planes of three levels and the last map, weighed by two convolutions."""

    def __init__(self, channels: DecoderChannels, config: BtsConfig, domain: Domain) -> None:
        super().__init__()
        self.domain = domain
        levels = channels.levels[1:]
        self.levels = nn.ModuleList(convolution(c, w) for c, w in zip(levels, config.widths, strict=True))
        self.guidance = nn.ModuleList(
            PlanarGuidance(w, w, factor=factor) for w, factor in zip(config.widths, (8, 4, 2), strict=True)
        )
        self.fuse = convolution(channels.last + 3, config.width)
        self.depth = nn.Conv2d(config.width, 1, 3, padding=1, bias=False)

    def forward(self, features: DecoderFeatures) -> HeadOutput:
        """Depth in metres at the size of ``features.last``, up to the farthest of the domain."""
        size = features.last.shape[-2:]
        planes = [
            upsample(guide(level(x)), size)  # from stride 1: nothing to do where the last map is there too
            for guide, level, x in zip(self.guidance, self.levels, features.levels[1:], strict=True)
        ]
        x = self.depth(self.fuse(torch.cat([features.last, *planes], dim=1)))
        return HeadOutput(self.domain.max_depth * F.sigmoid(x.float()))
