"""ZoeDepth: depth in metres from a single photo (Bhat et al. 2023, arXiv 2302.12288).

    from zoedepth import Predictor, load_model

    depth = Predictor(load_model("zoed-lite"))("photo.jpg").depth  # float32 (height, width), metres

Names are imported when first used, so that ``import zoedepth`` costs almost nothing.
"""

from typing import TYPE_CHECKING

from zoedepth import moved

if TYPE_CHECKING:
    from zoedepth.build import build_model
    from zoedepth.config import ModelConfig
    from zoedepth.depth_map import DepthMap
    from zoedepth.errors import InputError, ZoeDepthError
    from zoedepth.model.interface import DepthModel, DepthOutput
    from zoedepth.panorama import PanoramaMap, predict_panorama
    from zoedepth.predict import Predictor
    from zoedepth.stored import read_depth
    from zoedepth.tiles import predict_tiled
    from zoedepth.weights.load import available_models, load_for_prediction, load_model
    from zoedepth.weights.pretrained import ZoeDepth
    from zoedepth.weights.save import push_to_hub, save_model

__version__ = "0.1.0"

__all__ = [
    "DepthMap",
    "DepthModel",
    "DepthOutput",
    "InputError",
    "ModelConfig",
    "PanoramaMap",
    "Predictor",
    "ZoeDepth",
    "ZoeDepthError",
    "available_models",
    "build_model",
    "load_for_prediction",
    "load_model",
    "predict_panorama",
    "predict_tiled",
    "push_to_hub",
    "read_depth",
    "save_model",
]


moved.install()


def __getattr__(name: str) -> object:
    # Literal imports, so that type checkers and readers see what each name is.
    if name == "build_model":
        from zoedepth.build import build_model as value
    elif name == "ModelConfig":
        from zoedepth.config import ModelConfig as value
    elif name in ("InputError", "ZoeDepthError"):
        from zoedepth import errors

        value = getattr(errors, name)
    elif name in ("DepthModel", "DepthOutput"):
        from zoedepth.model import interface

        value = getattr(interface, name)
    elif name == "DepthMap":
        from zoedepth.depth_map import DepthMap as value
    elif name in ("PanoramaMap", "predict_panorama"):
        from zoedepth import panorama

        value = getattr(panorama, name)
    elif name == "predict_tiled":
        from zoedepth.tiles import predict_tiled as value
    elif name == "Predictor":
        from zoedepth.predict import Predictor as value
    elif name in ("available_models", "load_for_prediction", "load_model"):
        from zoedepth.weights import load

        value = getattr(load, name)
    elif name == "ZoeDepth":
        from zoedepth.weights.pretrained import ZoeDepth as value
    elif name in ("push_to_hub", "save_model"):
        from zoedepth.weights import save

        value = getattr(save, name)
    elif name == "read_depth":
        from zoedepth.stored import read_depth as value
    else:
        raise AttributeError(f"module 'zoedepth' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
