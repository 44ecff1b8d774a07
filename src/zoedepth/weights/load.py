"""Load models by name, file, folder or Hugging Face id."""

import os
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from zoedepth.download import Progress, download
from zoedepth.errors import InputError, similar
from zoedepth.moved import moved_name
from zoedepth.presets import PRESETS
from zoedepth.threads import has_accelerator
from zoedepth.weights.exported import ExportedModel, Precision, is_exported, load_exported
from zoedepth.weights.fingerprint import content_fingerprint, fingerprint
from zoedepth.weights.hub import WEIGHTS, cached, fetch, is_hub_id
from zoedepth.weights.releases import ASSETS, RELEASES, Release

if TYPE_CHECKING:
    from zoedepth.model.interface import DepthModel


def available_models() -> list[str]:
    """Return the names that ``load_model`` knows. The models in the package come first; the others are downloaded once.

    ``zoedepth models`` shows the purpose, size and licence of each, and whether it is on this machine.
    """
    return sorted(RELEASES, key=lambda name: (RELEASES[name].url is not None, name))


def load_model(
    name_or_path: str | Path,
    *,
    compat: Iterable[str] = (),
    precision: Precision = "float32",
    streams: int = 1,
    progress: Progress | None = None,
) -> "DepthModel | ExportedModel":
    """Load a model with its weights, in evaluation mode, float32, on the CPU. Exported files are loaded without torch.

    Args:
        name_or_path: one of these:

            - a name of ``available_models``;
            - a file or folder of weights, recognised by its content: ours, the original's
              ``ZoeD_M12_{N,K,NK}.pt``, MiDaS's ``dpt_beit_large_384.pt``, transformers' (both kinds of names), and the
              checkpoints of BTS, AdaBins, LocalBins, PixelBins and NeWCRFs;
            - the folder of a training, whose newest checkpoint is taken;
            - a Hugging Face id such as ``"Intel/zoedepth-nyu-kitti"``;
            - a file that ``zoedepth export`` wrote, .onnx or .xml, which runs in its own runtime.
        compat: behaviours of the released code to take over, see ``presets.COMPAT``.
        precision: number type that an OpenVINO file computes in; other models ignore it.
        streams: number of forwards that an OpenVINO file runs at the same time; other models ignore it.
        progress: function to call while weights are downloaded, see ``zoedepth.download``; None: one line in the log.

    Raises:
        InputError: there is no such model, it cannot be downloaded, its file is damaged, unsafe or does not fit, or
            ``compat`` is given for an exported file, whose behaviour is fixed.
        MissingExtraError: the runtime of an exported file is not installed.
    """
    if is_exported(name_or_path):
        _refuse_compat(name_or_path, compat)
        return load_exported(name_or_path, precision=precision, streams=streams)
    return load_network(name_or_path, compat=compat, progress=progress)


def _refuse_compat(exported: str | Path, compat: Iterable[str]) -> None:
    if tuple(compat):
        raise InputError(
            f"{exported} is an exported model with its behaviours built in: give --compat to zoedepth export"
        )


def load_for_prediction(
    name_or_path: str | Path,
    *,
    device: str = "auto",
    compat: Iterable[str] = (),
    precision: Precision = "float32",
    streams: int = 1,
    progress: Progress | None = None,
) -> "DepthModel | ExportedModel":
    """Load a model that is to predict metres, and nothing else: as ``load_model`` does, or sooner.

    A model whose graph is in the package (``zoed-lite``) then runs in ONNX Runtime, where that is installed, on the
    same weights: it starts without torch, in a fifth of the time, and gives the same depth but for rounding. That holds
    on the CPU, in float32 and with nothing of ``compat``; everything else is loaded with torch.

    Args:
        name_or_path: see ``load_model``.
        device: where the model is to run, see ``Predictor``: "auto" is the CPU where no driver of an accelerator is
            found, see ``has_accelerator``. An exported file is told it, too, see ``load_exported``.
        compat: see ``load_model``.
        precision: see ``load_model``.
        streams: see ``load_model``.
        progress: see ``load_model``.

    Raises:
        InputError: see ``load_model``.
        MissingExtraError: the runtime of an exported file is not installed.
    """
    release = RELEASES.get(name_or_path) if isinstance(name_or_path, str) else None
    compat = tuple(compat)
    on_cpu = device == "cpu" or (device == "auto" and not has_accelerator())
    if is_exported(name_or_path):
        _refuse_compat(name_or_path, compat)
        return load_exported(name_or_path, precision=precision, streams=streams, device=device)
    if release and release.graph and on_cpu and precision == "float32" and not compat and find_spec("onnxruntime"):
        model = load_exported(ASSETS / release.graph)
        model.provenance = release.provenance
        return model
    return load_model(name_or_path, compat=compat, precision=precision, streams=streams, progress=progress)


