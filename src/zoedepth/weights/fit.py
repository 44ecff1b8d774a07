"""Put the weights of a checkpoint into the network of its config."""

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from zoedepth.build import build_model, channels_last, without_memory
from zoedepth.config import INDOOR, AdaBinsConfig, AnyModelConfig, ModelConfig, NewCrfsConfig
from zoedepth.errors import InputError, InputWarning
from zoedepth.model.interface import DepthModel
from zoedepth.model.linear import products_are_slow
from zoedepth.presets import PRESETS, with_compat
from zoedepth.weights.checkpoint import Checkpoint
from zoedepth.weights.layouts.keys import shown
from zoedepth.weights.releases import RELEASES

_WITHOUT_RANGE = ("adabins", "bts", "localbins", "newcrfs")
"""Layouts of checkpoints whose depth is a share of a range that they do not name."""


def model_of(checkpoint: Checkpoint, *, source: str | Path, compat: Iterable[str] = ()) -> DepthModel:
    """Build the model of a checkpoint, in evaluation mode, float32. It takes over the checkpoint's tensors.

    Args:
        checkpoint: see ``read_checkpoint``.
        source: name of the checkpoint, for messages.
        compat: see ``load_model``.

    Warns:
        InputWarning: it is a baseline's checkpoint, which does not name its range, or one of the original's layout that
            is no released model, which does not name its data.

    Raises:
        InputError: weights are missing, unknown, of the wrong shape or not finite, or the config makes no model.
    """
    config, weights, _, name_in_file, provenance, _ = checkpoint
    _refuse_strange(config, len(weights), source)
    compat = tuple(compat)
    guessed = checkpoint.layout == "original" and not checkpoint.says_config
    if "80m" not in compat and guessed and _is_taken_for_nyus(config, Path(source).name):
        warnings.warn(
            f"{source} does not say which data it was trained on, and NYU is taken, with its 10 m and its camera. If "
            "it was trained on KITTI, give compat=['80m'] (--compat 80m). zoedepth convert writes either into a file",
            InputWarning,
            stacklevel=2,
        )
    if checkpoint.layout in _WITHOUT_RANGE and "80m" not in compat and config.domains == (INDOOR,):
        warnings.warn(
            f"{source} does not say how far its depth reaches, and 10 m is taken, as for NYU. If it was trained on "
            "KITTI, its depth comes out 8 times too near: give compat=['80m'] (--compat 80m). zoedepth convert writes "
            "either into a file",
            InputWarning,
            stacklevel=2,
        )
    config = with_compat(config, compat)
    products_are_slow()  # a wrong setting of it is said here, or the config would be blamed for it below
    try:
        with without_memory():
            model = build_model(config)
    except (
        ValueError,
        RuntimeError,
        TypeError,
        LookupError,
        ArithmeticError,
        AssertionError,
    ) as error:  # timm raises all of these
        reason = str(error).partition("\n")[0][:500]  # torch adds where in its C++ it was
        raise InputError(f"the config in {source} makes no model: {reason}") from error
    problems = misfits(model.state_dict(), weights)
    if problems:
        texts = [f"{problem} {_printable(name_in_file(name))}{details}" for problem, name, details in problems]
        listed = "; ".join(sorted(texts)[:8]) + ("; ..." if len(texts) > 8 else "")
        raise InputError(f"the weights in {source} do not fit their config ({len(texts)} problems): {listed}")
    floats = {name: value.float() if value.is_floating_point() else value for name, value in weights.items()}
    if broken := [name_in_file(name) for name, value in floats.items() if not value.isfinite().all()]:
        raise InputError(f"the weights in {source} are not finite: {shown(broken)}. Use another file")
    model.load_state_dict(floats, assign=True)
    model.provenance = provenance
    return channels_last(_with_buffers(model)).eval()


def _is_taken_for_nyus(config: AnyModelConfig, file: str) -> bool:
    """Return True for one head of NYU's that is not the released ZoeD-N by its shapes and its name: nothing says it."""
    known, released = PRESETS["zoed-m12-n"], RELEASES["zoed-m12-n"].file
    taken = isinstance(config, ModelConfig) and config.domains == known.domains
    return taken and (config != known or file != released)


def _refuse_strange(config: AnyModelConfig, n_weights: int, source: str | Path) -> None:
    """Refuse configs that would make timm download something, or build for minutes."""
    if ":" in config.encoder_name:  # timm fetches names with a colon from anywhere
        raise InputError(f"the config in {source} makes no model: encoder {config.encoder_name[:80]!r}")
    if isinstance(config, ModelConfig):
        encoder = config.encoder
        # A config may ask for any number of blocks, and every block has weights of its own.
        n_blocks = sum(encoder.depth or ()) + len(config.domains)
        if isinstance(config.head, NewCrfsConfig):
            n_blocks += config.head.n_blocks
        if isinstance(config.head, AdaBinsConfig):
            n_blocks += config.head.n_layers
        if n_blocks > n_weights:
            raise InputError(f"the config in {source} makes no model of {n_weights} weights")
        if min(encoder.taps, default=0) < 0:
            raise InputError(f"the config in {source} makes no model: taps {encoder.taps}")


def misfits(expected: dict[str, Tensor], weights: dict[str, Tensor]) -> list[tuple[str, str, str]]:
    """Return the weights that do not fit a model: for each the problem, our name of the weight, and details."""
    problems = [("missing", name, "") for name in expected.keys() - weights.keys()]
    problems += [("unknown", name, "") for name in weights.keys() - expected.keys()]
    for name in expected.keys() & weights.keys():
        shape, found = tuple(expected[name].shape), tuple(weights[name].shape)
        if shape != found:
            problems.append(("misshapen", name, f" is {found}, not {shape}"))
        elif expected[name].is_floating_point() != weights[name].is_floating_point() or weights[name].dtype == _PACKED:
            problems.append(("mistyped", name, f" is {weights[name].dtype}"))
    return problems


_PACKED = getattr(torch, "float4_e2m1fn_x2", None)
"""Type with two numbers in a byte. torch (from 2.8) stores it but cannot convert it."""


def _printable(name: str) -> str:
    """Cut and escape a name for messages: it may come from anyone."""
    return name[:120].encode("unicode_escape").decode()


def _with_buffers(model: DepthModel) -> DepthModel:
    """Fill the buffers that no checkpoint holds. They are empty, because the model was built without memory."""
    lost = {name: buffer for name, buffer in model.named_buffers() if buffer.is_meta}
    modules = {name.rpartition(".")[0] for name in lost}
    for name, buffer in lost.items():
        parent, _, attribute = name.rpartition(".")
        dtype = torch.float32 if buffer.is_floating_point() else buffer.dtype  # whatever torch's default is
        setattr(model.get_submodule(parent), attribute, torch.empty_like(buffer, device="cpu", dtype=dtype))
    for name in modules:
        module: Any = model.get_submodule(name)
        module.init_non_persistent_buffers()  # timm's method, and our LogBinomial's
    return model
