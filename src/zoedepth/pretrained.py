"""Models by name or file: weights in safetensors, with the config they belong to beside them."""

import json
import os
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from zoedepth.config import ModelConfig, from_dict, to_dict
from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import PRESETS

ASSETS = Path(__file__).parent / "assets"
SHIPPED = {"zoed-lite": ASSETS / "zoed-lite.safetensors"}
"""Models whose weights are in the package."""


def available_models() -> list[str]:
    """Names that :func:`load_model` can load without being given a file."""
    return sorted(SHIPPED)


def load_model(name_or_path: str | Path) -> ZoeDepth:
    """A model with its weights, in evaluation mode, float32, on the CPU.

    Args:
        name_or_path: a name of :func:`available_models`, a ``.safetensors`` file written by :func:`save_model`, or a
            folder with a ``model.safetensors``.

    Raises:
        InputError: the name is unknown, or the file is missing, damaged, without config, or does not fit its config.
    """
    path = _find(name_or_path)
    try:
        with safe_open(str(path), framework="pt") as file:
            metadata = file.metadata() or {}
            weights = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118  # not a dict
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path} is not a readable safetensors file ({error})") from error
    if "config" not in metadata:
        raise InputError(f"{path} has no ZoeDepth config in its metadata; write models with zoedepth.save_model")
    try:
        config = from_dict(ModelConfig, json.loads(metadata["config"]), where="config")
        model = ZoeDepth(config)
    except (ValueError, RuntimeError, TypeError, IndexError, AssertionError) as error:  # timm has many
        raise InputError(f"the config in {path} makes no model: {error}") from error
    _load_strictly(model, weights, path)
    return model.eval()


def save_model(model: ZoeDepth, path: str | Path, *, dtype: torch.dtype = torch.float32) -> None:
    """Write weights and config into one ``.safetensors`` file, whole or not at all.

    Args:
        model: any ZoeDepth.
        path: file to write.
        dtype: of the floating-point weights in the file; they are loaded as float32.

    Raises:
        InputError: a weight is too large for the dtype.
    """
    weights = {
        name: value.detach().cpu().to(dtype if value.is_floating_point() else value.dtype).contiguous()
        for name, value in model.state_dict().items()
    }
    state = model.state_dict()
    if too_large := [name for name in state if state[name].isfinite().all() > weights[name].isfinite().all()]:
        raise InputError(f"{too_large} have values too large for {dtype}; save the model as torch.float32")
    with atomic_path(Path(path)) as part:
        # Not safetensors' save_file, whose files only their owner may read.
        part.write_bytes(save(weights, metadata={"config": json.dumps(to_dict(model.config))}))


def _find(name_or_path: str | Path) -> Path:
    name = str(name_or_path)
    if name in SHIPPED:
        return SHIPPED[name]
    path = Path(name_or_path)
    if path.is_dir():
        path = path / "model.safetensors"
    if path.is_file():
        return path
    if name in PRESETS:
        raise InputError(
            f"{name} is a model of the paper without weights in this package; its architecture is "
            f"zoedepth.presets.PRESETS[{name!r}]. Give a file of weights, or one of {available_models()}"
        )
    looks_like_path = os.sep in name or path.suffix
    problem = f"there is no file {name}" if looks_like_path else f"there is no model named {name!r}"
    raise InputError(f"{problem}; known models are {available_models()}, or give a .safetensors file")


def _load_strictly(model: ZoeDepth, weights: dict[str, torch.Tensor], path: Path) -> None:
    """Load, naming what does not fit."""
    expected = {name: tuple(value.shape) for name, value in model.state_dict().items()}
    found = {name: tuple(value.shape) for name, value in weights.items()}
    problems = [f"missing {name}" for name in expected.keys() - found.keys()]
    problems += [f"unknown {name}" for name in found.keys() - expected.keys()]
    problems += [
        f"{name} is {found[name]}, not {expected[name]}"
        for name in expected.keys() & found.keys()
        if found[name] != expected[name]
    ]
    broken = [name for name, value in weights.items() if not value.isfinite().all()]
    problems += [f"{name} has values that are not finite" for name in broken]
    if problems:
        shown = "; ".join(sorted(problems)[:8]) + ("; ..." if len(problems) > 8 else "")
        raise InputError(f"the weights in {path} do not fit their config ({len(problems)} problems): {shown}")
    model.load_state_dict(weights)
