"""A checkpoint in any layout, recognised by its content; and its writing in any layout, whole or not at all."""

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
from zoedepth.weights.card import model_card
from zoedepth.weights.layouts import adabins, bts, huggingface, localbins, midas, newcrfs, original, pixelbins
from zoedepth.weights.layouts.files import parse_json, read_json, read_tensors
from zoedepth.weights.layouts.keys import Table, shown

Layout = Literal["zoedepth", "original", "huggingface"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)

WEIGHTS, CONFIG, PREPROCESSOR, CARD = "model.safetensors", "config.json", "preprocessor_config.json", "README.md"


class Checkpoint(NamedTuple):
    """What a file or folder of weights holds, in our terms."""

    config: AnyModelConfig
    weights: dict[str, Tensor]
    """Under our names, of the file's types."""
    layout: str
    """"zoedepth", "original", "midas", "huggingface", or a baseline's name: who wrote it."""
    name_in_file: Callable[[str], str]
    """One of our names → how the file calls it, for messages."""


def read_checkpoint(path: str | Path) -> Checkpoint:
    """Config and weights of a file or folder of any known layout.

    The layout is told by the names of the weights: our own, the original's, MiDaS's, those of transformers 4 or 5,
    those of BTS, AdaBins, LocalBins, PixelBins and NeWCRFs.
    Whether all weights are there and fit is for the one who builds the model to say.

    Raises:
        InputError: nothing is there, it cannot be read, it is of no known layout, or of one without its config.
    """
    path = Path(path)
    folder, file = (path, _weights_in(path)) if path.is_dir() else (path.parent, path)
    if not file.is_file():
        raise InputError(f"there is no file {file}")
    weights, texts = read_tensors(file)
    try:
        if path.is_dir() and huggingface.layout_of(weights) and not _json_beside(folder, CONFIG, "model_type"):
            raise InputError(
                f"the folder has no {CONFIG} of transformers, which says the kind of bins and their range: put it "
                "back, or give the file of weights alone if it is one of the three that were published"
            )
        return _recognise(weights, texts, folder)
    except InputError as error:
        raise InputError(f"{file}: {str(error)[:2000]}") from error  # it may quote the file, of any length


def _weights_in(folder: Path) -> Path:
    """The file of weights in a folder of ours or of transformers."""
    if (folder / WEIGHTS).is_file():
        return folder / WEIGHTS
    if (folder / f"{WEIGHTS}.index.json").is_file():
        raise InputError(f"{folder} holds a checkpoint in several files: save it as one {WEIGHTS}")
    others = sorted(file.name for pattern in ("*.bin", "*.pt", "*.pth") for file in folder.glob(pattern))
    hint = f"; it has {shown(others)}: give the file itself" if others else ""
    raise InputError(f"{folder} has no {WEIGHTS}{hint}")


def _recognise(weights: dict[str, Tensor], texts: Mapping[str, str], folder: Path) -> Checkpoint:
    if layout := huggingface.layout_of(weights):
        config = _json_beside(folder, CONFIG, "model_type")
        preprocessor = _json_beside(folder, PREPROCESSOR, "size")
        return _translated(
            "huggingface", lambda: huggingface.read(weights, config, layout=layout, preprocessor=preprocessor)
        )
    if original.is_original(weights):
        return _translated("original", lambda: original.read(weights))
    for layout, (is_theirs, read) in _BASELINES.items():
        if is_theirs(weights):
            return _translated(layout, lambda read=read: read(weights))
    if any(name.startswith("pretrained.") for name in weights):
        return _translated("midas", lambda: midas.read(weights))
    if "config" in texts:
        return Checkpoint(_config(texts["config"]), weights, "zoedepth", str)
    if any(name.startswith("encoder.") for name in weights):
        if (config := _json_beside(folder, CONFIG, "zoedepth")) is None:
            raise InputError(
                "there is no ZoeDepth config in its metadata, nor in a config.json beside it; "
                "write models with zoedepth.save_model"
            )
        return Checkpoint(model_config_from_dict(config["zoedepth"]), weights, "zoedepth", str)
    raise InputError(
        "these are the weights of no ZoeDepth: its own, the original's, MiDaS's DPT-BEiT, transformers' and those of "
        f"the baselines {sorted(_BASELINES)} are known. "
        f"The first names: {shown(list(weights), limit=3)}"
    )


