"""Build networks: the one way from a configuration to a model."""

from typing import Any, overload

import torch

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


def channels_last(model: DepthModel) -> DepthModel:
    """Give the weights of all convolutions the memory format that their maps have."""
    module: Any = model  # torch's types leave this argument out
    return module.to(memory_format=torch.channels_last)
