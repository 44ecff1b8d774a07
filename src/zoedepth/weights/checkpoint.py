"""Read checkpoints of any layout, recognised by their content, and write them in any layout, whole or not at all."""

import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, NamedTuple, get_args
from uuid import uuid4

import torch
from safetensors.torch import save_file
from torch import Tensor

from zoedepth.config import AnyModelConfig, ModelConfig, model_config_from_dict, to_dict
from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.provenance import MAX_TEXT, Provenance, from_card, from_texts
from zoedepth.stored import parse_json, read_json
from zoedepth.weights.card import model_card
from zoedepth.weights.exported import is_exported
from zoedepth.weights.hub import CARD, CONFIG, PREPROCESSOR, WEIGHTS
from zoedepth.weights.layouts import (
    adabins,
    bts,
    huggingface,
    huggingface_config,
    localbins,
    midas,
    newcrfs,
    original,
    pixelbins,
)
from zoedepth.weights.layouts.files import read_tensors
from zoedepth.weights.layouts.keys import Table, shown
from zoedepth.weights.releases import RELEASES

Layout = Literal["zoedepth", "original", "huggingface"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)


class Checkpoint(NamedTuple):
    """Config and weights of a file or folder, in our terms."""

    config: AnyModelConfig
    weights: dict[str, Tensor]
    """Our names → tensors, with the number types of the file."""
    layout: str
    """Layout it was read from: "zoedepth", "original", "midas", "huggingface", or a baseline's name."""
    name_in_file: Callable[[str], str]
    """Function from our name of a weight to the file's, for messages."""
    provenance: Provenance = Provenance()
    """Licence, training data and measured numbers, where the file, its folder or the list of releases tells them."""
    says_config: bool = False
    """True where a file whose layout has no place for a config holds ours all the same: one that was written here."""


def read_checkpoint(path: str | Path) -> Checkpoint:
    """Read config and weights of a file or folder of any known layout.

    The names of the weights tell the layout: our own, the original's, MiDaS's, those of transformers 4 or 5, or those
    of BTS, AdaBins, LocalBins, PixelBins and NeWCRFs. ``model_of`` checks later whether all weights are there and fit.

    Raises:
        InputError: there is no such file, it cannot be read, its layout is unknown, or its config is missing.
    """
    path = Path(path)
    if is_exported(path):
        raise InputError(f"{path} is an exported model, whose weights are in no layout: give what it was exported from")
    folder, file = (path, _weights_in(path)) if path.is_dir() else (path.parent, path)
    if not file.is_file():
        raise InputError(f"there is no file {file}")
    weights, texts = read_tensors(file)
    try:
        if path.is_dir() and huggingface.layout_of(weights) and not _config_of_transformers(folder):
            raise InputError(
                f"the folder has no {CONFIG} of transformers' ZoeDepth, which holds the kind of bins and their range: "
                "put it back, or give the file of weights alone if it is one of the three published ones"
            )
        checkpoint = _recognise(weights, texts, folder)
        return checkpoint._replace(provenance=_provenance(texts, path))
    except InputError as error:
        raise InputError(f"{file}: {str(error)[:2000]}") from error  # it may quote the file, of any length


def _provenance(texts: Mapping[str, str], path: Path) -> Provenance:
    """Return what the file says, else what is known of a release, else what the model card of a folder says."""
    found = from_texts(texts)
    if found != Provenance():
        return found
    for release in RELEASES.values():
        if release.present and release.path.samefile(path):
            return release.provenance
    if (path / CARD).is_file():
        with (path / CARD).open(encoding="utf-8", errors="replace") as card:
            return from_card(card.read(MAX_TEXT))
    return found


def _weights_in(folder: Path) -> Path:
    """Return the file of weights in a folder of ours or of transformers."""
    if (folder / WEIGHTS).is_file():
        return folder / WEIGHTS
    if (folder / f"{WEIGHTS}.index.json").is_file():
        raise InputError(f"{folder} holds a checkpoint in several files, which is not read: save it as one {WEIGHTS}")
    others = sorted(file.name for pattern in ("*.bin", "*.pt", "*.pth") for file in folder.glob(pattern))
    hint = f"; it has {shown(others)}: give the file itself" if others else ""
    raise InputError(f"{folder} has no {WEIGHTS}{hint}")


