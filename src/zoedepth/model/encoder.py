"""The encoder: any of the paper's networks from timm, as four feature maps.

The differences between families (tokens or maps, channels last or first, four strides or one) end here.
"""

from typing import Any, NamedTuple

from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.config import EncoderConfig
from zoedepth.model.beit import PATCH, BeitNetwork
from zoedepth.model.linear import replace_linear
from zoedepth.model.timm_encoder import FeatureEncoder, TimmEncoder


class EncoderFeatures(NamedTuple):
    """The encoder's output, and the decoder's input."""

    maps: tuple[Float[Tensor, "batch _ _ _"], ...]
    """Four maps, fine to coarse, with ``Encoder.channels`` at ``Encoder.strides``."""
    readouts: tuple[Float[Tensor, "batch _"], ...] | None
    """The class token beside each map, for encoders that have one."""


class Encoder(TimmEncoder):
    """One of ``presets.ENCODERS``.

    Attributes:
        channels: channels of the four maps.
        strides: their strides, pixels.
        reassembled_channels: channels the decoder reassembles them to at strides 4, 8, 16, 32; equal to ``channels``
            where the maps already have these strides.
        has_readout: True where there is a class token beside each map.
    """

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__()
        self.has_readout = config.family == "beit"
        self.network: BeitNetwork | FeatureEncoder
        if self.has_readout:
            self.network = BeitNetwork(
                config.name,
                size=config.size,
                taps=config.taps,
                width=config.width,
                depth=config.depth[0] if config.depth else None,
                heads=config.heads[0] if config.heads else None,
                mlp_width=config.mlp_width,
            )
            self.strides: tuple[int, ...] = (PATCH,) * 4
        else:
            swin = config.family == "swin"
            levels = (0, 1, 2, 3) if swin else (1, 2, 3, 4)
            self.network = FeatureEncoder(config.name, levels=levels, options=_swin_options(config) if swin else None)
            self.strides = self.network.strides
        replace_linear(self.network)
        self.channels = self.network.channels
        self.reassembled_channels = config.channels if self.has_readout else self.channels

    def load_timm(self, network: nn.Module) -> None:
        """Copy the weights of timm's network of the same shape."""
        self.network.load_timm(network)

    def checkpoint_gradients(self) -> None:
        """Save memory from now on: the backward pass computes the insides of blocks or stages again."""
        self.network.checkpoint_gradients()

    def forward(self, pixels: Float[Tensor, "batch 3 height width"]) -> EncoderFeatures:
        """Return the features of normalised pixels whose sides are multiples of 32."""
        if self.has_readout:
            maps, readouts = self.network(pixels)
            return EncoderFeatures(tuple(maps), tuple(readouts))
        return EncoderFeatures(tuple(self.network(pixels)), None)


def _swin_options(config: EncoderConfig) -> dict[str, Any]:
    options = {"img_size": config.size, "embed_dim": config.width, "depths": config.depth, "num_heads": config.heads}
    return {name: value for name, value in options.items() if value is not None}
