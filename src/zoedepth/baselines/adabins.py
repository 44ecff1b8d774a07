"""AdaBins as published (Bhat et al. 2021; ``unet_adaptive_bins.py``): 78 million parameters."""

from jaxtyping import Float
from torch import Tensor

from zoedepth.baselines.baseline import Baseline
from zoedepth.baselines.unet import EfficientNetEncoder, UNetDecoder
from zoedepth.config import AdaBinsNetworkConfig, BaselineConfig
from zoedepth.model.heads.adabins import ImageBins
from zoedepth.model.heads.output import HeadOutput

_WIDTH = 128
"""Channels of the U-Net's last map, and of the transformer's tokens."""


class AdaBins(Baseline):
    """EfficientNet, U-Net, and a small vision transformer that predicts bins of the whole image."""

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__(config)
        network = config.network
        assert isinstance(network, AdaBinsNetworkConfig)
        self.encoder = EfficientNetEncoder(network.encoder)
        self.decoder = UNetDecoder(self.encoder.channels, features=_WIDTH)
        self.bins = ImageBins(
            _WIDTH,
            self.domain,
            n_bins=network.n_bins,
            width=_WIDTH,
            patch=16,
            n_layers=4,
            attention_heads=4,
            feedforward_width=1024,
            n_queries=128,
        )

    def predict(self, x: Float[Tensor, "batch 3 height width"]) -> HeadOutput:
        """Predict the depth of normalised pixels, at half their size."""
        return self.bins(self.decoder(self.encoder(x)).last)
