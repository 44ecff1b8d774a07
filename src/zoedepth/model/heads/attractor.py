"""The metric bins module: seed bins at the bottleneck, pulled by attractors on the way up (paper section 3.2).

It has two parts. ``BinEmbedding`` turns decoder features into bin embeddings and is shared by the domains;
``AttractorHead`` turns embeddings into depth, and each domain has one (released ``zoedepth_nk_v1.py``).
"""

import math
from functools import reduce as reduce_by
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.config import AttractorConfig, Domain
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads.output import HeadOutput
from zoedepth.model.heads.probability import build_probability
from zoedepth.model.upsample import upsample

_EPS = 1e-3
"""Added to normed widths and attractors, so that no bin is empty (released ``attractor.py``)."""


class BinEmbeddings(NamedTuple):
    """The output of ``BinEmbedding``, and the input of every attractor head."""

    bottleneck: Float[Tensor, "batch channels _ _"]
    """Stride 32: the decoder bottleneck after one convolution; the router sees it too."""
    seed: Float[Tensor, "batch embedding _ _"]
    """Bin embedding at stride 32."""
    levels: tuple[Float[Tensor, "batch embedding _ _"], ...]
    """Bin embeddings at strides 16, 8, 4, 2."""
    last: Float[Tensor, "batch features height width"]
    relative: Float[Tensor, "batch 1 height width"]

    def rows(self, rows: Int[Tensor, " rows"]) -> "BinEmbeddings":
        """Take some images of the batch."""
        levels = tuple(level[rows] for level in self.levels)
        return BinEmbeddings(self.bottleneck[rows], self.seed[rows], levels, self.last[rows], self.relative[rows])


def inverse_attractor(distance: Tensor, *, alpha: float, gamma: float) -> Tensor:
    """Compute Eq. 2 for one attractor, given d = a_k - c_i: d / (1 + alpha |d| ** gamma)."""
    if gamma == 2:  # the value of every model of the paper: one pass over memory less
        return distance / torch.addcmul(distance.new_ones(()), distance, distance, value=alpha)
    return distance / (1 + alpha * _power(distance, gamma))


def exponential_attractor(distance: Tensor, *, alpha: float, gamma: float) -> Tensor:
    """Compute Eq. 3 for one attractor, given d = a_k - c_i: d exp(-alpha |d| ** gamma)."""
    return distance * torch.exp(-alpha * _power(distance, gamma))


def _power(distance: Tensor, gamma: float) -> Tensor:
    # gamma is 2 in every model of the paper. Then the absolute value would be two passes over memory for nothing.
    return distance.square() if gamma == 2 else distance.abs() ** gamma


ATTRACTORS = {"inverse": inverse_attractor, "exponential": exponential_attractor}


def attract(
    bin_centers: Float[Tensor, "batch bins height width"],
    attractors: Float[Tensor, "batch attractors height width"],
    *,
    kind: str,
    reduce: str,
    alpha: float,
    gamma: float,
) -> Float[Tensor, "batch bins height width"]:
    """Move every bin center toward the attractors of its pixel: c' = c + sum or mean of the pulls (Eqs. 2, 3)."""
    # One attractor at a time: all at once would need n_attractors times the memory.
    pulls = (
        ATTRACTORS[kind](attractor - bin_centers, alpha=alpha, gamma=gamma) for attractor in attractors.split(1, dim=1)
    )
    pull = reduce_by(torch.add, pulls)
    return bin_centers + (pull / attractors.shape[1] if reduce == "mean" else pull)


def normed_centers(
    widths: Float[Tensor, "batch bins height width"],
) -> Float[Tensor, "batch bins height width"]:
    """Return the middles of consecutive bins, as fractions of their total width: increasing, in (0, 1).

    Args:
        widths: widths of the bins, positive, in any unit.
    """
    widths = widths / widths.sum(dim=1, keepdim=True)
    return widths.cumsum(dim=1) - widths / 2


class BinEmbedding(nn.Module):
    """Makes bin embeddings of decoder features: a two-layer 1x1 MLP for each level (``Projector``), for all domains."""

    def __init__(self, channels: DecoderChannels, config: AttractorConfig) -> None:
        super().__init__()
        width, hidden = config.embedding_width, config.projector_width
        self.bottleneck = nn.Conv2d(channels.bottleneck, channels.bottleneck, kernel_size=1)
        self.seed = _mlp(channels.bottleneck, hidden, width)
        self.levels = nn.ModuleList(_mlp(level, hidden, width) for level in channels.levels)

    def forward(self, features: DecoderFeatures) -> BinEmbeddings:
        """Embed every level; pass the last map and the relative depth through."""
        bottleneck = self.bottleneck(features.bottleneck)
        levels = tuple(project(x) for project, x in zip(self.levels, features.levels, strict=True))
        return BinEmbeddings(bottleneck, self.seed(bottleneck), levels, features.last, features.relative)


