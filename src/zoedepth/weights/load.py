"""Models by name, file, folder or Hugging Face id."""

import json
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import torch
from safetensors.torch import save
from torch import Tensor

from zoedepth.build import build_model, channels_last
from zoedepth.config import ModelConfig, to_dict
from zoedepth.download import download
from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.model.interface import DepthModel
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import PRESETS, with_compat
from zoedepth.weights.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from zoedepth.weights.exported import Precision, is_exported, load_exported
from zoedepth.weights.hub import cached, fetch, is_hub_id, push_folder
from zoedepth.weights.layouts.keys import shown
from zoedepth.weights.releases import RELEASES


def available_models() -> list[str]:
    """Names that ``load_model`` can load without being given a file; all but the first kind are fetched once.

    ``zoedepth models`` says what each is, how large, under which licence, and whether it is on this machine.
    """
    return sorted(RELEASES, key=lambda name: (RELEASES[name].url is not None, name))


def load_model(
    name_or_path: str | Path, *, compat: Iterable[str] = (), precision: Precision = "float32", streams: int = 1
) -> DepthModel:
    """Load a model with its weights, in evaluation mode, float32, on the CPU.

    Args:
        name_or_path: a name of ``available_models``; a file or folder, recognised by its content: ours, the
            original's ``ZoeD_M12_{N,K,NK}.pt``, MiDaS's ``dpt_beit_large_384.pt``, transformers' of either kind of
            names, the checkpoints of BTS, AdaBins, LocalBins, PixelBins and NeWCRFs; or a Hugging Face id,
            ``"Intel/zoedepth-nyu-kitti"``.
            Or a file that ``zoedepth export`` wrote, .onnx or .xml, which runs in its own runtime.
        compat: behaviours of the released code to take over, see ``presets.COMPAT``.
        precision: of an OpenVINO file: what it computes in.
        streams: of an OpenVINO file: how many forwards will run at the same time.

    Raises:
        InputError: there is no such model, it cannot be fetched, or its file is damaged, unsafe or does not fit; or
            behaviours are chosen for an exported file, which has its own.
        MissingExtraError: the runtime of an exported file is not installed.
    """
    if is_exported(name_or_path):
        if tuple(compat):
            raise InputError("an exported model has its behaviours built in: give --compat to zoedepth export")
        return load_exported(name_or_path, precision=precision, streams=streams)
    path = find(name_or_path)
    return model_of(read_checkpoint(path), source=path, compat=compat)


def load_zoedepth(name_or_path: str | Path) -> ZoeDepth:
    """Load a ZoeDepth, as ``load_model`` does, and nothing else: ``ZoeDepth.from_pretrained``.

    Raises:
        InputError: see ``load_model``; or it is an exported file or one of the baselines.
    """
    model = load_model(name_or_path)
    if not isinstance(model, ZoeDepth):
        raise InputError(f"{name_or_path} is no ZoeDepth but {type(model).__name__}: use zoedepth.load_model")
    return model


ZoeDepth.from_pretrained = staticmethod(load_zoedepth)


def find(name_or_path: str | Path) -> Path:
    """The file or folder of a model; what is published and not on this machine is fetched first.

    Raises:
        InputError: there is no such model, or it cannot be fetched.
    """
    name, path = str(name_or_path), Path(name_or_path)
    if isinstance(name_or_path, str) and name in RELEASES:
        release = RELEASES[name]
        if release.url is None:
            return release.path
        if not release.present and release.hub_id and cached(release.hub_id):
            return fetch(release.hub_id)  # the same weights are here already
        return download(release.url, release.path, name=name)
    if os.path.exists(path):  # Path.exists raises for a name that is too long for a file
        return path
    if name in PRESETS:
        raise InputError(
            f"{name} is a model of the paper whose weights nobody published; its architecture is "
            f"zoedepth.presets.PRESETS[{name!r}]. Give a file of weights, or one of {available_models()}"
        )
    if isinstance(name_or_path, str) and is_hub_id(name):
        return fetch(name)
    looks_like_path = os.sep in name or path.suffix
    problem = f"there is no file {name}" if looks_like_path else f"there is no model named {name!r}"
    raise InputError(
        f"{problem}; known models are {available_models()}, or give a file, a folder or a Hugging Face id (owner/name)"
    )


