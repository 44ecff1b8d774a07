"""AdaBins as published (Bhat et al. 2021; ``unet_adaptive_bins.py``): 78 million parameters."""

from jaxtyping import Float
from torch import Tensor

from zoedepth.baselines.baseline import Baseline
from zoedepth.baselines.unet import EfficientNetEncoder, UNetDecoder
from zoedepth.config import AdaBinsConfig, AdaBinsNetworkConfig, BaselineConfig
from zoedepth.model.heads.adabins import ImageBins
from zoedepth.model.heads.output import HeadOutput


class AdaBins(Baseline):
    """EfficientNet, U-Net, and the bins of the whole image by a small vision transformer."""

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__(config)
        network = config.network
        assert isinstance(network, AdaBinsNetworkConfig)
        bins = AdaBinsConfig(n_bins=network.n_bins)
        self.encoder = EfficientNetEncoder(network.encoder)
        self.decoder = UNetDecoder(self.encoder.channels, features=bins.width)
        self.bins = ImageBins(bins.width, bins, self.domain)

    def predict(self, x: Float[Tensor, "batch 3 height width"]) -> HeadOutput:
        """Depth of normalised pixels, at half their size."""
        return self.bins(self.decoder(self.encoder(x)).last)
