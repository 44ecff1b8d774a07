"""PixelBins as published (Sarwari et al. 2021; khalilsarwari/depth ``custom.py``)."""

from jaxtyping import Float
from torch import Tensor

from zoedepth.baselines.baseline import Baseline
from zoedepth.baselines.unet import EfficientNetEncoder, UNetDecoder
from zoedepth.config import BaselineConfig, PixelBinsNetworkConfig
from zoedepth.model.heads.output import HeadOutput
from zoedepth.model.heads.pixelbins import PixelBins as PixelBinsLayer

_WIDTH = 128
"""Channels of the map from which widths and probabilities are predicted."""


class PixelBins(Baseline):
    """AdaBins' EfficientNet, a slimmer U-Net, and one convolution that predicts the bins of every pixel."""

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__(config)
        network = config.network
        assert isinstance(network, PixelBinsNetworkConfig)
        self.encoder = EfficientNetEncoder(network.encoder)
        self.decoder = UNetDecoder(self.encoder.channels, features=_WIDTH, slim=True)
        self.bins = PixelBinsLayer(_WIDTH, network.n_bins, self.domain, exact=network.exact)

    def predict(self, x: Float[Tensor, "batch 3 height width"]) -> HeadOutput:
        """Predict the depth of normalised pixels, at half their size."""
        return self.bins(self.decoder(self.encoder(x)).last)