def _recognise(weights: dict[str, Tensor], texts: Mapping[str, str], folder: Path) -> Checkpoint:
    if layout := huggingface.layout_of(weights):
        config = _config_of_transformers(folder)
        preprocessor = _json_beside(folder, PREPROCESSOR, "size")
        return _translated(
            "huggingface", lambda: huggingface.read(weights, config, layout=layout, preprocessor=preprocessor)
        )
    if original.is_original(weights):
        found = _translated("original", lambda: original.read(weights))
        return found if "config" not in texts else _as_said(found, texts["config"])
    for layout, (is_theirs, read) in _BASELINES.items():
        if is_theirs(weights):
            return _translated(layout, lambda read=read: read(weights))
    if any(name.startswith("pretrained.") for name in weights):
        return _translated("midas", lambda: midas.read(weights))
    if "config" in texts:
        config = parse_json(texts["config"], "the config in its metadata")
        return Checkpoint(model_config_from_dict(config), weights, "zoedepth", str)
    if any(name.startswith("encoder.") for name in weights):
        if (config := _json_beside(folder, CONFIG, "zoedepth")) is None:
            raise InputError(
                "there is no ZoeDepth config in its metadata, nor in a config.json beside it: save the model with "
                "zoedepth.save_model, which writes one"
            )
        return Checkpoint(model_config_from_dict(config["zoedepth"]), weights, "zoedepth", str)
    raise InputError(
        "these are not the weights of a known model. Known are ours, the original's, MiDaS's DPT-BEiT, transformers' "
        f"and those of the baselines {sorted(_BASELINES)}. The first names in this file are "
        f"{shown(list(weights), limit=3)}"
    )


_BASELINES = {
    "bts": (bts.is_bts, bts.read),
    "adabins": (adabins.is_adabins, adabins.read),
    "localbins": (localbins.is_localbins, localbins.read),
    "pixelbins": (pixelbins.is_pixelbins, pixelbins.read),
    "newcrfs": (newcrfs.is_newcrfs, newcrfs.read),
}
"""Name of a system → the functions that recognise and read its checkpoints."""


def _translated(layout: str, read: Callable[[], tuple[AnyModelConfig, dict[str, Tensor], Table]]) -> Checkpoint:
    config, weights, table = read()
    return Checkpoint(config, weights, layout, lambda name: "/".join(table.theirs(name)) or name)


def _as_said(found: Checkpoint, config: str) -> Checkpoint:
    """Return a checkpoint in the original's layout with the config that was written beside its weights.

    Shapes do not tell its domains, their ranges and cameras, and the size.
    """
    said = model_config_from_dict(parse_json(config, "the config beside its weights"))
    return found._replace(config=said, says_config=True)


def _json_beside(folder: Path, name: str, key: str) -> dict | None:
    """Read a JSON file beside the weights. None if it is missing or lacks ``key``: it may belong to something else."""
    if not (folder / name).is_file():
        return None
    values = read_json(folder / name)
    return values if key in values else None


def _config_of_transformers(folder: Path) -> dict | None:
    """Read the config.json beside weights of transformers. None if it is missing, or of another kind of model."""
    values = _json_beside(folder, CONFIG, "model_type")
    return values if values is not None and values["model_type"] == "zoedepth" else None


# --- writing ----------------------------------------------------------------------------------------------------------


