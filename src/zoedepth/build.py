"""Build networks: the one way from a configuration to a model."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, overload

import torch
from torch.nn import init
from torch.overrides import TorchFunctionMode

from zoedepth.baselines import BASELINES
from zoedepth.config import AnyModelConfig, ModelConfig
from zoedepth.model.interface import DepthModel
from zoedepth.model.zoedepth import ZoeDepth


@overload
def build_model(config: ModelConfig) -> ZoeDepth: ...


@overload
def build_model(config: AnyModelConfig) -> DepthModel: ...


def build_model(config: AnyModelConfig) -> DepthModel:
    """Build the network of a configuration, with random weights, in training mode.

    Args:
        config: config of a ZoeDepth or a baseline, for example ``zoedepth.presets.PRESETS["zoed-m12-nk"]``.

    Returns:
        The model, its weights in the memory format that convolutions are fastest in.

    Raises:
        InputError: the encoder has fewer blocks than the configuration takes maps from.
    """
    model = ZoeDepth(config) if isinstance(config, ModelConfig) else BASELINES[type(config.network)](config)
    return channels_last(model)


@contextmanager
def without_memory() -> Iterator[None]:
    """Build networks without memory in this context: their weights have shapes and no values, on the meta device."""
    import timm  # noqa: F401  # before: it imports parts of torch that torch 2.6 cannot import on the meta device

    with torch.device("meta"), _NoValues():
        yield


class _NoValues(TorchFunctionMode):
    """Skips the first values of weights: to fill them in has no effect without memory, and takes most of the time."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func in _FILLING:
            tensor = args[0] if args else kwargs["tensor"]
            if tensor.is_meta:
                return tensor
        return func(*args, **(kwargs or {}))


_FILLING: set[Any] = {
    torch.Tensor.uniform_, torch.Tensor.normal_, torch.Tensor.erfinv_, torch.Tensor.clamp_, torch.Tensor.mul_,
    torch.Tensor.add_, torch.Tensor.fill_, torch.Tensor.zero_,
    *(getattr(init, name) for name in dir(init) if name.endswith("_") and not name.startswith("_")),
}  # fmt: skip
"""Methods and functions of initialisers, which change a tensor in place and return it."""


def channels_last(model: DepthModel) -> DepthModel:
    """Give the weights of all convolutions the memory format that their maps have."""
    module: Any = model  # torch's types leave this argument out
    return module.to(memory_format=torch.channels_last)
