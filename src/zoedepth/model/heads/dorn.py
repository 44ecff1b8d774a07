"""DORN's head: depth as an interval, by ordinal regression (Fu et al. 2018). Its loss is ``losses.ordinal``.

``baselines/dorn.py`` shares the intervals, their decoding and the scene module.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.config import Domain, DornConfig
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads.output import HeadOutput, Ordinal, Supervision
from zoedepth.model.upsample import upsample

_RATES = (1, 2, 3)
"""Dilations of the scene module at stride 32, where DORN has 4, 8, 12 at stride 8."""


def interval_edges(min_depth: float, max_depth: float, n_intervals: int, *, spacing: str) -> tuple[float, ...]:
    """Compute where the intervals between two depths begin and end, metres: one more than there are intervals.

    increasing: t_k = exp(k / K ln(max + xi)) - xi with xi = 1 - min, so that they begin at 1 before the shift back
    (SID, DORN Eq. 1). uniform: t_k = min + (max - min) k / K (UD, DORN Eq. 1).
    """
    fractions = [k / n_intervals for k in range(1, n_intervals)]
    if spacing == "uniform":
        between = [min_depth + (max_depth - min_depth) * fraction for fraction in fractions]
    else:
        xi = 1 - min_depth
        between = [(max_depth + xi) ** fraction - xi for fraction in fractions]
    return (min_depth, *between, max_depth)


def ordinal_depth(
    logits: Float[Tensor, "batch intervals rows columns"], edges: Float[Tensor, " edges"], *, decode: str
) -> Float[Tensor, "batch 1 rows columns"]:
    """Decode ordinal logits to depth, metres; logit k says that depth is beyond interval k.

    hard: the middle of interval l, where l counts the probabilities P_k that are at least 0.5 (DORN Eq. 5). It has no
    gradient. soft: m_0 + sum_k P_k (m_{k+1} - m_k), where m_k are the middles: the mean of the middle, which equals
    hard where every P_k is 0 or 1.
    """
    middles = (edges[:-1] + edges[1:]) / 2
    if decode == "hard":
        # There is no interval beyond the last one.
        label = (logits >= 0).sum(dim=1, keepdim=True).clamp(max=len(middles) - 1)
        return middles[label]
    probability = logits[:, :-1].float().sigmoid()
    return middles[0] + (probability * middles.diff()[:, None, None]).sum(dim=1, keepdim=True)


def ordinal_output(
    logits: Float[Tensor, "batch intervals rows columns"], edges: tuple[float, ...], *, decode: str
) -> HeadOutput:
    """Make a head's output of float32 logits: depth, and the inputs of the ordinal loss."""
    thresholds = logits.new_tensor(edges)
    supervision = Supervision(ordinal=Ordinal(logits, thresholds.expand(logits.shape[0], -1)))
    return HeadOutput(ordinal_depth(logits, thresholds, decode=decode), supervision=supervision)


class SceneModule(nn.Module):
    """The full image, a 1x1 and three dilated convolutions, side by side (DORN section 3.1, Fig. 3).

    Args:
        channels: channels of the input.
        width: channels of each branch; the output has four times as many.
        rates: dilations of the three convolutions.
        full_image: module from the input to (batch, width, 1, 1).
    """

    def __init__(self, channels: int, *, width: int, rates: tuple[int, int, int], full_image: nn.Module) -> None:
        super().__init__()
        self.full_image = full_image
        self.branches = nn.ModuleList([
            nn.Conv2d(channels, width, 1),
            *(nn.Conv2d(channels, width, 3, padding=rate, dilation=rate) for rate in rates),
        ])  # fmt: skip
        self.projects = nn.ModuleList(nn.Conv2d(width, width, 1) for _ in range(5))
        self.mix = nn.Conv2d(5 * width, 4 * width, 1)
        self.dropout = nn.Dropout(0.5)

    def forward(self, x: Float[Tensor, "batch channels rows columns"]) -> Float[Tensor, "batch output rows columns"]:
        """Compute features of the scene, >= 0, at the size of the input."""
        branches = [self.full_image(x), *(branch(x) for branch in self.branches)]
        maps = [F.relu(project(F.relu(branch))) for project, branch in zip(self.projects, branches, strict=True)]
        maps[0] = maps[0].expand(-1, -1, *x.shape[-2:])
        return self.dropout(F.relu(self.mix(self.dropout(torch.cat(maps, dim=1)))))


class DornHead(nn.Module):
    """Ordinal logits of one domain, from the finest decoder level, or from the bottleneck through a scene module."""

    def __init__(self, channels: DecoderChannels, config: DornConfig, domain: Domain) -> None:
        super().__init__()
        self.config = config
        self.edges = interval_edges(domain.min_depth, domain.max_depth, config.n_intervals, spacing=config.spacing)
        width = config.width
        if config.scene:
            # DORN's full-image branch has a weight for every place of a photo of fixed size. This one takes any size.
            full_image = nn.Sequential(
                nn.AdaptiveAvgPool2d(1), nn.Dropout(0.5), nn.Conv2d(channels.bottleneck, width, 1)
            )
            self.hidden = SceneModule(channels.bottleneck, width=width, rates=_RATES, full_image=full_image)
        else:
            self.hidden = nn.Sequential(nn.Conv2d(channels.levels[-1], width, 3, padding=1), nn.ReLU())
        self.logits = nn.Conv2d(4 * width if config.scene else width, config.n_intervals, 1)

    def forward(self, features: DecoderFeatures) -> HeadOutput:
        """Predict depth in metres at stride 2."""
        finest = features.levels[-1]
        logits = self.logits(self.hidden(features.bottleneck if self.config.scene else finest)).float()
        return ordinal_output(upsample(logits, finest.shape[-2:]), self.edges, decode=self.config.decode)
