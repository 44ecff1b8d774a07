"""Reading files of weights that may come from anyone: tensors and text come out, nothing is executed."""

import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from zoedepth.errors import InputError

MAX_JSON_BYTES = 10_000_000
"""A config larger than this is none."""


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Named tensors of a safetensors file or a ``torch.save`` archive, and the texts in its header.

    The kind of file is told by its first bytes, not by its suffix. Tensors of a safetensors file stay on the disk
    until they are used.

    Raises:
        InputError: the file is neither, damaged, or holds anything but tensors.
    """
    try:
        with path.open("rb") as file:
            start = file.read(4)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from error
    if start == b"PK\x03\x04":
        return _read_torch(path), {}
    if start[:1] == b"\x80" or start == b"\x1f\x8b\x08\x00":
        raise InputError(
            f"{path} is a bare pickle or a checkpoint of a torch before 1.6: refused, nothing of it was executed. "
            "Save it again with a later torch, or as safetensors"
        )
    return _read_safetensors(path)


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        InputError: it cannot be read, is too large, or is no object.
    """
    try:
        if path.stat().st_size > MAX_JSON_BYTES:
            raise InputError(f"{path} is too large for a config")
        value = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from error
    except (ValueError, RecursionError) as error:  # no UTF-8, no JSON, or brackets without end
        raise InputError(f"{path} is not valid JSON ({error})") from error
    if not isinstance(value, dict):
        raise InputError(f"{path} must hold a JSON object")
    return value


def _read_safetensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    try:
        with safe_open(str(path), framework="pt") as file:
            texts = file.metadata() or {}
            return {name: file.get_tensor(name) for name in file.keys()}, texts  # noqa: SIM118  # not a dict
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path} is not a readable safetensors file ({error})") from error


def _read_torch(path: Path) -> dict[str, Tensor]:
    size = path.stat().st_size
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise InputError(f"{path} is damaged or not whole ({error}): download or copy it again") from error
    # torch never compresses; what is compressed could unfold to any size.
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries) or sum(e.file_size for e in entries) > size:
        raise InputError(f"{path} is a compressed archive, not a torch checkpoint")
    try:
        with path.open("rb") as file:  # given a path, torch goes by its suffix
            saved = torch.load(file, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise InputError(
            f"{path} holds something other than tensors: refused, nothing of it was executed. {_first_line(error)}"
        ) from error
    except Exception as error:  # a pickle made up by anyone fails in any way
        raise InputError(
            f"{path} is damaged or no torch checkpoint ({type(error).__name__}: {_first_line(error)})"
        ) from error
    return _tensors(saved, path, size)


def _tensors(saved: object, path: Path, size: int) -> dict[str, Tensor]:
    """The state dict in what was saved: itself, or beside other things under "model"."""
    if isinstance(saved, dict) and isinstance(saved.get("model"), dict):
        saved = saved["model"]
    if not isinstance(saved, dict) or not saved:
        raise InputError(f"{path} holds no dictionary of weights")
    for name, value in saved.items():
        if not isinstance(name, str) or not isinstance(value, Tensor):
            raise InputError(f"{path} is no dictionary of weights: {str(name)[:80]!r} is a {type(value).__name__}")
        if value.layout != torch.strided or value.device.type != "cpu" or value.is_quantized:
            raise InputError(f"{path}: {name[:80]!r} is no plain tensor")
        # A stride of 0 makes a few bytes look like any number of them.
        if value.numel() * value.element_size() > min(size, value.untyped_storage().nbytes()):
            raise InputError(f"{path}: {name[:80]!r} claims to be larger than what is stored of it")
    names = list(saved)
    if all(name.startswith("module.") for name in names):  # saved from within DistributedDataParallel
        return {name.removeprefix("module."): saved[name].detach() for name in names}
    return {name: saved[name].detach() for name in names}


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else ""
