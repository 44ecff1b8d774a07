"""Load models by name, file, folder or Hugging Face id."""

import os
from collections.abc import Iterable
from pathlib import Path

from zoedepth.download import Progress, download
from zoedepth.errors import InputError, similar
from zoedepth.model.interface import DepthModel
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import PRESETS
from zoedepth.weights.checkpoint import read_checkpoint
from zoedepth.weights.exported import Precision, is_exported, load_exported
from zoedepth.weights.fit import misfits, model_of
from zoedepth.weights.hub import WEIGHTS, cached, fetch, is_hub_id
from zoedepth.weights.releases import RELEASES
from zoedepth.weights.save import checkpoint_of, push_to_hub, save_model

__all__ = [
    "ZoeDepth",
    "available_models",
    "checkpoint_of",
    "find",
    "load_model",
    "misfits",
    "model_of",
    "push_to_hub",
    "save_model",
]


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
) -> DepthModel:
    """Load a model with its weights, in evaluation mode, float32, on the CPU.

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
        if tuple(compat):
            raise InputError(
                f"{name_or_path} is an exported model with its behaviours built in: give --compat to zoedepth export"
            )
        return load_exported(name_or_path, precision=precision, streams=streams)
    path = find(name_or_path, progress=progress)
    return model_of(read_checkpoint(path), source=path, compat=compat)


def load_zoedepth(name_or_path: str | Path) -> ZoeDepth:
    """Load a ZoeDepth. This is ``ZoeDepth.from_pretrained``; ``load_model`` loads every kind of model.

    Args:
        name_or_path: see ``load_model``.

    Raises:
        InputError: see ``load_model``; or the model is an exported file or one of the baselines.
    """
    model = load_model(name_or_path)
    if not isinstance(model, ZoeDepth):
        kind = "an exported model" if is_exported(name_or_path) else "one of the baselines"
        raise InputError(f"{name_or_path} is {kind}, not a ZoeDepth: load it with zoedepth.load_model")
    return model


# Set here, because model/ imports nothing that is above it. ``from zoedepth import ZoeDepth`` comes by this module.
ZoeDepth.from_pretrained = staticmethod(load_zoedepth)


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
        if not release.present and release.hub_id and cached(release.hub_id):
            return fetch(release.hub_id)  # the same weights are here already
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
