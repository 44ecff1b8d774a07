"""The original's interface to a model, for its ``torch.hub`` users. ``hubconf.py`` builds on it."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Literal
from urllib.parse import urlparse

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor, nn

from zoedepth.baselines.baseline import IMAGENET_MEAN, IMAGENET_STD
from zoedepth.build import build_model
from zoedepth.config import AnyModelConfig, AttractorConfig, ModelConfig
from zoedepth.download import download
from zoedepth.errors import InputError
from zoedepth.images import PNG_MAX, PNG_SCALE_KITTI, to_image
from zoedepth.model.interface import DepthModel
from zoedepth.pixels import check_pixels, resize_pixels
from zoedepth.predict import Predictor
from zoedepth.presets import ENCODERS, PRESETS, with_compat, with_encoder
from zoedepth.weights.load import load_network
from zoedepth.weights.releases import RELEASES, download_folder

MIDAS_MODELS = {
    "DPT_BEiT_L_384": "beit_large_patch16_384",
    "DPT_BEiT_L_512": "beit_large_patch16_512",
    "DPT_BEiT_B_384": "beit_base_patch16_384",
    "DPT_SwinV2_L_384": "swinv2_large_window12to24_192to384",
    "DPT_SwinV2_B_384": "swinv2_base_window12to24_192to384",
    "DPT_SwinV2_T_256": "swinv2_tiny_window16_256",
    "DPT_Swin_L_384": "swin_large_patch4_window12_384",
}
"""The original's ``midas_model_type`` → the encoder in timm."""


class OriginalInterface(nn.Module):
    """ZoeDepth with the methods, defaults and units of the original's ``depth_model.py``.

    Five things differ: each photo of a batch takes its own head, and its mirror image the same one; 16-bit values are
    clipped and do not wrap around; ``forward`` returns the relative depth that it promises; and the model is in
    evaluation mode.

    The original knows no cameras, and depth is that of the training photos' camera here. Use ``Predictor`` for models
    that were trained in one canonical camera.

    Args:
        model: any ZoeDepth with metric heads; ``.model`` afterwards.
    """

    def __init__(self, model: DepthModel) -> None:
        super().__init__()
        self.model = model
        self.train(model.training)

    @property
    def device(self) -> torch.device:
        """Return the device of the weights."""
        return self.model.device

    def forward(
        self,
        x: Float[Tensor, "batch 3 height width"],
        return_final_centers: bool = False,
        denorm: bool = False,
        return_probs: bool = False,
    ) -> dict[str, Tensor]:
        """Compute depth at the network's resolution.

        Args:
            x: RGB in [0, 1], of any size; it is resized here.
            return_final_centers: add ``bin_centers``, (batch, bins, h, w), metres.
            denorm: undo ImageNet's mean and standard deviation in x first.
            return_probs: add ``probs``, (batch, bins, h, w).

        Returns:
            ``metric_depth`` (batch, 1, h, w), metres; ``rel_depth`` (batch, 1, h, w), relative inverse depth;
            ``domain_logits`` (batch, 2) if there are two heads.

        Raises:
            InputError: wrong shape, type or range: normalised pixels need ``denorm``.
        """
        if denorm:
            mean, std = (x.new_tensor(values)[:, None, None] for values in (IMAGENET_MEAN, IMAGENET_STD))
            x = x * std + mean
        check_pixels(x)
        size = Predictor(self.model, pad=False).network_size((x.shape[2], x.shape[3]))
        bins = return_final_centers or return_probs
        output = self.model(resize_pixels(x, size, antialias=self.model.config.antialias), return_bins=bins)
        result = {"metric_depth": output.depth}
        if output.relative is not None:
            result["rel_depth"] = output.relative
        if output.domain_logits is not None:
            result["domain_logits"] = output.domain_logits
        if return_final_centers and output.bin_centers is not None:
            result["bin_centers"] = output.bin_centers
        if return_probs and output.probability is not None:
            result["probs"] = output.probability
        return result

    def infer(
        self, x: Float[Tensor, "batch 3 height width"], pad_input: bool = True, with_flip_aug: bool = True
    ) -> Float[Tensor, "batch 1 height width"]:
        """Compute depth in metres at the size of ``x``, RGB in [0, 1]. Gradients flow.

        Args:
            x: photos, as they are: normalised by the model.
            pad_input: reflect the borders outwards before the network, and cut them off after.
            with_flip_aug: average with the prediction for the mirror image.
        """
        return Predictor(self.model, pad=pad_input, flip_average=with_flip_aug).infer(x)

    def infer_pil(
        self,
        pil_img: Image.Image,
        pad_input: bool = True,
        with_flip_aug: bool = True,
        output_type: Literal["numpy", "pil", "tensor"] = "numpy",
    ) -> "np.ndarray | Image.Image | Tensor":
        """Compute the depth of a PIL image, at its size.

        Args:
            pil_img: image of any mode, read as ``Predictor`` reads it: 16 bits span 0 to 65535, floats are in [0, 1],
                and alpha is dropped. As in the original, its EXIF orientation is not applied.
            pad_input: see ``infer``.
            with_flip_aug: see ``infer``.
            output_type: "numpy" float32 (height, width), metres; "tensor" the same on the CPU; "pil" a 16-bit image of
                256 levels a metre, 255.996 m at most (the original wraps around there).

        Raises:
            InputError: the output type is unknown, or the image has values out of range, or a mode without colours.
        """
        if output_type not in ("numpy", "pil", "tensor"):
            raise InputError(f"output_type must be 'numpy', 'pil' or 'tensor', got {output_type!r}")
        with torch.no_grad():
            depth = self.infer(pil_to_batched_tensor(pil_img), pad_input, with_flip_aug)[0, 0].cpu()
        if output_type == "tensor":
            return depth
        if output_type == "numpy":
            return depth.numpy()
        return Image.fromarray((depth.numpy() * PNG_SCALE_KITTI).clip(0, PNG_MAX).astype(np.uint16))


