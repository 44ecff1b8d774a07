"""Encoders made of timm networks: how such a network is built, and the maps of any of them."""

import functools
from abc import ABC, abstractmethod
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn


def create_network(name: str, **options: Any) -> Any:
    """Build a timm network with random weights, its depthwise convolutions made to train in float32.

    Args:
        name: timm architecture.
        options: arguments of timm's constructor.
    """
    import timm

    network = timm.create_model(name, pretrained=False, **options)
    replace_depthwise(network)
    return network


class TimmEncoder(nn.Module, ABC):
    """An encoder that is made of a timm network."""

    @abstractmethod
    def load_timm(self, network: nn.Module) -> None:
        """Copy the weights of timm's network of the same shape; skip those that the encoder has no layer for."""

    @abstractmethod
    def checkpoint_gradients(self) -> None:
        """Save memory from now on: the backward pass computes the insides of blocks or stages again."""


class FeatureEncoder(TimmEncoder):
    """The maps of any timm network that gives some, fine to coarse.

    Args:
        name: timm architecture.
        levels: indices of its maps, as timm counts them (``out_indices``).
        options: further arguments of timm's constructor, such as ``output_stride``.

    Attributes:
        channels: channels of the maps.
        strides: strides of the maps, pixels.
    """

    def __init__(self, name: str, *, levels: tuple[int, ...], options: dict[str, Any] | None = None) -> None:
        super().__init__()
        self.stages: Any = create_network(name, features_only=True, out_indices=levels, **(options or {}))
        self.channels: tuple[int, ...] = tuple(self.stages.feature_info.channels())
        self.strides: tuple[int, ...] = tuple(self.stages.feature_info.reduction())
        self.channels_last = getattr(self.stages, "output_fmt", None) == "NHWC"

    def load_timm(self, network: nn.Module) -> None:
        """Copy the weights of timm's whole network of the same shape, without its classifier and the layers after the
        last map."""
        # features_only names nested modules layers_0, features_norm5 and so on.
        given = {name.replace(".", "_"): value for name, value in network.state_dict().items()}
        self.stages.load_state_dict({name: given[name.replace(".", "_")] for name in self.stages.state_dict()})

    def checkpoint_gradients(self) -> None:
        """Save memory from now on: the backward pass computes the insides of the stages again."""
        inner = [m for m in self.stages.modules() if m is not self.stages and hasattr(m, "grad_checkpointing")]
        # Either the stages do it or the whole: with both, what is inside would be computed a third time.
        for module in inner or [self.stages]:
            module.grad_checkpointing = True

    def forward(self, x: Float[Tensor, "batch 3 height width"]) -> list[Float[Tensor, "batch _ _ _"]]:
        """Return the maps of normalised pixels."""
        maps = self.stages(x)
        return [level.permute(0, 3, 1, 2) for level in maps] if self.channels_last else maps


@functools.cache
def specialised(behaviour: type, base: type) -> type[Any]:
    """Make a class of ``behaviour`` before ``base``, for a class of timm, which is not imported before it is needed.

    Pickle finds the class by these two, also in a process that has built no network yet.

    Args:
        behaviour: class with the methods that differ from those of ``base``.
        base: the class whose methods they replace.
    """

    class Specialised(behaviour, base):
        def __reduce_ex__(self, protocol: object) -> tuple[Any, ...]:
            return _empty, (behaviour, base), self.__dict__

    Specialised.__name__ = Specialised.__qualname__ = behaviour.__name__.lstrip("_")
    return Specialised


def _empty(behaviour: type, base: type) -> Any:
    made: Any = specialised(behaviour, base)
    return made.__new__(made)


class _Float32Training(nn.Conv2d):
    """A convolution that trains in float32 under CPU autocast.

    oneDNN has no fast path for the backward pass of a depthwise convolution in bfloat16. In float32 a training step of
    EfficientNet-Lite0 takes 0.4 of the time (``docs/log.md``).
    """

    def forward(self, input: Tensor) -> Tensor:
        if self.training and input.device.type == "cpu" and torch.is_autocast_enabled("cpu"):
            with torch.autocast("cpu", enabled=False):
                return super().forward(input.float())
        return super().forward(input)


def replace_depthwise(network: nn.Module) -> None:
    """Replace each depthwise convolution by one that trains in float32, with the same weights."""
    from timm.layers import Conv2dSame

    twins = {nn.Conv2d: _Float32Training, Conv2dSame: specialised(_Float32Training, Conv2dSame)}
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
