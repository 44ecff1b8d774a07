"""Exported files in the user's cache: made once for each model, format and version, and reused while all that is true.

This module starts without torch: a file that is there already needs none.
"""

import shutil
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from filelock import FileLock

from zoedepth.download import Progress, cache_home
from zoedepth.runtimes.machine import versions
from zoedepth.runtimes.runtime import Runtime
from zoedepth.weights.fingerprint import content, fingerprint, weights_fingerprint
from zoedepth.weights.load import find, load_network
from zoedepth.weights.releases import ASSETS, RELEASES

STEM = "model"
"""Name of every exported file here, without its suffix: the folder tells what it is of."""

_MAKERS = {".onnx": ("zoedepth", "torch", "timm", "onnx"), ".xml": ("zoedepth", "torch", "timm", "onnx", "openvino")}
"""Suffix → libraries whose versions the file depends on."""


class Source(NamedTuple):
    """A model, and everything that its depth depends on."""

    path: Path
    """Its file or folder of weights."""
    compat: tuple[str, ...]
    weights: str
    """Hash of the weights, of the configuration beside them, and of ``compat``."""


def find_source(model: str | Path, *, compat: Iterable[str] = (), progress: Progress | None = None) -> Source:
    """Find a model and look at its weights. A published one that is not here is downloaded.

    Args:
        model: a name, file, folder or Hugging Face id, see ``load_model``; no exported file.
        compat: see ``load_model``.
        progress: see ``load_model``.

    Raises:
        InputError: there is no such model, or it cannot be downloaded.
    """
    path, wanted = find(model, progress=progress), tuple(sorted(set(compat)))
    return Source(path, wanted, fingerprint([weights_fingerprint(path), wanted]))


def cache_folder() -> Path:
    """Return the folder for exported files and choices, in the user's cache."""
    return cache_home() / "zoedepth"


def exported_file(
    source: Source, runtime: Runtime, *, photos: Sequence[Path] = (), tell: Callable[[str], object] | None = None
) -> Path:
    """Return the exported file of a model for a runtime: that in the package or in the cache, or one made now.

    It is in the cache whole or not at all. Those of other versions are removed then.

    Args:
        source: the model.
        runtime: a runtime of exported files.
        photos: photos to calibrate int8 on.
        tell: called with a sentence before a file is made, which takes a while.

    Raises:
        ExportError: the exported model computes another depth.
        InputError: the model cannot be exported.
        FullDiskError: the disk has too little room.
        OSError: nothing can be written to the cache.
    """
    if runtime.suffix == ".onnx" and (packaged := packaged_graph(source)) is not None:
        return packaged
    folder = cache_folder() / "exports" / f"{_prefix(source, runtime)}{_photos_key(runtime, photos)}"
    file = folder / f"{STEM}{runtime.suffix}"
    if file.is_file():
        return file
    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(folder.with_name(f"{folder.name}.lock")):
        if not file.is_file():  # another process may have made it meanwhile
            if tell is not None:
                tell(f"Writing the model for {runtime.library} once, to {folder}")
            _make(source, runtime, photos, folder)
    return file


def _kind(source: Source, runtime: Runtime) -> str:
    return f"{source.weights}-{runtime.library.lower().replace(' ', '-')}{'-int8' if runtime.numbers == 'int8' else ''}"


def _prefix(source: Source, runtime: Runtime) -> str:
    """Return how the folders of a model, runtime and versions begin; those of int8 differ in the photos, too."""
    assert runtime.suffix is not None, "torch needs no exported file"
    found = versions()
    makers = {name: found[name] for name in _MAKERS[runtime.suffix]}
    if runtime.numbers == "int8":
        makers["nncf"] = found["nncf"]
    return f"{_kind(source, runtime)}-{fingerprint(makers)}"


def _photos_key(runtime: Runtime, photos: Sequence[Path]) -> str:
    return f"-{fingerprint([content(photo) for photo in photos])}" if runtime.numbers == "int8" else ""


def packaged_graph(source: Source) -> Path | None:
    """Return the graph that the package has for its own model; None for other models."""
    for release in RELEASES.values():
        if release.graph is not None and source.path == release.path and not source.compat:
            return ASSETS / release.graph
    return None


def _make(source: Source, runtime: Runtime, photos: Sequence[Path], folder: Path) -> None:
    from zoedepth.export.write import export_model

    draft = folder.with_name(f".{folder.name}")
    shutil.rmtree(draft, ignore_errors=True)  # of a process that was killed: this one has the lock
    try:
        export_model(
            load_network(source.path, compat=source.compat),
            draft / f"{STEM}{runtime.suffix}",
            to="onnx" if runtime.suffix == ".onnx" else "openvino",
            int8=runtime.numbers == "int8",
            photos=photos,
            accuracy_control=False,  # for this machine alone it takes too long
        )
        each = "?" * 16  # of a hash
        pattern = f"{_kind(source, runtime)}-{each}{f'-{each}' if runtime.numbers == 'int8' else ''}"
        for other in folder.parent.glob(pattern):
            # Files of these versions, calibrated on other photos, are those of other choices.
            if not other.name.startswith(_prefix(source, runtime)):
                shutil.rmtree(other, ignore_errors=True)
        draft.replace(folder)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
