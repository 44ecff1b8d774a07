"""The encoder: any of the paper's networks from timm, as four feature maps.

The differences between families (tokens or maps, channels last or first, four strides or one) end here.
"""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.config import EncoderConfig
from zoedepth.model.beit import PATCH, BeitNetwork
from zoedepth.model.linear import replace_linear


class EncoderFeatures(NamedTuple):
    """What the decoder gets."""

    maps: tuple[Float[Tensor, "batch _ _ _"], ...]
    """Four maps, fine to coarse, of ``Encoder.channels`` at ``Encoder.strides``."""
    readouts: tuple[Float[Tensor, "batch _"], ...] | None
    """The class token beside each map, for encoders that have one."""


class TimmEncoder(nn.Module, ABC):
    """An encoder that is made of a timm network."""

    @abstractmethod
    def load_timm(self, network: nn.Module) -> None:
        """Take the weights of timm's network of the same shape; what the encoder does not have of it stays out."""

    @abstractmethod
    def checkpoint_gradients(self) -> None:
        """From now on the backward pass computes what is inside blocks or stages again, instead of keeping it."""


class Encoder(TimmEncoder):
    """One of ``presets.ENCODERS``.

    Attributes:
        channels: channels of the four maps.
        strides: their strides, pixels.
        reassembled_channels: channels the decoder reassembles them to at strides 4, 8, 16, 32; the same as
            ``channels`` where the maps already have these strides.
        has_readout: whether there is a class token beside each map.
    """

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__()
        self.has_readout = config.family == "beit"
        self.network: BeitNetwork | PyramidNetwork = BeitNetwork(config) if self.has_readout else PyramidNetwork(config)
        self.channels = self.network.channels
        self.strides = (PATCH,) * 4 if self.has_readout else (4, 8, 16, 32)
        self.reassembled_channels = config.channels if self.has_readout else self.channels

    def load_timm(self, network: nn.Module) -> None:
        """Take the weights of timm's network of the same shape."""
        self.network.load_timm(network)

    def checkpoint_gradients(self) -> None:
        """From now on the backward pass computes what is inside blocks or stages again, instead of keeping it."""
        self.network.checkpoint_gradients()

    def forward(self, pixels: Float[Tensor, "batch 3 height width"]) -> EncoderFeatures:
        """Features of normalised pixels whose sides are multiples of 32."""
        if self.has_readout:
            maps, readouts = self.network(pixels)
            return EncoderFeatures(tuple(maps), tuple(readouts))
        return EncoderFeatures(tuple(self.network(pixels)), None)


class PyramidNetwork(nn.Module):
    """timm networks that give maps at strides 4, 8, 16, 32 by themselves: Swin, SwinV2, EfficientNet."""

    def __init__(self, config: EncoderConfig) -> None:
        import timm

        super().__init__()
        self.channels_last = config.family == "swin"
        overrides: dict[str, Any] = {}
        if config.family == "swin":
            overrides = {"img_size": config.size, "embed_dim": config.width, "depths": config.depth,
                         "num_heads": config.heads}  # fmt: skip
        self.stages: Any = timm.create_model(
            config.name,
            pretrained=False,
            features_only=True,
            out_indices=(0, 1, 2, 3) if config.family == "swin" else (1, 2, 3, 4),
            **{name: value for name, value in overrides.items() if value is not None},
        )
        self.channels: tuple[int, ...] = tuple(self.stages.feature_info.channels())
        if config.family == "convolutional":
            replace_depthwise(self.stages)
        replace_linear(self.stages)

    def load_timm(self, network: nn.Module) -> None:
        """Take the weights of timm's network of the same shape; its classifier, and what follows the maps, stay out."""
        load_features(self.stages, network)

    def checkpoint_gradients(self) -> None:
        """From now on the backward pass computes what is inside the stages again, instead of keeping it."""
        if self.channels_last:
            for stage in (module for module in self.stages.modules() if hasattr(module, "grad_checkpointing")):
                stage.grad_checkpointing = True
        else:
            self.stages.set_grad_checkpointing(True)

    def forward(self, pixels: Float[Tensor, "batch 3 height width"]) -> list[Float[Tensor, "batch _ _ _"]]:
        """Four maps, fine to coarse."""
        maps = self.stages(pixels)
        return [x.permute(0, 3, 1, 2) for x in maps] if self.channels_last else maps


class _Float32Training(nn.Conv2d):
    """A convolution that trains in float32 under CPU autocast.

    The backward of a depthwise convolution in bfloat16 has no fast path in oneDNN: in float32 a training step of
    EfficientNet-Lite0 takes 0.4 of the time (``docs/log.md``).
    """

    def forward(self, input: Tensor) -> Tensor:
        if self.training and input.device.type == "cpu" and torch.is_autocast_enabled("cpu"):
            with torch.autocast("cpu", enabled=False):
                return super().forward(input.float())
        return super().forward(input)


def load_features(stages: nn.Module, network: nn.Module) -> None:
    """Give timm's ``features_only`` network the weights of the whole network of the same shape."""
    # features_only names what were nested modules layers_0, features_norm5 and so on.
    given = {name.replace(".", "_"): value for name, value in network.state_dict().items()}
    stages.load_state_dict({name: given[name.replace(".", "_")] for name in stages.state_dict()})


def replace_depthwise(network: nn.Module) -> None:
    """Put a ``_Float32Training`` twin in the place of each depthwise convolution."""
    from timm.layers import Conv2dSame

    class Float32TrainingSame(_Float32Training, Conv2dSame):
        pass

    twins = {nn.Conv2d: _Float32Training, Conv2dSame: Float32TrainingSame}
    for parent in list(network.modules()):
        for name, conv in parent.named_children():
            if isinstance(conv, nn.Conv2d) and type(conv) in twins and conv.groups == conv.in_channels > 1:
                twin = twins[type(conv)](
                    conv.in_channels,
                    conv.out_channels,
                    conv.kernel_size,
                    conv.stride,
                    conv.padding,
                    conv.dilation,
                    groups=conv.groups,
                    bias=conv.bias is not None,
                )
                twin.load_state_dict(conv.state_dict())
                setattr(parent, name, twin)