def write_checkpoint(
    checkpoint: Checkpoint, path: str | Path, *, to: Layout, name: str = "ZoeDepth", licence: str | None = None
) -> Path:
    """Write a checkpoint in a layout, whole or not at all. The weights keep their bits and their types.

    Args:
        checkpoint: see ``read_checkpoint``.
        path: file (``.pt``) for "original"; folder or file (``.safetensors``) for "zoedepth"; folder for "huggingface".
            A folder gets config, weights and a model card.
        to: layout to write.
        name: title of the model card.
        licence: licence of the weights, for the file and the card; None: that of the checkpoint.

    Raises:
        InputError: the layout cannot hold this model, the suffix belongs to another layout, the folder exists, or the
            licence drops that the weights are non-commercial.
    """
    path, (config, weights, *_) = Path(path), checkpoint
    check_target(path, to=to)
    provenance = checkpoint.provenance.with_licence(licence)
    if to == "original":
        theirs = original.write(_zoedepth(config, to), weights)
        with atomic_path(path) as part:
            # Only this package reads what is "about" the weights.
            about = {"config": json.dumps(to_dict(config)), **provenance.to_texts()}
            torch.save({"model": theirs, "optimizer": None, "epoch": 0, "about": about}, part)
        return path
    if to == "zoedepth" and path.suffix == ".safetensors":
        with atomic_path(path) as part:
            _save(weights, part, config, provenance)
        return path
    if to == "huggingface":
        model = _zoedepth(config, to)
        theirs = huggingface.write(model, weights)
        texts = {
            CONFIG: huggingface_config.to_json(model, weights),
            PREPROCESSOR: huggingface_config.preprocessor_json(model),
        }
    else:
        theirs, texts = weights, {CONFIG: {"library_name": "zoedepth", "zoedepth": to_dict(config)}}
    with _new_folder(path) as part:
        _save(theirs, part / WEIGHTS, config if to == "zoedepth" else None, provenance)
        for file, values in texts.items():
            (part / file).write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
        card = model_card(
            config, name=name, layout=to, licence=provenance.licence, trained_on=provenance.trained_on,
            metrics=provenance.measured,
        )  # fmt: skip
        (part / CARD).write_text(card, encoding="utf-8")
    return path


def check_target(path: Path, *, to: Layout) -> None:
    """Refuse names that a layout cannot be written to, before anything is read.

    Raises:
        InputError: the suffix belongs to another layout, or the folder exists.
    """
    file = to == "original" or (to == "zoedepth" and path.suffix == ".safetensors")
    if to == "original" and path.suffix not in (".pt", ".pth"):
        raise InputError(f"{path}: the original's layout is a file: give a name that ends with .pt")
    if not file and path.suffix in (".pt", ".pth", ".safetensors"):
        raise InputError(f"{path}: the {to} layout is a folder: give a name that does not end with {path.suffix}")
    # Neither the folder we are in (its path "." has no name) nor a link is replaced.
    if not file and (
        path.is_symlink() or (path.exists() and (not path.name or not path.is_dir() or any(path.iterdir())))
    ):
        raise InputError(f"{path} is there already: give another name, or remove it first")


def _zoedepth(config: AnyModelConfig, to: Layout) -> ModelConfig:
    if not isinstance(config, ModelConfig):
        raise InputError(f"the {to} layout cannot hold baselines: write the zoedepth layout")
    return config


def _save(weights: Mapping[str, Tensor], path: Path, config: AnyModelConfig | None, provenance: Provenance) -> None:
    # transformers demands "format". Our config goes into the header, so that the file is enough by itself.
    texts = {"format": "pt", **({} if config is None else {"config": json.dumps(to_dict(config))})}
    texts |= provenance.to_texts()
    # safetensors takes contiguous tensors that share no memory.
    seen: set[int] = set()
    apart = {}
    for name, value in weights.items():
        storage = value.untyped_storage().data_ptr()
        lone = value.is_contiguous() and storage not in seen
        apart[name] = value if lone else value.clone(memory_format=torch.contiguous_format)
        seen.add(storage)
    path.touch()
    mode = path.stat().st_mode
    save_file(apart, path, metadata=texts)
    path.chmod(mode)  # safetensors makes files that only their owner may read


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """Give a temporary folder that becomes ``path`` at the end, or vanishes when something fails."""
    part = path.with_name(f".{path.name}.{uuid4().hex[:8]}.part")
    part.mkdir(parents=True)
    try:
        yield part
        if path.is_dir():
            path.rmdir()  # empty
        part.rename(path)
    except BaseException:  # also Ctrl-C: the part goes, the error stays
        shutil.rmtree(part, ignore_errors=True)
        raise
