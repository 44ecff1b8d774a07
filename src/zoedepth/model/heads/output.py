"""What a metric head says: depth, the distribution behind it where there is one, and what its own loss needs."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.config.heads import HeadConfig
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads.probability import BinDistribution


class Ordinal(NamedTuple):
    """Of ordinal regression: whether depth lies beyond each interval (DORN)."""

    logits: Float[Tensor, "batch intervals rows columns"]
    """Of the probability that depth is beyond interval k, k = 0 being the nearest."""
    edges: Float[Tensor, "batch edges"]
    """Metres: where the intervals of each image's domain begin and end, one more than there are intervals."""


class WindowBins(NamedTuple):
    """Bins of small windows of the photo, for LocalBins' loss of local histograms."""

    boxes: Float[Tensor, "batch windows 4"]
    """Left, top, right, bottom, as fractions of the network input; smallest windows first, as many of each size."""
    centers: tuple[Float[Tensor, "batch windows _"], ...]
    """Metres: bin centers of each window, from the coarsest level to the finest."""


class Supervision(NamedTuple):
    """What the loss of a head needs beside its depth. A head gives what its own loss needs, and nothing else."""

    ordinal: Ordinal | None = None
    image_bins: Float[Tensor, "batch bins"] | None = None
    """Metres: bin centers of the whole image (AdaBins)."""
    window_bins: WindowBins | None = None


class Answer(NamedTuple):
    """What is asked of a head: a distribution, once computed, is as large as n_bins depth maps, twice."""

    depth: Float[Tensor, "batch 1 rows columns"]
    std: Float[Tensor, "batch 1 rows columns"] | None
    bin_centers: Float[Tensor, "batch bins rows columns"] | None
    probability: Float[Tensor, "batch bins rows columns"] | None
    supervision: Supervision


class HeadOutput(NamedTuple):
    """What a metric head makes of decoder features, at the head's own resolution."""

    prediction: Float[Tensor, "batch 1 rows columns"] | BinDistribution
    """Depth in metres, or a distribution that it is the mean of."""
    supervision: Supervision = Supervision()

    @property
    def distribution(self) -> BinDistribution | None:
        """None where the head has none."""
        return self.prediction if isinstance(self.prediction, BinDistribution) else None

    @property
    def depth(self) -> Float[Tensor, "batch 1 rows columns"]:
        """Metres."""
        return self.prediction.mean() if isinstance(self.prediction, BinDistribution) else self.prediction

    def answer(self, *, std: bool, bins: bool) -> Answer:
        """Depth, and what else is asked for, where the head has it."""
        if not isinstance(self.prediction, BinDistribution):
            return Answer(self.prediction, None, None, None, self.supervision)
        depth, spread = self.prediction.mean_and_std() if std else (self.prediction.mean(), None)
        centers = self.prediction.bin_centers if bins else None
        return Answer(depth, spread, centers, self.prediction.probability if bins else None, self.supervision)


class PassThrough(nn.Module):
    """The shared part of heads that share nothing between domains: they look at the decoder features themselves."""

    def __init__(self, channels: DecoderChannels, config: HeadConfig) -> None:
        super().__init__()

    def forward(self, features: DecoderFeatures) -> DecoderFeatures:
        """The same."""
        return features


def mixed(outputs: list[HeadOutput], weight: Float[Tensor, "batch heads"]) -> HeadOutput:
    """What several heads say of the same images, mixed: the weighted mean of their depths.

    Where the heads have distributions, it is one over the bins of all of them.
    """
    weights = weight.unbind(dim=1)
    parts = [
        output.distribution.mixed(w)
        for w, output in zip(weights, outputs, strict=True)
        if output.distribution is not None
    ]
    if not parts:
        depths = [w[:, None, None, None] * output.depth for w, output in zip(weights, outputs, strict=True)]
        return HeadOutput(torch.stack(depths).sum(dim=0))
    logits, centers = (torch.cat(maps, dim=1) for maps in zip(*((p.maps, p.centers) for p in parts), strict=True))
    return HeadOutput(BinDistribution(logits, None, None, centers))