def load_network(
    name_or_path: str | Path, *, compat: Iterable[str] = (), progress: Progress | None = None
) -> "DepthModel":
    """Load a model in torch, as ``load_model`` does: one that can be trained. Exported files are none.

    Raises:
        InputError: see ``load_model``.
    """
    path = find(name_or_path, progress=progress)
    from zoedepth.weights.checkpoint import read_checkpoint
    from zoedepth.weights.fit import model_of

    return model_of(read_checkpoint(path), source=path, compat=compat)


def weights_of(name_or_path: str | Path, *, compat: Iterable[str] = (), pad: bool) -> str:
    """Return a hash of the weights that a name stands for now, and of the options that change their metres.

    It is the same on every machine, in every runtime, and for an identical file under another name. An exported file
    has weights of its own. Published models that are downloaded are known by their names, and not by their files.

    Args:
        name_or_path: see ``load_model``. In the folder of a training the newest checkpoint counts, which may be another
            than the one that was loaded: give what ``pinned`` returned before.
        compat: see ``load_model``.
        pad: True where photos are padded, see ``Predictor``.

    Raises:
        InputError: there is no such model.
    """
    release = RELEASES.get(name_or_path) if isinstance(name_or_path, str) else None
    weights = name_or_path if release and release.url else content_fingerprint(find(name_or_path))
    return fingerprint([weights, sorted(set(compat)), pad])


def pinned(name_or_path: str | Path) -> str | Path:
    """Return what a name stands for now, where that may change: the newest checkpoint in the folder of a training.

    Whoever loads a model and also says which one it was asks for this first. Other names come back as they are.

    Raises:
        InputError: see ``load_model``.
    """
    is_name = isinstance(name_or_path, str) and name_or_path in RELEASES
    return find(name_or_path) if not is_name and os.path.isdir(name_or_path) else name_or_path


def is_here(release: Release) -> bool:
    """Return True if the weights of a release are on this machine, so that its name loads without the network."""
    return release.present or _on_hub(release)


def _on_hub(release: Release) -> bool:
    """Return True if the Hub's copy of a release is on this machine, and is the same model."""
    return release.hub_id is not None and release.alike_on_hub and cached(release.hub_id)


def find(name_or_path: str | Path, *, progress: Progress | None = None) -> Path:
    """Return the file or folder of a model. A published model that is not on this machine is downloaded first.

    Args:
        name_or_path: see ``load_model``.
        progress: see ``load_model``.

    Raises:
        InputError: there is no such model, or it cannot be downloaded.
    """
    name, path = str(name_or_path), Path(name_or_path)
    if isinstance(name_or_path, str) and name in RELEASES:
        release = RELEASES[name]
        if release.url is None:
            return release.path
        if not release.present and release.hub_id and _on_hub(release):
            return fetch(release.hub_id)
        return download(release.url, release.path, name=name, progress=progress)
    if os.path.exists(path):  # Path.exists raises for a name that is too long for a file
        return _newest_checkpoint(path) or path
    if name in PRESETS:
        raise InputError(
            f"{name} is a model of the paper whose weights nobody published; its architecture is "
            f"zoedepth.presets.PRESETS[{name!r}]. Give a file of weights, or one of {available_models()}"
        )
    if isinstance(name_or_path, str) and is_hub_id(name):
        return fetch(name)
    looks_like_path = os.sep in name or path.suffix
    problem = f"there is no file {name}" if looks_like_path else f"there is no model named {name!r}"
    alike = similar(name, available_models())
    question = f": did you mean {' or '.join(alike)}? Known" if alike else "; known"
    raise InputError(
        f"{problem}{question} models are {', '.join(available_models())}; or give a file, a folder or a Hugging Face "
        "id (owner/name)"
    )


def _newest_checkpoint(folder: Path) -> Path | None:
    """Return the newest checkpoint of a training in its folder; None for other folders, and those with weights."""
    if not folder.is_dir() or (folder / WEIGHTS).is_file():
        return None
    steps = [path.parent for path in (*folder.glob(f"step_*/{WEIGHTS}"), *folder.glob(f"run/step_*/{WEIGHTS}"))]
    numbered = [(int(number), path) for path in steps if (number := path.name.removeprefix("step_")).isdecimal()]
    return max(numbered)[1] if numbered else None


def __getattr__(name: str) -> object:
    return moved_name(__name__, name)
