"""EfficientNet and the U-Net on it, which AdaBins, LocalBins and PixelBins share.

(AdaBins ``unet_adaptive_bins.py``, LocalBins ``localbins.py``, PixelBins ``custom.py``.)
"""

from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.errors import InputError
from zoedepth.model.decoder import DecoderChannels
from zoedepth.model.timm_encoder import TimmEncoder, create_network
from zoedepth.model.upsample import upsample


class EfficientNetEncoder(TimmEncoder):
    """Five maps of one of timm's EfficientNets, fine to coarse, at ``strides``.

    The coarsest is the output of the 1x1 convolution before the classifier, without the normalisation and activation
    after it, as in the originals.

    Args:
        name: timm architecture.

    Attributes:
        channels: channels of the maps. tf_efficientnet_b5: 24, 40, 64, 176, 2048.
        strides: strides of the maps: 2, 4, 8, 16, 32.

    Raises:
        InputError: the architecture is no EfficientNet.
    """

    strides = (2, 4, 8, 16, 32)

    def __init__(self, name: str) -> None:
        from timm.models.efficientnet import EfficientNet

        super().__init__()
        network = create_network(name, num_classes=0)
        stages = network.feature_info if isinstance(network, EfficientNet) else []
        if tuple(stage["reduction"] for stage in stages) != self.strides:
            raise InputError(
                f"network.encoder is {name}. It must be an EfficientNet with maps at strides {self.strides}, "
                "for example tf_efficientnet_b5."
            )
        network.bn2 = nn.Identity()
        self.network: Any = network
        self.channels: tuple[int, ...] = (*(stage["num_chs"] for stage in stages[:-1]), self.network.num_features)

    def load_timm(self, network: nn.Module) -> None:
        """Copy the weights of timm's network of the same shape, without its classifier and the norm before it."""
        given = network.state_dict()
        self.network.load_state_dict({name: given[name] for name in self.network.state_dict()})

    def checkpoint_gradients(self) -> None:
        """Save memory from now on: the backward pass computes the insides of the stages again."""
        self.network.set_grad_checkpointing(True)

    def forward(self, x: Float[Tensor, "batch 3 height width"]) -> list[Float[Tensor, "batch _ _ _"]]:
        """Return the maps of normalised pixels whose sides are multiples of 32."""
        last, maps = self.network.forward_intermediates(x, indices=[0, 1, 2, 3])
        return [*maps, last]


class UNetFeatures(NamedTuple):
    """The output of ``UNetDecoder``."""

    bottleneck: Float[Tensor, "batch _ _ _"]
    """The coarsest encoder map after one convolution: stride 32, and one pixel more on each side."""
    levels: tuple[Float[Tensor, "batch _ _ _"], ...]
    """Outputs of the four levels, coarse to fine: strides 16, 8, 4, 2."""
    last: Float[Tensor, "batch _ _ _"]
    """The finest level after a last convolution, where there is one: stride 2."""


class UNetDecoder(nn.Module):
    """Decodes from coarse to fine: upsample, join the encoder's map, two convolutions, with ever half the channels.

    The first 1x1 convolution has a padding of 1, as in all three originals, so its bias frames its map. That only
    presses the photo together, but published weights are used to it.

    Args:
        channels: channels of the encoder's maps, strides 2 to 32.
        features: channels of the last map; None: it is the finest level.
        slim: True: the second convolution of a level is 1x1, and neither has a bias (PixelBins).

    Attributes:
        channels: channels of the maps in ``UNetFeatures``.
    """

    def __init__(self, channels: tuple[int, ...], *, features: int | None = None, slim: bool = False) -> None:
        super().__init__()
        *skips, width = channels
        widths = tuple(width // 2**i for i in range(5))
        self.bottleneck = nn.Conv2d(width, width, kernel_size=1, padding=1)
        self.levels = nn.ModuleList(
            Level(widths[i] + skip, widths[i + 1], slim=slim) for i, skip in enumerate(reversed(skips))
        )
        self.last = nn.Identity() if features is None else nn.Conv2d(widths[4], features, kernel_size=3, padding=1)
        self.channels = DecoderChannels(width, (widths[1], widths[2], widths[3], widths[4]), features or widths[4])

    def forward(self, maps: list[Float[Tensor, "batch _ _ _"]]) -> UNetFeatures:
        """Decode five encoder maps, fine to coarse."""
        *skips, coarsest = maps
        x = bottleneck = self.bottleneck(coarsest)
        levels = []
        for level, skip in zip(self.levels, reversed(skips), strict=True):
            x = level(x, skip)
            levels.append(x)
        return UNetFeatures(bottleneck, tuple(levels), self.last(x))


class Level(nn.Module):
    """One level of the decoder (AdaBins ``UpSampleBN``)."""

    def __init__(self, channels: int, output_channels: int, *, slim: bool) -> None:
        super().__init__()
        side = 1 if slim else 3
        self.convs = nn.Sequential(
            nn.Conv2d(channels, output_channels, kernel_size=3, padding=1, bias=not slim),
            nn.BatchNorm2d(output_channels),
            nn.LeakyReLU(),
            nn.Conv2d(output_channels, output_channels, kernel_size=side, padding=side // 2, bias=not slim),
            nn.BatchNorm2d(output_channels),
            nn.LeakyReLU(),
        )

    def forward(
        self, coarser: Float[Tensor, "batch _ _ _"], skip: Float[Tensor, "batch _ height width"]
    ) -> Float[Tensor, "batch output_channels height width"]:
        """Upsample the level before this one, join it with the encoder's map, and refine both."""
        return self.convs(torch.cat([upsample(coarser, skip.shape[-2:]), skip], dim=1))
