"""The DPT decoder: reassemble, four fusion levels, relative head (paper section 3.2; MiDaS ``dpt_depth.py``)."""

from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.config import DecoderConfig
from zoedepth.model.encoder import EncoderFeatures
from zoedepth.model.upsample import upsample


class DecoderFeatures(NamedTuple):
    """Everything that a metric head may look at."""

    bottleneck: Float[Tensor, "batch _ _ _"]
    """Stride 32: the coarsest map before fusion."""
    levels: tuple[Float[Tensor, "batch _ _ _"], ...]
    """Outputs of the four fusion blocks, coarse to fine: strides 16, 8, 4, 2."""
    last: Float[Tensor, "batch features height width"]
    """The map the relative depth is predicted from, at stride ``output_stride``."""
    relative: Float[Tensor, "batch 1 height width"]
    """Relative depth: inverse depth up to an unknown scale and shift, >= 0, near is large; same stride as ``last``."""

    def rows(self, rows: Int[Tensor, " rows"]) -> "DecoderFeatures":
        """Take some images of the batch."""
        levels = tuple(level[rows] for level in self.levels)
        return DecoderFeatures(self.bottleneck[rows], levels, self.last[rows], self.relative[rows])


class DecoderChannels(NamedTuple):
    """Channels of the maps in ``DecoderFeatures``, for the modules built on them."""

    bottleneck: int
    levels: tuple[int, int, int, int]
    last: int


class Decoder(nn.Module):
    """Decode the encoder's maps into decoder features and relative depth.

    Args:
        channels: channels of the encoder's maps, fine to coarse.
        strides: strides of the encoder's maps, pixels.
        config: widths of the levels, and the last map.
        has_readout: True where the encoder gives a class token beside each map, which is then reassembled.
        reassembled_channels: channels of the maps at strides 4, 8, 16, 32.

    Attributes:
        channels: channels of the maps in ``DecoderFeatures``.
    """

    def __init__(
        self,
        channels: tuple[int, ...],
        strides: tuple[int, ...],
        config: DecoderConfig,
        *,
        has_readout: bool,
        reassembled_channels: tuple[int, ...],
    ) -> None:
        super().__init__()
        widths, features = config.widths, config.features
        self.reassemble = nn.ModuleList(
            Reassemble(channels[i], reassembled_channels[i], stride=strides[i], output_stride=4 * 2**i)
            if has_readout
            else nn.Identity()
            for i in range(4)
        )
        self.project = nn.ModuleList(
            nn.Conv2d(reassembled_channels[i], widths[i], kernel_size=3, padding=1, bias=False) for i in range(4)
        )
        # Coarse to fine. The coarsest has nothing to fuse with: the released checkpoints hold a unit for it, unused.
        self.fusion = nn.ModuleList(
            Fusion(widths[i], widths[max(i - 1, 0)], has_skip=i < 3) for i in reversed(range(4))
        )
        self.relative_head = RelativeHead(widths[0], features=features, upsample=config.output_stride == 1)
        self.channels = DecoderChannels(widths[3], (widths[2], widths[1], widths[0], widths[0]), features)

    def forward(self, features: EncoderFeatures) -> DecoderFeatures:
        """Decode four encoder maps."""
        maps = [
            reassemble(x) if features.readouts is None else reassemble(x, features.readouts[i])
            for i, (reassemble, x) in enumerate(zip(self.reassemble, features.maps, strict=True))
        ]
        maps = [project(x) for project, x in zip(self.project, maps, strict=True)]
        sizes = [x.shape[-2:] for x in maps]
        sizes.insert(0, torch.Size([2 * sizes[0][0], 2 * sizes[0][1]]))
        level = None
        levels = []
        for i, fusion in zip(reversed(range(4)), self.fusion, strict=True):  # from stride 32 up to stride 4
            level = fusion(maps[i], level, size=sizes[i])
            levels.append(level)
        last, relative = self.relative_head(levels[-1])
        return DecoderFeatures(maps[3], tuple(levels), last, relative)


