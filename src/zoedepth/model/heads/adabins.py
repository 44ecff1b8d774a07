"""AdaBins: one set of bins for the whole image, from a small vision transformer (Bhat et al. 2021).

The transformer looks at patches of the finest map. Its first token becomes the widths of the bins; the next ones are
1x1 kernels over the map, whose answers become the probabilities (the original's ``miniViT.py``).
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.config import AdaBinsConfig, Domain
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures, upsample
from zoedepth.model.heads.output import HeadOutput, Supervision
from zoedepth.model.heads.probability import BinDistribution
from zoedepth.model.heads.splitter import bin_centers

N_POSITIONS = 500
"""Rows of the original's table of positions."""
_EPS = 0.1
"""Added to the widths before they are normed, so that no bin is empty (``miniViT.py``)."""
_HIDDEN = 256
"""Hidden channels of the MLP that gives the widths."""


class AdaBinsHead(nn.Module):
    """Metric depth of one domain, from the finest level."""

    def __init__(self, channels: DecoderChannels, config: AdaBinsConfig, domain: Domain) -> None:
        super().__init__()
        self.project = nn.Conv2d(channels.levels[-1], config.width, kernel_size=3, padding=1)
        self.bins = ImageBins(config.width, config, domain)

    def forward(self, features: DecoderFeatures) -> HeadOutput:
        """Depth in metres at stride 2, and the image's bin centers for the loss."""
        return self.bins(self.project(features.levels[-1]))


class ImageBins(nn.Module):
    """A map to depth, by bins of the whole image between the nearest and the farthest depth of the domain."""

    def __init__(self, channels: int, config: AdaBinsConfig, domain: Domain) -> None:
        super().__init__()
        self.domain = domain
        self.n_queries = config.n_queries
        self.tokens = PatchTokens(channels, config)
        self.features = nn.Conv2d(channels, config.width, kernel_size=3, padding=1)
        self.widths = nn.Sequential(
            nn.Linear(config.width, _HIDDEN),
            nn.LeakyReLU(),
            nn.Linear(_HIDDEN, _HIDDEN),
            nn.LeakyReLU(),
            nn.Linear(_HIDDEN, config.n_bins),
        )
        self.probability = nn.Conv2d(config.n_queries, config.n_bins, kernel_size=1)

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> HeadOutput:
        """Depth in metres at the size of the map."""
        tokens = self.tokens(x)
        queries = tokens[:, 1 : self.n_queries + 1]
        attention = torch.einsum("bqc,bchw->bqhw", queries, self.features(x))
        centers = image_centers(self.widths(tokens[:, 0]).float(), self.domain)
        distribution = BinDistribution(self.probability(attention).float(), None, None, centers[:, :, None, None])
        return HeadOutput(distribution, Supervision(image_bins=centers))


def image_centers(scores: Float[Tensor, "batch bins"], domain: Domain) -> Float[Tensor, "batch bins"]:
    """Middles of bins that fill the depth range, metres; widths are in proportion to ReLU(score) + 0.1 (Eqs. 1, 2)."""
    widths = F.relu(scores) + _EPS
    widths = widths / widths.sum(dim=1, keepdim=True)
    return bin_centers(widths[:, :, None, None], domain)[:, :, 0, 0]


class PatchTokens(nn.Module):
    """Patches of a map through a transformer: one token a patch, row by row, and no class token.

    The original fails on maps of more than 500 patches, or of fewer than one for each query and one for the widths.
    Here, the table of positions is stretched linearly over more; where there are fewer, tokens are interpolated
    bilinearly to a finer grid of about the same proportions. In between, it is the original.
    """

    def __init__(self, channels: int, config: AdaBinsConfig) -> None:
        super().__init__()
        self.min_tokens = config.n_queries + 1
        self.embed = nn.Conv2d(channels, config.width, kernel_size=config.patch, stride=config.patch)
        self.positions = nn.Parameter(torch.rand(N_POSITIONS, config.width))
        layer = nn.TransformerEncoderLayer(
            config.width, config.attention_heads, config.feedforward_width, dropout=0.1, batch_first=True
        )
        self.transformer = nn.TransformerEncoder(layer, config.n_layers, enable_nested_tensor=False)

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch tokens embedding"]:
        """Tokens of the map, whose sides are at least those of a patch."""
        grid = self.embed(x)
        grid = upsample(grid, torch.Size(enough(grid.shape[-2], grid.shape[-1], self.min_tokens)))
        tokens = grid.flatten(2).transpose(1, 2)
        return self.transformer(tokens + stretched(self.positions, tokens.shape[1]))


def enough(rows: int, columns: int, n: int) -> tuple[int, int]:
    """Rows and columns of a grid of at least ``n`` cells and about the same proportions; the same if it has them."""
    factor = math.sqrt(max(n / (rows * columns), 1))
    return math.ceil(rows * factor), math.ceil(columns * factor)


def stretched(table: Float[Tensor, "rows channels"], n: int) -> Float[Tensor, "n channels"]:
    """The first ``n`` rows of a table; if it has fewer, all of them, interpolated linearly to ``n``."""
    if n <= len(table):
        return table[:n]
    return F.interpolate(table.T[None], size=n, mode="linear", align_corners=True)[0].T
