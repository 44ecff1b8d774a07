"""Reading files of weights that may come from anyone: tensors and text come out, nothing is executed."""

import json
import pickle
import re
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor
from torch.nn import Parameter

from zoedepth.errors import InputError
from zoedepth.weights.layouts.keys import unwrapped

MAX_JSON_BYTES = 10_000_000
"""A config larger than this is none."""
MAX_JSON_NUMBER = 1e38
"""What float32 holds; no size or depth is near it."""
MAX_JSON_NESTING = 32


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Named tensors of a safetensors file or a ``torch.save`` archive, and the texts in its header.

    The kind of file is told by its first bytes, not by its suffix. Tensors of a safetensors file stay on the disk
    until they are used.

    Raises:
        InputError: the file is neither, damaged, or holds anything but tensors.
    """
    try:
        with path.open("rb") as file:
            start = file.read(9)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from error
    if start.startswith(b"PK\x03\x04"):
        return _read_torch(path), {}
    # The header of safetensors follows its length, whose first byte may be any.
    if start.startswith(b"\x80") and start[8:] != b"{":
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
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not valid JSON ({error})") from error
    try:
        value = parse_json(text)
    except InputError as error:
        raise InputError(f"{path} is not valid JSON ({error})") from error
    if not isinstance(value, dict):
        raise InputError(f"{path} must hold a JSON object")
    return value


def parse_json(text: str) -> Any:
    """JSON whose values any code can take: no NaN, no number beyond float32, no brackets too deep to show.

    Raises:
        InputError: it is none.
    """
    try:
        value = json.loads(
            text,
            parse_int=partial(_number, int),
            parse_float=partial(_number, float),
            parse_constant=partial(_number, float),  # NaN and Infinity, which only Python takes for JSON
        )
    except (ValueError, RecursionError) as error:  # no JSON, or brackets without end
        raise InputError(str(error)) from error
    level = [value]
    for _ in range(MAX_JSON_NESTING):
        level = [x for outer in level if isinstance(outer, dict | list)
                 for x in (outer.values() if isinstance(outer, dict) else outer)]  # fmt: skip
    if level:
        raise InputError(f"brackets deeper than {MAX_JSON_NESTING}")
    return value


def _number(kind: type[int] | type[float], text: str) -> int | float:
    value = kind(text)
    if not abs(value) <= MAX_JSON_NUMBER:
        raise ValueError(f"{text[:20]} is no number of a config")
    return value


def _read_safetensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    try:
        with safe_open(str(path), framework="pt") as file:
            texts = file.metadata() or {}
            return {name: file.get_tensor(name) for name in file.keys()}, texts  # noqa: SIM118  # not a dict
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path} is not a readable safetensors file ({_first_line(error)})") from error


class _NumpyValue:
    """What stands in the place of numpy's numbers and arrays beside the weights, of which nothing is read or made."""

    def __init__(self, *_: object) -> None:
        pass

    def __setstate__(self, _: object) -> None:
        pass


_NUMPY: list[Any] = [
    (_NumpyValue, f"numpy.{name}")
    for name in (
        "ndarray", "dtype", "core.multiarray._reconstruct", "core.multiarray.scalar", "_core.multiarray._reconstruct",
        "_core.multiarray.scalar",
    )
]  # fmt: skip
"""What a file may ask for beside tensors (NeWCRFs keeps its best scores as an array) → what it gets."""


def _read_torch(path: Path) -> dict[str, Tensor]:
    size = path.stat().st_size
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError) as error:  # the last: a kind of zip it does not know
        raise InputError(f"{path} is damaged or not whole ({error}): download or copy it again") from error
    # torch never compresses; what is compressed could unfold to any size.
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries) or sum(e.file_size for e in entries) > size:
        raise InputError(f"{path} is a compressed archive, not a torch checkpoint")
    try:
        # Given a path, torch goes by its suffix.
        with path.open("rb") as file, torch.serialization.safe_globals(_NUMPY):
            saved = torch.load(file, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise InputError(
            f"{path} holds something other than tensors{_named(error)}: refused, nothing of it was executed"
        ) from error
    except Exception as error:  # a pickle made up by anyone fails in any way
        raise InputError(
            f"{path} is damaged or no torch checkpoint ({type(error).__name__}: {_first_line(error)})"
        ) from error
    return _tensors(saved, path, size)


def _tensors(saved: object, path: Path, size: int) -> dict[str, Tensor]:
    """The state dict in what was saved: itself, or beside other things under "model"."""
    # Methods by their class: a pickle may give its objects attributes that hide them.
    if isinstance(saved, dict) and isinstance(model := dict.get(saved, "model"), dict):
        saved = model
    if not isinstance(saved, dict) or not saved:
        raise InputError(f"{path} holds no dictionary of weights")
    found: dict[str, Tensor] = {}
    claimed = 0
    for name, value in dict.items(saved):
        if not isinstance(name, str) or type(value) not in (Tensor, Parameter):
            raise InputError(f"{path} is no dictionary of weights: {str(name)[:80]!r} is a {type(value).__name__}")
        found[name] = value = Tensor.detach(value)
        if value.layout != torch.strided or value.device.type != "cpu" or value.is_quantized:
            raise InputError(f"{path}: {name[:80]!r} is no plain tensor")
        n_bytes = value.numel() * value.element_size()
        claimed += n_bytes
        # A stride of 0 makes a few bytes look like any number of them; so do many names for them, of which there are
        # some in honest files.
        if n_bytes > min(size, value.untyped_storage().nbytes()) or claimed > 2 * size:
            raise InputError(f"{path}: {name[:80]!r} claims to be larger than what is stored of it")
    return unwrapped(found)


def _named(error: Exception) -> str:
    """What the pickle asked for; the rest of torch's message is how to run it all the same."""
    found = re.search(r"GLOBAL ([\w.]{1,80})", str(error))
    return f" ({found[1]})" if found else ""


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else ""
