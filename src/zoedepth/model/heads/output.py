"""The output of a metric head: depth, the distribution behind it where there is one, and what its own loss needs."""

from collections.abc import Iterable
from typing import Any, NamedTuple, Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.config.heads import HeadConfig
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads.probability import BinDistribution


class Ordinal(NamedTuple):
    """Ordinal regression: for each interval of depth, a logit that the depth lies beyond it (DORN)."""

    logits: Float[Tensor, "batch intervals rows columns"]
    """Logits of the probability that depth is beyond interval k; k = 0 is the nearest."""
    edges: Float[Tensor, "batch edges"]
    """Metres: where the intervals of each image's domain begin and end, one more than there are intervals."""


class WindowBins(NamedTuple):
    """Bins of small windows of the photo, for LocalBins' loss of local histograms."""

    boxes: Float[Tensor, "batch windows 4"]
    """Left, top, right, bottom, as fractions of the network input; smallest windows first, as many of each size."""
    centers: tuple[Float[Tensor, "batch windows _"], ...]
    """Metres: bin centers of each window, from the coarsest level to the finest."""


class Supervision(NamedTuple):
    """The inputs of a head's own loss beside its depth. A head gives those that its own loss needs, and no others."""

    ordinal: Ordinal | None = None
    image_bins: Float[Tensor, "batch bins"] | None = None
    """Metres: bin centers of the whole image (AdaBins)."""
    window_bins: WindowBins | None = None

    @classmethod
    def joined(cls, parts: list["Supervision"], order: Int[Tensor, " batch"]) -> "Supervision":
        """Join what heads of one kind say of groups of images; see ``join``."""
        ordinal = [part.ordinal for part in parts if part.ordinal is not None]
        image_bins = [part.image_bins for part in parts if part.image_bins is not None]
        windows = [part.window_bins for part in parts if part.window_bins is not None]
        return cls(
            Ordinal(join((x.logits for x in ordinal), order), join((x.edges for x in ordinal), order))
            if ordinal
            else None,
            join(image_bins, order) if image_bins else None,
            WindowBins(
                join((x.boxes for x in windows), order),
                tuple(join(level, order) for level in zip(*(x.centers for x in windows), strict=True)),
            )
            if windows
            else None,
        )


class HeadOutput(NamedTuple):
    """The output of a metric head, at the head's own resolution."""

    prediction: Float[Tensor, "batch 1 rows columns"] | BinDistribution
    """Depth in metres, or a distribution that it is the mean of."""
    supervision: Supervision = Supervision()

    @property
    def distribution(self) -> BinDistribution | None:
        """The distribution over bins; None where the head has none."""
        return self.prediction if isinstance(self.prediction, BinDistribution) else None

    @property
    def depth(self) -> Float[Tensor, "batch 1 rows columns"]:
        """Metres."""
        return self.prediction.mean() if isinstance(self.prediction, BinDistribution) else self.prediction

    def depth_and_std(
        self,
    ) -> tuple[Float[Tensor, "batch 1 rows columns"], Float[Tensor, "batch 1 rows columns"] | None]:
        """Return the depth and its standard deviation, metres; None for the latter where there is no distribution."""
        if isinstance(self.prediction, BinDistribution):
            return self.prediction.mean_and_std()
        return self.prediction, None


class HeadFeatures(Protocol):
    """The output of a head's shared part, which the heads of all domains look at."""

    @property
    def bottleneck(self) -> Float[Tensor, "batch channels _ _"]:
        """The map at stride 32, which the router looks at too."""
        ...

    @property
    def relative(self) -> Float[Tensor, "batch 1 height width"]:
        """The decoder's relative depth."""
        ...

    def rows(self, rows: Int[Tensor, " rows"]) -> Any:
        """Take some images of the batch."""


class PassThrough(nn.Module):
    """The shared part of heads that share nothing between domains: they look at the decoder features themselves."""

    def __init__(self, channels: DecoderChannels, config: HeadConfig) -> None:
        super().__init__()

    def forward(self, features: DecoderFeatures) -> DecoderFeatures:
        """Return the features as they are."""
        return features


def join(parts: Iterable[Tensor], order: Int[Tensor, " batch"]) -> Tensor:
    """Join tensors of groups of images, and put the images in the given order."""
    return torch.cat(list(parts))[order]


def mixed(outputs: list[HeadOutput], weight: Float[Tensor, "batch heads"]) -> HeadOutput:
    """Mix what several heads say of the same images: the weighted mean of their depths.

    Where the heads have distributions, the mixture has one over the bins of all of them.
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
