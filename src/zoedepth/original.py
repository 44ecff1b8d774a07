"""The functions that the README of isl-org/ZoeDepth imports, so that programs written for it run as they are.

    from zoedepth.models.builder import build_model
    from zoedepth.utils.config import get_config
    from zoedepth.utils.misc import colorize, get_image_from_url, pil_to_batched_tensor, save_raw_16bit

``zoedepth.moved`` lets Python find them under these names. New programs use ``load_model`` and ``Predictor``.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import UInt8
from PIL import Image
from torch import Tensor

from zoedepth import colors
from zoedepth.download import download
from zoedepth.errors import InputError
from zoedepth.images import PNG_SCALE_KITTI, read_image
from zoedepth.outputs.depth import write_depth_png
from zoedepth.torchhub import OriginalInterface, build, check_options, pil_to_batched_tensor
from zoedepth.weights.releases import RELEASES

__all__ = [
    "Config",
    "build_model",
    "colorize",
    "get_config",
    "get_image_from_url",
    "pil_to_batched_tensor",
    "save_raw_16bit",
]

_PRESETS = {
    ("zoedepth", None): "zoed-m12-n",
    ("zoedepth", "kitti"): "zoed-m12-k",
    ("zoedepth_nk", None): "zoed-m12-nk",
}


class Config(dict[str, object]):
    """A configuration whose values are attributes, too, as the original's (EasyDict)."""

    def __getattr__(self, name: str) -> object:
        """Return a value."""
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(f"the configuration has no {name}, but {', '.join(self)}") from error

    def __setattr__(self, name: str, value: object) -> None:
        """Set a value."""
        self[name] = value


def get_config(
    model_name: str,
    mode: str = "train",
    dataset: str | None = None,
    *,
    config_version: str | None = None,
    midas_model_type: str = "DPT_BEiT_L_384",
    pretrained_resource: str | None = "",
    **overwrite_kwargs: object,
) -> Config:
    """Return the configuration that ``build_model`` takes (``zoedepth/utils/config.py`` of the original).

    Args:
        model_name: "zoedepth" or "zoedepth_nk".
        mode: "infer" keeps the photo's proportions, "eval" squeezes it to the trained size. There is no "train", the
            original's default: ``zoedepth train`` trains.
        dataset: "nyu", "kitti" or None. It changes nothing: ZoeD-K reaches 80 m always, in the original only with it.
        config_version: "kitti" for ZoeD-K, None for others.
        midas_model_type: encoder; the released weights are of "DPT_BEiT_L_384".
        pretrained_resource: "local::PATH" or "url::ADDRESS" of weights; "" the released ones; None random ones.
        overwrite_kwargs: further options of the original. Those that would change the network are refused.

    Raises:
        InputError: there is no such model, mode or data set, or an option that is refused.
    """
    if (model_name, config_version) not in _PRESETS:
        raise InputError(
            f"there is no model {model_name!r} with config_version {config_version!r}: give 'zoedepth' (for ZoeD-K "
            "with config_version='kitti') or 'zoedepth_nk'"
        )
    if mode not in ("infer", "eval"):
        raise InputError(
            f"mode {mode!r} is not for loading a model: give 'infer' or 'eval'. To train, use `zoedepth train`"
        )
    if dataset not in ("nyu", "kitti", None):
        raise InputError(f"dataset must be 'nyu', 'kitti' or None, got {dataset!r}")
    check_options(overwrite_kwargs, config_mode=mode)
    released = f"url::{RELEASES[_PRESETS[model_name, config_version]].url}"
    return Config(
        model=model_name,
        mode=mode,
        config_version=config_version,
        midas_model_type=midas_model_type,
        pretrained_resource=released if pretrained_resource == "" else pretrained_resource,
    )


def build_model(config: Config) -> OriginalInterface:
    """Build the model of a configuration, with its weights (``zoedepth/models/builder.py`` of the original).

    It comes in evaluation mode. Released weights are fetched once.

    Raises:
        InputError: the weights are not there, or of another kind of model.
    """
    return build(
        _PRESETS[str(config.model), None if config.config_version is None else str(config.config_version)],
        pretrained=str(config.pretrained_resource) if config.pretrained_resource else False,
        midas_model_type=str(config.midas_model_type),
        config_mode=str(config.mode),
        compat=(),
    )


def get_image_from_url(url: str) -> Image.Image:
    """Fetch a photo; returns it as RGB, upright.

    Raises:
        InputError: it is no photo.
        ZoeDepthError: the server does not give it.
    """
    with TemporaryDirectory() as folder:
        return Image.fromarray(read_image(download(url, Path(folder) / "photo", name=url)))


def save_raw_16bit(depth: np.ndarray | Tensor, fpath: str | Path = "raw.png") -> None:
    """Write metres as a 16-bit PNG of 256 levels a metre. Depth beyond 255.996 m is clipped, and does not wrap around.

    Args:
        depth: (height, width), or a tensor with further axes of length 1.
        fpath: where to write.

    Raises:
        InputError: it has more than two axes.
    """
    if isinstance(depth, Tensor):
        depth = depth.detach().squeeze().cpu().numpy()
    write_depth_png(fpath, depth, scale=PNG_SCALE_KITTI)


def colorize(
    value: np.ndarray | Tensor,
    vmin: float | None = None,
    vmax: float | None = None,
    cmap: str = "gray_r",
    invalid_val: float = -99,
    invalid_mask: np.ndarray | None = None,
    background_color: tuple[int, int, int, int] = (128, 128, 128, 255),
) -> UInt8[np.ndarray, "height width 4"]:
    """Colour a map, as RGBA.

    Args:
        value: (height, width), with any axes of length 1 beside.
        vmin: value of the first colour; None: the 2nd percentile.
        vmax: value of the last colour; None: the 85th percentile.
        cmap: one of ``zoedepth.colors.COLORMAPS``, reversed with ``_r``.
        invalid_val: value of pixels that get the background's colour.
        invalid_mask: True for these pixels, in place of ``invalid_val``.
        background_color: their colour, RGBA.

    Raises:
        InputError: there is no such colour map, or ``vmin`` is not below ``vmax``.
    """
    if isinstance(value, Tensor):
        value = value.detach().cpu().numpy()
    value = np.squeeze(value).astype(np.float64)
    invalid = (value == invalid_val) if invalid_mask is None else np.squeeze(invalid_mask)
    invalid |= ~np.isfinite(value)
    low, high = np.percentile(value[~invalid], (2, 85)) if not invalid.all() else (0.0, 1.0)
    first, last = low if vmin is None else vmin, high if vmax is None else vmax
    share = np.where(invalid, 0.0, (value - first) / (last - first if last != first else 1.0)).clip(0, 1)
    # From 1 to 2, because what is not above 0 has no colour there.
    rgb = colors.colorize(1 + share, vmin=1.0, vmax=2.0, colormap=cmap)
    rgba = np.dstack([rgb, np.full(rgb.shape[:2], 255, np.uint8)])
    rgba[invalid] = background_color
    return rgba