class Reassemble(nn.Module):
    """Make a map of tokens: join the readout token to each of them, project, resample (DPT section 3.1)."""

    def __init__(self, channels: int, output_channels: int, *, stride: int, output_stride: int) -> None:
        super().__init__()
        self.readout = nn.Linear(2 * channels, channels)
        self.project = nn.Conv2d(channels, output_channels, kernel_size=1)
        if output_stride < stride:
            factor = stride // output_stride
            self.resample = nn.ConvTranspose2d(output_channels, output_channels, kernel_size=factor, stride=factor)
        elif output_stride > stride:
            self.resample = nn.Conv2d(
                output_channels, output_channels, kernel_size=3, stride=output_stride // stride, padding=1
            )
        else:
            self.resample = nn.Identity()

    def forward(
        self, x: Float[Tensor, "batch channels rows columns"], readout: Float[Tensor, "batch channels"]
    ) -> Float[Tensor, "batch output_channels _ _"]:
        """Reassemble one map, given the class token beside it."""
        # MiDaS repeats the readout token beside every token. Its product is the same for all: once is half of the work.
        of_tokens, of_readout = self.readout.weight.chunk(2, dim=1)
        tokens = F.linear(x.flatten(2).transpose(1, 2), of_tokens)
        tokens = F.gelu(tokens + F.linear(readout, of_readout, self.readout.bias)[:, None])
        return self.resample(self.project(tokens.transpose(1, 2).reshape(x.shape)))


class Fusion(nn.Module):
    """Add the skip, refine, go to the next finer size (DPT's RefineNet block; MiDaS ``FeatureFusionBlock_custom``)."""

    def __init__(self, width: int, output_width: int, *, has_skip: bool) -> None:
        super().__init__()
        self.skip = ResidualUnit(width) if has_skip else None
        self.refine = ResidualUnit(width)
        self.project = nn.Conv2d(width, output_width, kernel_size=1)

    def forward(
        self,
        skip: Float[Tensor, "batch width _ _"],
        coarser: Float[Tensor, "batch width _ _"] | None,
        *,
        size: torch.Size,
    ) -> Float[Tensor, "batch output_width _ _"]:
        """Fuse a map with the level before it (None at the coarsest) and upsample to ``size``."""
        x = skip if self.skip is None or coarser is None else coarser + self.skip(skip)
        # MiDaS upsamples first; a 1x1 convolution and an interpolation commute, and this order is 4x less work.
        return upsample(self.project(self.refine(x)), size)


class ResidualUnit(nn.Module):
    """x + conv(relu(conv(relu(x)))) (RefineNet; MiDaS ``ResidualConvUnit_custom``)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(width, width, kernel_size=3, padding=1)
        self.conv2 = nn.Conv2d(width, width, kernel_size=3, padding=1)

    def forward(self, x: Float[Tensor, "batch width _ _"]) -> Float[Tensor, "batch width _ _"]:
        """Refine the map; its shape stays."""
        return x + self.conv2(F.relu(self.conv1(F.relu(x)), inplace=True))


class RelativeHead(nn.Module):
    """The last decoder map, and the relative depth predicted from it (MiDaS ``DPTDepthModel.head``)."""

    def __init__(self, width: int, *, features: int, upsample: bool) -> None:
        super().__init__()
        self.upsample = upsample
        self.conv1 = nn.Conv2d(width, width // 2, kernel_size=3, padding=1)
        self.conv2 = nn.Conv2d(width // 2, features, kernel_size=3, padding=1)
        self.conv3 = nn.Conv2d(features, 1, kernel_size=1)
        # The head ends in a ReLU. If a new model said negative depth everywhere, its gradient would stay 0 for ever.
        bias: Any = self.conv3.bias
        nn.init.constant_(bias, 0.5)

    def forward(
        self, x: Float[Tensor, "batch width _ _"]
    ) -> tuple[Float[Tensor, "batch features _ _"], Float[Tensor, "batch 1 _ _"]]:
        """Return the last map and the relative depth, given the finest level."""
        x = self.conv1(x)
        if self.upsample:
            x = upsample(x, torch.Size([2 * x.shape[-2], 2 * x.shape[-1]]))
        last = F.relu(self.conv2(x), inplace=True)
        return last, F.relu(self.conv3(last), inplace=True)
