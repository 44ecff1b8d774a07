"""``torch.hub`` entry points, with the names and arguments of isl-org/ZoeDepth.

    model = torch.hub.load("REPO", "ZoeD_NK", pretrained=True)
    depth = model.infer_pil(Image.open("photo.jpg"))  # float32 (height, width), metres

REPO is a checkout of this repository (``source="local"``) or its GitHub name. Only the weights are downloaded.
"""

import sys
from pathlib import Path

dependencies = ["torch", "torchvision", "timm", "numpy", "PIL", "safetensors", "jaxtyping", "filelock"]

try:
    import zoedepth.torchhub as _torchhub
except ImportError:  # a checkout that is not installed
    sys.path.insert(0, str(Path(__file__).parent / "src"))
    import zoedepth.torchhub as _torchhub


def ZoeD_N(  # the original's name
    pretrained: bool | str = False,
    midas_model_type: str = "DPT_BEiT_L_384",
    config_mode: str = "infer",
    compat: tuple[str, ...] = (),
    **options: object,
) -> "_torchhub.OriginalInterface":
    """Indoor: one head, fine-tuned on NYU Depth v2.

    Args:
        pretrained: True for the released weights (1.4 GB, downloaded once), a path or url, or False for random weights.
        midas_model_type: encoder; the released weights are for "DPT_BEiT_L_384".
        config_mode: "infer" keeps the photo's proportions, "eval" and "train" squeeze it to 384x512.
        compat: behaviours of the original to take over: ("squeeze",), see zoedepth.presets.COMPAT.
        options: further options of the original; those that would change the network are refused.
    """
    _torchhub.check_options(options, config_mode=config_mode)
    return _torchhub.build(
        "zoed-m12-n",
        pretrained=pretrained,
        midas_model_type=midas_model_type,
        config_mode=config_mode,
        compat=tuple(compat),
    )


def ZoeD_K(
    pretrained: bool | str = False,
    midas_model_type: str = "DPT_BEiT_L_384",
    config_mode: str = "infer",
    compat: tuple[str, ...] = (),
    **options: object,
) -> "_torchhub.OriginalInterface":
    """Driving: one head, fine-tuned on KITTI, up to 80 m. compat=("10m",) gives the 10 m of the original's entry point.

    Args:
        pretrained: True for the released weights (1.4 GB, downloaded once), a path or url, or False for random weights.
        midas_model_type: encoder; the released weights are for "DPT_BEiT_L_384".
        config_mode: "infer" keeps the photo's proportions, "eval" and "train" squeeze it to 384x768.
        compat: behaviours of the original to take over: ("10m", "squeeze"), see zoedepth.presets.COMPAT.
        options: further options of the original; those that would change the network are refused.
    """
    _torchhub.check_options(options, config_mode=config_mode)
    return _torchhub.build(
        "zoed-m12-k",
        pretrained=pretrained,
        midas_model_type=midas_model_type,
        config_mode=config_mode,
        compat=tuple(compat),
    )


def ZoeD_NK(
    pretrained: bool | str = False,
    midas_model_type: str = "DPT_BEiT_L_384",
    config_mode: str = "infer",
    compat: tuple[str, ...] = (),
    **options: object,
) -> "_torchhub.OriginalInterface":
    """Indoor and driving: two heads and a router, which gives every photo of a batch its own head.

    Args:
        pretrained: True for the released weights (1.4 GB, downloaded once), a path or url, or False for random weights.
        midas_model_type: encoder; the released weights are for "DPT_BEiT_L_384".
        config_mode: "infer" keeps the photo's proportions, "eval" and "train" squeeze it to 384x512.
        compat: behaviours of the original to take over: ("batch-vote", "squeeze"), see zoedepth.presets.COMPAT.
        options: further options of the original; those that would change the network are refused.
    """
    _torchhub.check_options(options, config_mode=config_mode)
    return _torchhub.build(
        "zoed-m12-nk",
        pretrained=pretrained,
        midas_model_type=midas_model_type,
        config_mode=config_mode,
        compat=tuple(compat),
    )