class AttractorLayer(nn.Module):
    """Predicts the attractor points of each pixel from its bin embedding.

    The points are metres (softplus) or, for normed centers, fractions of the depth range.
    """

    def __init__(self, channels: int, n_attractors: int, *, normed: bool, ratio: bool) -> None:
        super().__init__()
        self.mlp = _mlp(channels, channels, 2 * n_attractors if normed else n_attractors)
        self.normed = normed
        self.ratio = ratio

    def forward(
        self, x: Float[Tensor, "batch channels height width"]
    ) -> Float[Tensor, "batch attractors height width"]:
        """Attractor points, float32."""
        points = self.mlp(x).float()
        if not self.normed:
            return F.softplus(points)
        points = F.relu(points) + _EPS
        first, second = points[:, 0::2], points[:, 1::2]  # side by side, as released
        return first / (first + second) if self.ratio else first


class AttractorHead(nn.Module):
    """Metric depth of one domain: all bin centers at the bottleneck, then four attractor layers (paper Fig. 3)."""

    def __init__(self, channels: DecoderChannels, config: AttractorConfig, domain: Domain) -> None:
        super().__init__()
        self.config = config
        self.domain = domain
        normed = config.centers == "normed"
        self.seed = _mlp(channels.bottleneck, config.seed_width, config.n_bins)
        self.attractors = nn.ModuleList(
            AttractorLayer(config.embedding_width, n, normed=normed, ratio=config.attractor_ratio)
            for n in config.n_attractors
        )
        probability_channels = channels.last + int(config.relative_input) + config.embedding_width
        self.probability = build_probability(
            config.probability,
            probability_channels,
            config.n_bins,
            bottleneck_factor=config.bottleneck_factor,
            min_temperature=config.min_temperature,
            max_temperature=config.max_temperature,
        )
        if config.initial_centers == "geometric":
            self._spread_centers()

    def forward(self, embeddings: BinEmbeddings) -> HeadOutput:
        """Predict depth in metres at the size of ``embeddings.last``."""
        centers = self.centers(self.points(embeddings), self.domain.min_depth, self.domain.max_depth)
        return self.output(embeddings, centers)

    def points(self, embeddings: BinEmbeddings) -> list[Tensor]:
        """Predict the points that the bin centers are made of.

        Returns:
            The seeds before their activation, (batch, bins, rows, columns) at the bottleneck; then the attractors of
            each level, (batch, attractors, rows, columns).
        """
        points, previous = [self.seed(embeddings.bottleneck).float()], embeddings.seed
        for layer, embedding in zip(self.attractors, embeddings.levels, strict=True):
            # As in the released code, the next level gets this level's embedding, not the sum.
            points.append(layer(embedding + upsample(previous, embedding.shape[-2:])))
            previous = embedding
        return points

    def centers(self, points: list[Tensor], low: Any, high: Any) -> Float[Tensor, "batch bins height width"]:
        """Compute the bin centers, metres, at the size of the last attractors.

        Args:
            points: the result of ``points``.
            low, high: bounds of the centers, where they have some, metres: numbers, or tensors (batch, 1, 1, 1).
        """
        config, (seeds, *attractors) = self.config, points
        centers = normed_centers(F.relu(seeds) + _EPS) if config.centers == "normed" else F.softplus(seeds)
        for level in attractors:
            centers = attract(
                upsample(centers, level.shape[-2:]), level,
                kind=config.kind, reduce=config.reduce, alpha=config.alpha, gamma=config.gamma,
            )  # fmt: skip
        if config.centers == "normed":  # fractions of the range so far
            return (low + (high - low) * centers).sort(dim=1).values.clamp(low, high)
        # The mean of the pulls leaves a center among the points, which are positive. Their sum may push it below zero.
        return centers.clamp(min=low) if config.reduce == "sum" else centers

    def output(self, embeddings: BinEmbeddings, centers: Float[Tensor, "batch bins height width"]) -> HeadOutput:
        """Predict the distribution over bins at these centers."""
        inputs = [embeddings.last, embeddings.relative] if self.config.relative_input else [embeddings.last]
        return HeadOutput(self.probability([*inputs, embeddings.levels[-1]], centers))

    def _spread_centers(self) -> None:
        """Spread the first seed centers and attractors geometrically over the depth range, from 5 % of it on."""
        low, high = max(self.domain.min_depth, 0.05 * self.domain.max_depth), self.domain.max_depth
        for mlp in [self.seed, *(layer.mlp for layer in self.attractors)]:
            last = mlp[-1]
            metres = torch.logspace(math.log10(low), math.log10(high), last.out_channels, dtype=torch.float64)
            with torch.no_grad():
                last.bias.copy_(metres + torch.log(-torch.expm1(-metres)))  # the inverse of softplus


def _mlp(channels: int, hidden: int, output_channels: int) -> nn.Sequential:
    """Build an MLP for every pixel: two 1x1 convolutions with a ReLU between them."""
    return nn.Sequential(nn.Conv2d(channels, hidden, 1), nn.ReLU(), nn.Conv2d(hidden, output_channels, 1))
