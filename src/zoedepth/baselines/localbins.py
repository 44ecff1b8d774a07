"""LocalBins as published (Bhat et al. 2022; ``models/localbins.py``): 74 million parameters."""

from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.baselines.baseline import Baseline
from zoedepth.baselines.unet import EfficientNetEncoder, UNetDecoder
from zoedepth.config import BaselineConfig, LocalBinsNetworkConfig
from zoedepth.model.heads.output import HeadOutput, Supervision
from zoedepth.model.heads.probability import BinDistribution
from zoedepth.model.heads.splitter import (
    BinProjectors,
    BinSplitters,
    bin_centers,
    draw_boxes,
    embed_windows,
    window_bins,
)

_WIDTHS = {"embedding_width": 128, "hidden_width": 128}
"""Channels of the bin embeddings, and hidden channels of the projectors and splitters."""


class LocalBins(Baseline):
    """EfficientNet, U-Net, and bins that are split at every level of the U-Net."""

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__(config)
        network = config.network
        assert isinstance(network, LocalBinsNetworkConfig)
        self.n_windows = network.n_windows
        self.front_padding = network.front_padding
        self.encoder = EfficientNetEncoder(network.encoder)
        self.decoder = UNetDecoder(self.encoder.channels)
        channels = self.decoder.channels
        self.projectors = BinProjectors(channels, **_WIDTHS)
        self.bins = BinSplitters(
            channels.bottleneck, n_seed_bins=network.n_seed_bins, factor=2, seed_width=256, **_WIDTHS
        )
        self.probability = nn.Conv2d(channels.last, self.bins.n_bins, kernel_size=3, padding=1)

    def predict(self, x: Float[Tensor, "batch 3 height width"]) -> HeadOutput:
        """Predict the depth of normalised pixels, at half their size."""
        features = self.decoder(self.encoder(x))
        embeddings = self.projectors(features.bottleneck, features.levels)
        widths = self.bins(features.bottleneck, embeddings)[-1]
        centers = bin_centers(widths, self.domain, front_padding=self.front_padding)
        distribution = BinDistribution(self.probability(features.last).float(), None, None, centers)
        windows = None
        if self.training and self.n_windows:
            boxes = draw_boxes(features.levels[-1], stride=2, n_windows=self.n_windows)
            maps = embed_windows(self.projectors, features.bottleneck, features.levels, boxes)
            windows = window_bins(self.bins, boxes, maps, self.domain, front_padding=self.front_padding)
        return HeadOutput(distribution, Supervision(window_bins=windows))
