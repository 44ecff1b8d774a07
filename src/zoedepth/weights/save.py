"""Save a model in a file, or publish it at the Hugging Face Hub."""

import json
import tempfile
from pathlib import Path
from typing import Literal

import torch
from safetensors.torch import save

from zoedepth.config import to_dict
from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.model.interface import DepthModel
from zoedepth.provenance import require_licence
from zoedepth.weights.checkpoint import Checkpoint, write_checkpoint
from zoedepth.weights.hub import push_folder
from zoedepth.weights.layouts.keys import shown


def save_model(model: DepthModel, path: str | Path, *, dtype: torch.dtype = torch.float32) -> None:
    """Write weights, config and ``model.provenance`` into one ``.safetensors`` file, whole or not at all.

    ``zoedepth convert`` turns it into a folder, or into the layout of the original or of transformers.

    Args:
        model: any ZoeDepth or baseline.
        path: file to write.
        dtype: type of the floating-point weights in the file; they are loaded as float32.

    Raises:
        InputError: a weight is too large for the dtype.
    """
    state = model.state_dict()
    weights = {
        name: value.detach().cpu().to(dtype if value.is_floating_point() else value.dtype).contiguous()
        for name, value in state.items()
    }
    if too_large := [name for name in state if state[name].isfinite().all() > weights[name].isfinite().all()]:
        raise InputError(f"{shown(too_large)} has values too large for {dtype}: save the model as torch.float32")
    with atomic_path(Path(path)) as part:
        # safetensors' own save_file makes files that only their owner may read.
        texts = {"config": json.dumps(to_dict(model.config)), **model.provenance.to_texts()}
        content = save(weights, metadata=texts)
        length = int.from_bytes(content[:8], "little")
        header = json.loads(content[8 : 8 + length])
        # safetensors leaves the order of the texts to chance. The same model is to give the same file.
        header["__metadata__"] = texts
        start = json.dumps(header, separators=(",", ":")).encode()
        start += b" " * (-len(start) % 8)  # the weights begin at a multiple of 8 bytes
        with part.open("wb") as file:
            file.writelines((len(start).to_bytes(8, "little"), start, memoryview(content)[8 + length :]))


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
        repo_id: "owner/name"; the repository is made if it does not exist.
        to: layout; "huggingface" is for people who load the model with transformers.
        private: make a new repository private.
        licence: licence of the weights, as the Hub writes it: "mit", "cc-by-nc-4.0" ...; None: the model's own.

    Returns:
        The address of the model.

    Raises:
        InputError: there is no token, no permission or no network, the layout cannot hold this model, or nobody says
            under which licence the weights come.
    """
    require_licence(model.provenance.with_licence(licence))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model"
        write_checkpoint(checkpoint_of(model), path, to=to, name=repo_id, licence=licence)
        return push_folder(path, repo_id, private=private)


def checkpoint_of(model: DepthModel) -> Checkpoint:
    """Return a model as a checkpoint, ready for ``write_checkpoint``."""
    weights = {name: value.detach().cpu() for name, value in model.state_dict().items()}
    return Checkpoint(model.config, weights, "zoedepth", str, model.provenance)