def pil_to_batched_tensor(img: Image.Image) -> Float[Tensor, "1 3 height width"]:
    """Return a PIL image as RGB in [0, 1], as ``infer`` takes it. Its EXIF orientation is not applied.

    Raises:
        InputError: the image has values out of range, or a mode without colours.
    """
    return torch.tensor(to_image(img, upright=False)).permute(2, 0, 1)[None].float() / 255


def build(
    preset: str, *, pretrained: bool | str, midas_model_type: str, config_mode: str, compat: tuple[str, ...]
) -> OriginalInterface:
    """Build or load a model for ``hubconf.py``, in evaluation mode.

    Args:
        preset: name in ``presets.PRESETS``.
        pretrained: True for the released weights (fetched once), a path, an http(s) url, or False for random weights.
            They may begin with the original's "local::" and "url::".
        midas_model_type: encoder, as in the original; the released weights are of "DPT_BEiT_L_384".
        config_mode: "infer" keeps the photo's proportions; "eval" and "train" squeeze it to the trained size.
        compat: see ``presets.COMPAT``.

    Raises:
        InputError: a name is unknown, an address has no file name, or the weights belong to another kind of model.
    """
    if config_mode not in ("infer", "eval", "train"):
        raise InputError(f"config_mode must be 'infer', 'eval' or 'train', got {config_mode!r}")
    if midas_model_type not in MIDAS_MODELS:
        raise InputError(f"midas_model_type {midas_model_type!r} is unknown: give one of {sorted(MIDAS_MODELS)}")
    if config_mode != "infer":
        compat = (*compat, "squeeze")
    config = with_encoder(PRESETS[preset], MIDAS_MODELS[midas_model_type])
    if not pretrained:
        return OriginalInterface(build_model(with_compat(config, compat)).eval())
    if ENCODERS[MIDAS_MODELS[midas_model_type]] != PRESETS[preset].encoder:
        raise InputError(
            f"there are pretrained weights for DPT_BEiT_L_384 only, not for {midas_model_type}: leave pretrained out"
        )
    model = _load(preset if pretrained is True else pretrained, compat)
    if _kind(model.config) != _kind(config):
        raise InputError(
            f"{pretrained} is not a {preset}: (domains, kind of centers) are {_kind(model.config)}, not "
            f"{_kind(config)}. Use the entry point of its kind"
        )
    return OriginalInterface(model)


def check_options(options: Mapping[str, object], *, config_mode: str) -> None:
    """Refuse further options of the original's entry points, unless they ask for what is done in any case.

    The original handed every option on, and swallowed those that it did not know.

    Raises:
        InputError: an option would change the network, or is unknown.
    """
    done = {"train_midas": False, "use_pretrained_midas": False, "force_keep_ar": config_mode == "infer"}
    if refused := [name for name, value in options.items() if name not in done or value != done[name]]:
        raise InputError(
            f"{', '.join(refused)} cannot be set here: released weights fit the released configuration alone. For "
            "another network, change a configuration of zoedepth.PRESETS by dataclasses.replace, give it to "
            "zoedepth.build_model, and train it with `zoedepth train`"
        )


def _load(source: str, compat: tuple[str, ...]) -> DepthModel:
    source = source.removeprefix("local::").removeprefix("url::")
    if source.startswith(("http://", "https://")):
        source = str(download(source, _kept_at(source)))
    return load_network(source, compat=compat)


def _kept_at(address: str) -> Path:
    """Return where the weights of an address are kept: those of a release at its place, others in a folder of theirs.

    Many files are called model.pt, and one address may give another file by its query.

    Raises:
        InputError: the address has no file name.
    """
    if released := next((release.path for release in RELEASES.values() if release.url == address), None):
        return released
    name = urlparse(address).path.rpartition("/")[2]
    if name in ("", ".", ".."):
        raise InputError(f"{address} has no file name: give the address of a file of weights, e.g. https://…/model.pt")
    return download_folder() / hashlib.sha256(address.encode()).hexdigest()[:16] / name


def _kind(config: AnyModelConfig) -> tuple[int, str]:
    """Return what tells N, K and NK apart: the number of domains and the kind of centers."""
    head = config.head if isinstance(config, ModelConfig) else None
    return len(config.domains), head.centers if isinstance(head, AttractorConfig) else "other heads"
