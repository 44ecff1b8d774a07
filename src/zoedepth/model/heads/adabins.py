"""AdaBins: one set of bins for the whole image, from a small vision transformer (Bhat et al. 2021).

The transformer looks at patches of the finest map. Its first token becomes the widths of the bins. The next ones are
1x1 kernels over the map; their outputs become the probabilities (the original's ``miniViT.py``).
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.config import AdaBinsConfig, Domain
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads.output import HeadOutput, Supervision
from zoedepth.model.heads.probability import BinDistribution
from zoedepth.model.heads.splitter import bin_centers
from zoedepth.model.upsample import upsample

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
        self.bins = ImageBins(
            config.width,
            domain,
            n_bins=config.n_bins,
            width=config.width,
            patch=config.patch,
            n_layers=config.n_layers,
            attention_heads=config.attention_heads,
            feedforward_width=config.feedforward_width,
            n_queries=config.n_queries,
        )

    def forward(self, features: DecoderFeatures) -> HeadOutput:
        """Predict depth in metres at stride 2, and the image's bin centers for the loss."""
        return self.bins(self.project(features.levels[-1]))


class ImageBins(nn.Module):
    """Predicts depth from a map, by bins of the whole image between the nearest and the farthest depth of the domain.

    Args:
        channels: channels of the map.
        domain: the domain whose depths they are.
        n_bins: number of bins of an image.
        width, patch, n_layers, attention_heads, feedforward_width, n_queries: see ``AdaBinsConfig``.
    """

    def __init__(
        self,
        channels: int,
        domain: Domain,
        *,
        n_bins: int,
        width: int,
        patch: int,
        n_layers: int,
        attention_heads: int,
        feedforward_width: int,
        n_queries: int,
    ) -> None:
        super().__init__()
        self.domain = domain
        self.n_queries = n_queries
        self.tokens = PatchTokens(
            channels,
            width=width,
            patch=patch,
            n_layers=n_layers,
            attention_heads=attention_heads,
            feedforward_width=feedforward_width,
            min_tokens=n_queries + 1,
        )
        self.features = nn.Conv2d(channels, width, kernel_size=3, padding=1)
        self.widths = nn.Sequential(
            nn.Linear(width, _HIDDEN),
            nn.LeakyReLU(),
            nn.Linear(_HIDDEN, _HIDDEN),
            nn.LeakyReLU(),
            nn.Linear(_HIDDEN, n_bins),
        )
        self.probability = nn.Conv2d(n_queries, n_bins, kernel_size=1)

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> HeadOutput:
        """Predict depth in metres at the size of the map."""
        tokens = self.tokens(x)
        queries = tokens[:, 1 : self.n_queries + 1]
        attention = torch.einsum("bqc,bchw->bqhw", queries, self.features(x))
        centers = image_centers(self.widths(tokens[:, 0]).float(), self.domain)
        distribution = BinDistribution(self.probability(attention).float(), None, None, centers[:, :, None, None])
        return HeadOutput(distribution, Supervision(image_bins=centers))


def image_centers(scores: Float[Tensor, "batch bins"], domain: Domain) -> Float[Tensor, "batch bins"]:
    """Compute the middles of bins that fill the depth range, metres.

    The widths of the bins are in proportion to ReLU(score) + 0.1 (AdaBins Eqs. 1, 2).
    """
    widths = F.relu(scores) + _EPS
    widths = widths / widths.sum(dim=1, keepdim=True)
    return bin_centers(widths[:, :, None, None], domain)[:, :, 0, 0]


class PatchTokens(nn.Module):
    """Sends the patches of a map through a transformer: a token for each patch, row by row, and no class token.

    The original fails on maps of more than 500 patches, and of fewer than ``min_tokens``. Here, the table of positions
    is stretched linearly over more than 500; where there are too few patches, tokens are interpolated bilinearly to a
    finer grid of about the same proportions. In between, it computes what the original computes.

    Args:
        channels: channels of the map.
        width, patch, n_layers, attention_heads, feedforward_width: see ``AdaBinsConfig``.
        min_tokens: number of tokens needed: one for the widths of the bins, and one for each query.
    """

    def __init__(
        self,
        channels: int,
        *,
        width: int,
        patch: int,
        n_layers: int,
        attention_heads: int,
        feedforward_width: int,
        min_tokens: int,
    ) -> None:
        super().__init__()
        self.min_tokens = min_tokens
        self.embed = nn.Conv2d(channels, width, kernel_size=patch, stride=patch)
        self.positions = nn.Parameter(torch.rand(N_POSITIONS, width))
        layer = nn.TransformerEncoderLayer(width, attention_heads, feedforward_width, dropout=0.1, batch_first=True)
        self.transformer = nn.TransformerEncoder(layer, n_layers, enable_nested_tensor=False)

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch tokens embedding"]:
        """Return the tokens of the map, whose sides must be at least those of a patch."""
        grid = self.embed(x)
        grid = upsample(grid, torch.Size(enough(grid.shape[-2], grid.shape[-1], self.min_tokens)))
        tokens = grid.flatten(2).transpose(1, 2)
        return self.transformer(tokens + stretched(self.positions, tokens.shape[1]))


def enough(rows: int, columns: int, n: int) -> tuple[int, int]:
    """Return rows and columns of a grid with at least ``n`` cells and about the proportions of the given one."""
    factor = math.sqrt(max(n / (rows * columns), 1))
    return math.ceil(rows * factor), math.ceil(columns * factor)


def stretched(table: Float[Tensor, "rows channels"], n: int) -> Float[Tensor, "n channels"]:
    """Return the first ``n`` rows of a table; if it has fewer, interpolate all of them linearly to ``n``."""
    if n <= len(table):
        return table[:n]
    return F.interpolate(table.T[None], size=n, mode="linear", align_corners=True)[0].T
