"""PixelBins: bin widths and probabilities at every pixel, both from one map (Sarwari et al. 2021, UCB/EECS-2021-32)."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.config import Domain, PixelBinsConfig
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads.output import HeadOutput
from zoedepth.model.heads.probability import BinDistribution
from zoedepth.model.heads.splitter import bin_centers

_EPS = 1e-3
"""Added to the widths before they are normed, so that no bin is empty."""
_EXACT_EPS = 1e-6
"""The original's value for the same (``custom.py``)."""


class PixelBinsHead(nn.Module):
    """Metric depth of one domain, from the finest level."""

    def __init__(self, channels: DecoderChannels, config: PixelBinsConfig, domain: Domain) -> None:
        super().__init__()
        self.project = nn.Conv2d(channels.levels[-1], config.width, kernel_size=3, padding=1)
        self.bins = PixelBins(config.width, config.n_bins, domain, exact=config.exact)

    def forward(self, features: DecoderFeatures) -> HeadOutput:
        """Predict depth in metres at stride 2."""
        return self.bins(F.relu(self.project(features.levels[-1])))


class PixelBins(nn.Module):
    """Predicts depth from a map, by bins of every pixel between the nearest and the farthest depth of the domain.

    Args:
        channels: channels of the map.
        n_bins: number of bins at every pixel.
        domain: the domain whose depths they are.
        exact: see ``PixelBinsConfig``.
    """

    def __init__(self, channels: int, n_bins: int, domain: Domain, *, exact: bool) -> None:
        super().__init__()
        self.domain = domain
        self.exact = exact
        self.widths = nn.Conv2d(channels, n_bins, kernel_size=1)
        self.probability = nn.Conv2d(channels, n_bins, kernel_size=1)

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> HeadOutput:
        """Predict depth in metres at the size of the map."""
        scores = self.widths(x).float()
        widths = F.relu(scores) + _EXACT_EPS if self.exact else F.softplus(scores) + _EPS
        widths = widths / widths.sum(dim=1, keepdim=True)
        centers = bin_centers(widths, self.domain, front_padding=not self.exact)
        distribution = BinDistribution(self.probability(x).float(), None, None, centers)
        return HeadOutput(distribution)
