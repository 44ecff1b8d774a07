"""BTS's head: depth from planes at strides 8, 4 and 2, by local planar guidance (Lee et al. 2019).

The decoder of BTS itself, with dense ASPP, is in ``baselines/bts.py`` and uses the planes of this file.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.config import BtsConfig, Domain
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads.output import HeadOutput
from zoedepth.model.upsample import upsample

Planes = Float[Tensor, "batch 4 rows columns"]
"""A plane at every pixel: its unit normal (n1, n2, n3), and its distance as a fraction of the farthest depth."""


def plane_coefficients(x: Float[Tensor, "batch 3 rows columns"]) -> Planes:
    """Make planes of free numbers: tilt up to 60 degrees, any direction, distance up to the farthest depth.

    theta = s(x1) pi / 3, phi = s(x2) 2 pi, n = (sin theta cos phi, sin theta sin phi, cos theta), n4 = s(x3), with s
    the sigmoid (BTS section 3.3; ``bts.py::reduction_1x1``).
    """
    x1, x2, n4 = x.sigmoid().split(1, dim=1)
    theta, phi = x1 * math.pi / 3, x2 * 2 * math.pi
    return torch.cat([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos(), n4], dim=1)


def planar_depth(planes: Planes, *, factor: int) -> Float[Tensor, "batch 1 height width"]:
    """Compute the depths of the ``factor`` x ``factor`` fine pixels under each plane: n4 / (n1 u + n2 v + n3).

    u and v are the column and the row of a fine pixel, from the middle of the plane's cell, whose side is 1. (BTS
    Eq. 1; ``bts.py::local_planar_guidance``. It is singular where a plane of nearly 60 degrees ends at a corner of
    8 x 8.)

    Returns:
        Depth in the unit of n4: fractions of the farthest depth.
    """
    k = factor
    offsets = (torch.arange(k, device=planes.device, dtype=planes.dtype) - (k - 1) / 2) / k
    u, v = offsets, offsets[:, None, None]
    n1, n2, n3, n4 = planes[:, :, :, None, :, None].unbind(dim=1)
    depth = n4 / (n1 * u + n2 * v + n3)  # batch, rows, k, columns, k
    return depth.flatten(3, 4).flatten(1, 2)[:, None]


def narrowing(channels: int, hidden: int, output_channels: int) -> nn.Sequential:
    """Build 1x1 convolutions that halve the channels from ``hidden`` down to 8 or a few more, then give the output.

    There is an ELU between them, and they have no biases (``bts.py::reduction_1x1``).
    """
    layers: list[nn.Module] = []
    while hidden >= 8:
        layers += [nn.Conv2d(channels, hidden, 1, bias=False), nn.ELU()]
        channels, hidden = hidden, hidden // 2
    return nn.Sequential(*layers, nn.Conv2d(channels, output_channels, 1, bias=False))


class PlanarGuidance(nn.Module):
    """Makes a depth map of planes, ``factor`` times as fine as its input."""

    def __init__(self, channels: int, hidden: int, *, factor: int) -> None:
        super().__init__()
        self.planes = narrowing(channels, hidden, 3)
        self.factor = factor

    def forward(self, x: Float[Tensor, "batch channels rows columns"]) -> Float[Tensor, "batch 1 height width"]:
        """Predict depth as a fraction of the farthest, float32."""
        return planar_depth(plane_coefficients(self.planes(x).float()), factor=self.factor)


def convolution(channels: int, output_channels: int) -> nn.Sequential:
    """Build a 3x3 convolution without bias, and an ELU."""
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
        """Predict depth in metres at the size of ``features.last``, up to the farthest of the domain."""
        size = features.last.shape[-2:]
        planes = [
            upsample(guide(level(x)), size)  # the planes are at stride 1, where the last map usually is too
            for guide, level, x in zip(self.guidance, self.levels, features.levels[1:], strict=True)
        ]
        joined = torch.cat([features.last, *planes], dim=1).to(features.last.dtype)
        x = self.depth(self.fuse(joined))
        return HeadOutput(self.domain.max_depth * F.sigmoid(x.float()))
