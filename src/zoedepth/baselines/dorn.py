"""DORN as its authors built it: dilated ResNet, scene module, ordinal regression (Fu et al. 2018).

Written from the paper and the released networks, ``models/NYUV2/deploy.prototxt`` and ``models/KITTI/deploy.prototxt``.
"""

import math

from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.baselines.baseline import Baseline
from zoedepth.config import BaselineConfig, DornNetworkConfig
from zoedepth.model.heads.dorn import SceneModule, interval_edges, ordinal_output
from zoedepth.model.heads.output import HeadOutput
from zoedepth.model.timm_encoder import FeatureEncoder
from zoedepth.model.upsample import upsample

WIDTH = 512
"""Channels of each branch of the scene module."""
STRIDE = 8
"""Stride of the encoder's map, pixels."""


class Dorn(Baseline):
    """Predicts ordinal logits at stride 8, upsamples them, then decodes. It takes photos of ``config.size`` only."""

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__(config)
        network = config.network
        assert isinstance(network, DornNetworkConfig)
        self.decode = network.decode
        self.edges = interval_edges(
            self.domain.min_depth, self.domain.max_depth, network.n_intervals, spacing="increasing"
        )
        self.encoder = FeatureEncoder(network.encoder, levels=(4,), options={"output_stride": STRIDE})
        _dilate_first_blocks(self.encoder.stages)
        channels = self.encoder.channels[0]
        rows, columns = (math.ceil(math.ceil(side / STRIDE) / network.pooling) for side in config.size)
        full_image = nn.Sequential(
            nn.AvgPool2d(network.pooling, ceil_mode=True),  # Caffe rounds up
            nn.Dropout(0.5),
            nn.Flatten(),
            nn.Linear(channels * rows * columns, WIDTH),
            nn.Unflatten(1, (WIDTH, 1, 1)),
        )
        self.decoder = nn.Sequential(
            SceneModule(channels, width=WIDTH, rates=network.rates, full_image=full_image),
            nn.Conv2d(4 * WIDTH, network.n_intervals, 1),
        )
        for layer in self.decoder.modules():
            if isinstance(layer, nn.Conv2d | nn.Linear):
                nn.init.kaiming_uniform_(layer.weight, nonlinearity="linear")  # Caffe's "xavier"
                if layer.bias is not None:
                    nn.init.zeros_(layer.bias)

    def predict(self, x: Float[Tensor, "batch 3 height width"]) -> HeadOutput:
        """Predict the depth of normalised pixels, at their resolution."""
        logits = self.decoder(self.encoder(x)[0]).float()
        return ordinal_output(upsample(logits, x.shape[-2:]), self.edges, decode=self.decode)


def _dilate_first_blocks(stages: nn.Module) -> None:
    """Give the first block of a dilated ResNet stage the dilation of the others; in timm it is less dilated."""
    for name in ("layer3", "layer4"):
        if hasattr(stages, name):
            first, second = list(getattr(stages, name))[:2]
            first.conv2.dilation = first.conv2.padding = second.conv2.dilation