_BASELINES = {
    "bts": (bts.is_bts, bts.read),
    "adabins": (adabins.is_adabins, adabins.read),
    "localbins": (localbins.is_localbins, localbins.read),
    "pixelbins": (pixelbins.is_pixelbins, pixelbins.read),
    "newcrfs": (newcrfs.is_newcrfs, newcrfs.read),
}
"""The checkpoints of other systems: how each is recognised, and read."""


def _translated(layout: str, read: Callable[[], tuple[AnyModelConfig, dict[str, Tensor], Table]]) -> Checkpoint:
    config, weights, table = read()
    return Checkpoint(config, weights, layout, lambda name: "/".join(table.theirs(name)) or name)


def _json_beside(folder: Path, name: str, key: str) -> dict | None:
    """A JSON file in the folder of the weights, if it is there and about this: a folder may hold other things."""
    if not (folder / name).is_file():
        return None
    values = read_json(folder / name)
    return values if key in values else None


def _config(text: str) -> AnyModelConfig:
    try:
        values = parse_json(text)
    except InputError as error:
        raise InputError(f"the config in its metadata makes no model: {error}") from error
    return model_config_from_dict(values)


# --- writing ----------------------------------------------------------------------------------------------------------


def write_checkpoint(
    checkpoint: Checkpoint, path: str | Path, *, to: Layout, name: str = "ZoeDepth", licence: str | None = None
) -> Path:
    """Write a checkpoint in a layout, whole or not at all. The weights keep their bits and their types.

    Args:
        checkpoint: see ``read_checkpoint``.
        path: for "original" a file (``.pt``); for "zoedepth" a folder, or a file (``.safetensors``); for "huggingface"
            a folder. A folder gets config, weights and a model card.
        to: the layout.
        name: title of the model card.
        licence: of the weights, for the card; None: not stated.

    Raises:
        InputError: the layout has no such model, the suffix is of another layout, or the folder is there already.
    """
    path, (config, weights, *_) = Path(path), checkpoint
    if to == "original":
        if path.suffix not in (".pt", ".pth"):
            raise InputError(f"{path}: the original's layout is a file; give a name that ends with .pt")
        theirs = original.write(_zoedepth(config, to), weights)
        with atomic_path(path) as part:
            torch.save({"model": theirs, "optimizer": None, "epoch": 0}, part)
        return path
    if to == "zoedepth" and path.suffix == ".safetensors":
        with atomic_path(path) as part:
            _save(weights, part, config)
        return path
    if path.suffix in (".pt", ".pth", ".safetensors"):
        raise InputError(f"{path}: the {to} layout is a folder, whose name must not end with {path.suffix}")
    if to == "huggingface":
        model = _zoedepth(config, to)
        theirs = huggingface.write(model, weights)
        texts = {
            CONFIG: huggingface.config_json(model, weights),
            PREPROCESSOR: huggingface.preprocessor_json(model),
        }
    else:
        theirs, texts = weights, {CONFIG: {"library_name": "zoedepth", "zoedepth": to_dict(config)}}
    with _new_folder(path) as part:
        _save(theirs, part / WEIGHTS, config if to == "zoedepth" else None)
        for file, values in texts.items():
            (part / file).write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
        (part / CARD).write_text(model_card(config, name=name, layout=to, licence=licence), encoding="utf-8")
    return path


def _zoedepth(config: AnyModelConfig, to: Layout) -> ModelConfig:
    if not isinstance(config, ModelConfig):
        raise InputError(f"the {to} layout has no baselines: write the zoedepth layout")
    return config


def _save(weights: Mapping[str, Tensor], path: Path, config: AnyModelConfig | None) -> None:
    # transformers demands the format; our config is read from the header, so that the file is enough by itself.
    texts = {"format": "pt"} | ({} if config is None else {"config": json.dumps(to_dict(config))})
    # Two names for one memory are two weights here.
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
    path.chmod(mode)  # safetensors' files are for their owner only


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """A folder that comes into being complete, or not at all."""
    # Not in the place of the folder we are in, which has no name, nor of a link.
    if path.is_symlink() or (path.exists() and (not path.name or not path.is_dir() or any(path.iterdir()))):
        raise InputError(f"{path} is there already: give another name, or remove it first")
    part = path.with_name(f".{path.name}.{uuid4().hex[:8]}.part")
    part.mkdir(parents=True)
    try:
        yield part
        if path.is_dir():
            path.rmdir()  # empty
        part.rename(path)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
