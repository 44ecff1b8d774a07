"""Read files of weights that may come from anyone: only tensors and text come out, and no code runs."""

import io
import pickle
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor
from torch.nn import Parameter

from zoedepth.errors import InputError, first_line
from zoedepth.weights.layouts.keys import unwrapped

MAX_PICKLE_BYTES = 2_000_000
"""Largest description of a checkpoint (names, shapes, numbers); the original's are 0.3 MB, with an optimizer 1 MB."""


MAX_HEADER_BYTES = 1 << 20
"""Largest header of a safetensors file; that of the largest model here has 0.1 MB."""
_MAX_READS = 700_000  # pieces of a pickle; 900 weights take 46,000, and with AdamW's state 220,000


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Return the named tensors of a safetensors file or a ``torch.save`` archive, and the texts beside them.

    In a safetensors file these are the texts of the header, in an archive a dictionary of texts under "about".
    The first bytes tell the kind of file, not the suffix. Tensors of a safetensors file stay on the disk until they are
    used.

    Raises:
        InputError: the file is of another kind or damaged, or holds anything but tensors.
    """
    try:
        with path.open("rb") as file:
            start = file.read(9)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from error
    if start.startswith(b"PK\x03\x04"):
        return _read_torch(path)
    # A safetensors file begins with the length of its header, whose first byte may be anything.
    if start.startswith(b"\x80") and start[8:] != b"{":
        raise InputError(
            f"{path} is a bare pickle or a checkpoint of a torch before 1.6: refused, nothing of it was executed. "
            "Save it again with a newer torch, or as safetensors"
        )
    return _read_safetensors(path)


def _read_safetensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
    if MAX_HEADER_BYTES < length <= path.stat().st_size:  # a longer one is damage, as the library says
        raise InputError(
            f"{path} has a header of {length:,} bytes, more than {MAX_HEADER_BYTES:,}: it holds no model that is known "
            "here. Save model.state_dict() alone"
        )
    try:
        with safe_open(str(path), framework="pt") as file:
            texts = file.metadata() or {}
            return {name: file.get_tensor(name) for name in file.keys()}, texts  # noqa: SIM118  # not a dict
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path} is not a readable safetensors file ({first_line(error)})") from error


class _Placeholder:
    """Stand-in for an object in a pickle that is neither read nor made. It swallows what a pickle may do with it."""

    def __init__(self, *_: object) -> None:
        pass

    def swallow(self, *_: object) -> Any:
        """Do nothing."""
        return self

    __call__ = __setstate__ = __setitem__ = append = extend = add = swallow


class _Counted(io.BytesIO):
    """A pickle that counts its steps by the times that it is read."""

    n_read = 0

    def read(self, size: int | None = -1, /) -> bytes:
        """Read ``size`` bytes."""
        self.n_read += 1
        if self.n_read > _MAX_READS:
            raise ValueError(f"it has more than {_MAX_READS:,} pieces: save model.state_dict() alone")
        return super().read(size)


_NUMPY: list[Any] = [
    (_Placeholder, f"numpy.{name}")
    for name in (
        "ndarray", "dtype", "core.multiarray._reconstruct", "core.multiarray.scalar", "_core.multiarray._reconstruct",
        "_core.multiarray.scalar",
    )
]  # fmt: skip
"""Placeholders, and the names in a file that they stand for (NeWCRFs keeps its best scores as an array)."""


class _Rehearsal(pickle._Unpickler):
    """Reader of a pickle that makes placeholders only, to find out what the pickle would allocate.

    torch's reader runs no code of a file, but it calls a few harmless functions with any arguments: ``bytearray(n)``
    and the types of tensors and storages allocate any size, and ``codecs.encode`` in a chain doubles a text each time.
    """

    def find_class(self, module: str, name: str) -> Any:
        """Return the stand-in of a function or class."""
        if name == "encode":
            return _check_encode
        return _Allocation if name == "bytearray" or name.endswith(("Tensor", "Storage")) else _Placeholder

    def persistent_load(self, pid: object) -> Any:
        """Return the stand-in of the bytes of a tensor."""
        return _Placeholder()


def _refuse_set(_: Any) -> None:
    # One byte in the file and 200 in memory. torch does not write sets this way.
    raise ValueError("it has a set")


def _with_plain_keys(load: Callable[[Any], None], first_key: int | None) -> Callable[[Any], None]:
    """Make an opcode refuse keys of dictionaries other than numbers, texts and flat tuples of them.

    Tuples nested in pairs take hours to hash. Keys are every second of the topmost values, from ``first_key`` on.
    """

    def checked(unpickler: Any) -> None:
        for key in unpickler.stack[first_key::2]:
            for part in key if isinstance(key, tuple) else (key,):
                if not isinstance(part, str | int | float | _Placeholder | None):
                    raise ValueError(f"it has a dictionary with a {type(part).__name__} in its keys")
        load(unpickler)

    return checked


_loaders: dict[int, Any] = pickle._Unpickler.dispatch
_checked = {
    pickle.EMPTY_SET[0]: _refuse_set,
    pickle.SETITEM[0]: _with_plain_keys(_loaders[pickle.SETITEM[0]], -2),
    pickle.SETITEMS[0]: _with_plain_keys(_loaders[pickle.SETITEMS[0]], None),
    pickle.DICT[0]: _with_plain_keys(_loaders[pickle.DICT[0]], None),
}
setattr(_Rehearsal, "dispatch", {**_loaders, **_checked})  # noqa: B010  # typed narrower


class _Allocation(_Placeholder):
    """Stand-in for the types that allocate as much as they are told to. Sound files only name them, or give bytes."""

    def __new__(cls, *arguments: object) -> "_Allocation":
        """Refuse to be made of a size."""
        if arguments and not isinstance(arguments[0], str | _Bytes):
            raise ValueError("it would allocate memory that is not in the file")
        return super().__new__(cls)


class _Bytes(_Placeholder):
    """Stand-in for bytes."""


def _check_encode(text: str, encoding: str) -> _Bytes:
    # Python writes bytes this way.
    if not isinstance(text, str) or encoding != "latin1":
        raise ValueError(f"it encodes to {str(encoding)[:20]!r}")
    return _Bytes()


def _read_torch(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    size = path.stat().st_size
    _check_archive(path, size)
    try:
        # torch would go by the suffix of a path.
        with path.open("rb") as file, torch.serialization.safe_globals(_NUMPY):
            saved = torch.load(file, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise InputError(
            f"{path} holds something other than tensors{_named(error)}: refused, nothing of it was executed. "
            "Save a model with zoedepth.save_model, or its state_dict()"
        ) from error
    except Exception as error:  # a made-up pickle can fail in any way
        raise InputError(
            f"{path} is damaged or no torch checkpoint ({type(error).__name__}: {first_line(error)})"
        ) from error
    return _tensors(saved, path, size), _texts(saved)


def _texts(saved: object) -> dict[str, str]:
    about = dict.get(saved, "about") if isinstance(saved, dict) else None
    texts = dict.items(about) if isinstance(about, dict) else ()
    return {name: text for name, text in texts if type(name) is type(text) is str}


def _check_archive(path: Path, size: int) -> None:
    """Refuse archives and pickles that would become larger than the file."""
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            _refuse_programs({entry.filename.rpartition("/")[2] for entry in entries}, path)
            # torch never compresses, and a compressed entry could unfold to any size.
            compressed = any(entry.compress_type != zipfile.ZIP_STORED for entry in entries)
            if compressed or sum(entry.file_size for entry in entries) > size:
                raise InputError(
                    f"{path} is a compressed archive, not a torch checkpoint: unpack it and give the file inside"
                )
            pickles = [entry for entry in entries if entry.filename.lower().endswith(".pkl")]
            if sum(entry.file_size for entry in pickles) > MAX_PICKLE_BYTES:
                raise InputError(
                    f"{path} holds more than {MAX_PICKLE_BYTES:,} bytes beside the weights: save "
                    "model.state_dict() alone"
                )
            contents = [archive.read(entry) for entry in pickles]
    except InputError:
        raise
    except Exception as error:  # a damaged archive can fail in many ways, from BadZipFile to EOFError
        raise InputError(f"{path} is damaged or not whole ({error}): download or copy it again") from error
    try:
        for content in contents:
            _Rehearsal(_Counted(content)).load()
    except Exception as error:  # a made-up pickle can fail in any way
        raise InputError(
            f"{path} is damaged or no torch checkpoint ({type(error).__name__}: {first_line(error)}). "
            "Download or copy it again"
        ) from error


def _refuse_programs(names: set[str], path: Path) -> None:
    """Refuse archives that hold a program beside the weights."""
    for name, kind, loader in (
        ("archive_format", "a torch-export", "torch.export.load"),
        ("serialized_exported_program.json", "a torch-export", "torch.export.load"),  # before torch 2.7
        ("constants.pkl", "a TorchScript", "torch.jit.load"),
    ):
        if name in names:
            raise InputError(
                f"{path} is {kind}, which can run code: zoedepth does not load it. Load it with {loader} if it is your "
                "own; or give zoedepth the weights, or an export to onnx or openvino"
            )


def _tensors(saved: object, path: Path, size: int) -> dict[str, Tensor]:
    """Return the state dict: the saved object itself, or the one under "model" beside other things."""
    # Methods are called by their class, because a pickle may give its objects attributes that hide them.
    if isinstance(saved, dict) and isinstance(model := dict.get(saved, "model"), dict):
        saved = model
    if not isinstance(saved, dict) or not saved:
        raise InputError(f"{path} holds no dictionary of weights: save model.state_dict()")
    found: dict[str, Tensor] = {}
    claimed = 0
    for name, value in dict.items(saved):
        if not isinstance(name, str) or type(value) not in (Tensor, Parameter):
            raise InputError(
                f"{path} is not a dictionary of weights: {str(name)[:80]!r} is a {type(value).__name__}. Save "
                "model.state_dict()"
            )
        found[name] = value = Tensor.detach(value)
        if value.layout != torch.strided or value.device.type != "cpu" or value.is_quantized:
            raise InputError(f"{path}: {name[:80]!r} is not a plain tensor, dense and on the CPU")
        n_bytes = value.numel() * value.element_size()
        claimed += n_bytes
        # A stride of 0 makes a few bytes look like many, and so do many names for the same bytes. Sound files have a
        # few such names (the original's index tables), so the sum may be twice the file.
        if n_bytes > min(size, value.untyped_storage().nbytes()) or claimed > 2 * size:
            raise InputError(f"{path}: {name[:80]!r} claims to be larger than the bytes that are stored for it")
    return unwrapped(found)


def _named(error: Exception) -> str:
    """Return the name that the pickle asked for. The rest of torch's message tells how to run it all the same."""
    found = re.search(r"GLOBAL ([\w.]{1,80})", str(error))
    return f" ({found[1]})" if found else ""