def model_of(checkpoint: Checkpoint, *, source: str | Path, compat: Iterable[str] = ()) -> DepthModel:
    """The model of a checkpoint, in evaluation mode, float32. Its weights are the checkpoint's own, not copies.

    Args:
        checkpoint: see ``read_checkpoint``.
        source: name of it, for messages.
        compat: see ``load_model``.

    Raises:
        InputError: weights are missing, unknown, of the wrong shape or not finite, or the config makes no model.
    """
    config, weights, _, name_in_file = checkpoint
    if ":" in config.encoder_name:  # timm fetches names with a colon from anywhere
        raise InputError(f"the config in {source} makes no model: encoder {config.encoder_name[:80]!r}")
    if isinstance(config, ModelConfig):
        encoder = config.encoder
        # A config may ask for any number of blocks; each has weights of its own.
        if sum(encoder.depth or ()) + len(config.domains) > len(weights):
            raise InputError(f"the config in {source} makes no model of {len(weights)} weights")
        if min(encoder.taps, default=0) < 0:
            raise InputError(f"the config in {source} makes no model: taps {encoder.taps}")
    config = with_compat(config, compat)
    try:
        with torch.device("meta"):  # shapes without memory
            model = build_model(config)
    except (
        ValueError,
        RuntimeError,
        TypeError,
        LookupError,
        ArithmeticError,
        AssertionError,
    ) as error:  # timm has many
        reason = str(error).partition("\n")[0][:500]  # torch adds where in its C++ it was
        raise InputError(f"the config in {source} makes no model: {reason}") from error
    problems = misfits(model.state_dict(), weights)
    if problems:
        texts = [f"{problem} {_printable(name_in_file(name))}{details}" for problem, name, details in problems]
        listed = "; ".join(sorted(texts)[:8]) + ("; ..." if len(texts) > 8 else "")
        raise InputError(f"the weights in {source} do not fit their config ({len(texts)} problems): {listed}")
    floats = {name: value.float() if value.is_floating_point() else value for name, value in weights.items()}
    if broken := [name_in_file(name) for name, value in floats.items() if not value.isfinite().all()]:
        raise InputError(f"the weights in {source} are not finite: {shown(broken)}")
    model.load_state_dict(floats, assign=True)
    return channels_last(_with_buffers(model)).eval()


def misfits(expected: dict[str, Tensor], weights: dict[str, Tensor]) -> list[tuple[str, str, str]]:
    """What keeps weights from being a model's: the problem, our name of the weight, details."""
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
"""Two numbers in a byte, which torch (from 2.8) stores and cannot convert."""


def _printable(name: str) -> str:
    """A name that may come from anyone, for messages."""
    return name[:120].encode("unicode_escape").decode()


def _with_buffers(model: DepthModel) -> DepthModel:
    """Fill the buffers that no checkpoint holds: the model was built without memory."""
    lost = {name: buffer for name, buffer in model.named_buffers() if buffer.is_meta}
    modules = {name.rpartition(".")[0] for name in lost}
    for name, buffer in lost.items():
        parent, _, attribute = name.rpartition(".")
        setattr(model.get_submodule(parent), attribute, torch.empty_like(buffer, device="cpu"))
    for name in modules:
        module: Any = model.get_submodule(name)
        module.init_non_persistent_buffers()  # timm's method, and our LogBinomial's
    return model


def save_model(model: DepthModel, path: str | Path, *, dtype: torch.dtype = torch.float32) -> None:
    """Write weights and config into one ``.safetensors`` file, whole or not at all.

    ``zoedepth convert`` makes a folder of it, or the layout of the original or of transformers.

    Args:
        model: any ZoeDepth or baseline.
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


def push_to_hub(
    model: DepthModel,
    repo_id: str,
    *,
    to: Literal["zoedepth", "huggingface"] = "zoedepth",
    private: bool = False,
    licence: str | None = None,
) -> str:
    """Publish a model at the Hugging Face Hub: config, weights and a model card, in one commit.

    Args:
        model: any ZoeDepth or baseline.
        repo_id: "owner/name"; made if it is not there.
        to: layout; "huggingface" is for people who load it with transformers.
        private: for a repository that is made.
        licence: of the weights, as the Hub writes it: "mit", "cc-by-nc-4.0" ...; None: not stated.

    Returns:
        Its address.

    Raises:
        InputError: no token, no permission, no network, or the layout has no such model.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model"
        write_checkpoint(checkpoint_of(model), path, to=to, name=repo_id, licence=licence)
        return push_folder(path, repo_id, private=private)


def checkpoint_of(model: DepthModel) -> Checkpoint:
    """A model as a checkpoint, ready for ``write_checkpoint``."""
    weights = {name: value.detach().cpu() for name, value in model.state_dict().items()}
    return Checkpoint(model.config, weights, "zoedepth", str)
