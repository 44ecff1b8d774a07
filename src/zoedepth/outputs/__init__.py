"""The files a prediction is written as, a file of this package a kind. They know arrays and no model.

A new kind is a file with an ``Output`` in it, and a line in ``OUTPUTS``: `zoedepth predict --save` and
``DepthMap.save`` offer it then.
"""

import warnings
from collections.abc import Iterable
from pathlib import Path

from zoedepth.errors import InputError, InputWarning, no_such
from zoedepth.outputs.color import COLOR
from zoedepth.outputs.depth import DEPTH
from zoedepth.outputs.exr import EXR
from zoedepth.outputs.glb import GLB
from zoedepth.outputs.html import HTML
from zoedepth.outputs.npy import NPY
from zoedepth.outputs.npz import NPZ
from zoedepth.outputs.output import Maps, Options, Output, Written
from zoedepth.outputs.pcd import PCD
from zoedepth.outputs.pfm import PFM
from zoedepth.outputs.ply import PLY
from zoedepth.outputs.preview import PREVIEW
from zoedepth.outputs.relative import RELATIVE
from zoedepth.outputs.tiff import TIFF
from zoedepth.outputs.usdz import USDZ

__all__ = ["OUTPUTS", "Maps", "Options", "Output", "Written", "output_names", "save_maps", "write_maps"]

OUTPUTS: dict[str, Output] = {
    "depth": DEPTH,
    "relative": RELATIVE,
    "preview": PREVIEW,
    "color": COLOR,
    "npy": NPY,
    "npz": NPZ,
    "exr": EXR,
    "tiff": TIFF,
    "pfm": PFM,
    "ply": PLY,
    "pcd": PCD,
    "glb": GLB,
    "usdz": USDZ,
    "html": HTML,
}


def output_names(words: Iterable[str], *, map: str = "depth") -> tuple[str, ...]:
    """Return the names in ``OUTPUTS`` that somebody means: each once, in the order they are given.

    Args:
        words: names, or suffixes of their files, such as "exr", "png" (depth, or relative depth) or "jpg" (the
            preview), one by one or several with commas between.
        map: the map that the files are made of: "depth" or "relative".

    Raises:
        InputError: there is no such output.
    """
    names = [part.strip() for word in words for part in word.split(",") if part.strip()]
    return tuple(dict.fromkeys(_named(name, map) for name in names))


def _named(word: str, map: str) -> str:
    name = word.lower().removeprefix(".")
    if name in OUTPUTS:
        return name
    of_map = {known: output for known, output in OUTPUTS.items() if map in output.maps}
    for known, output in of_map.items():
        if f".{name}" in (Path(output.ending).suffix, *output.suffixes):
            return known
    raise no_such("output", word, OUTPUTS)


def write_maps(path: str | Path, maps: Maps, options: Options | None = None) -> Written:
    """Write one file in the format of its suffix, whole or not at all.

    Args:
        path: where to write; missing folders are made.
        maps: the maps of a photo; those that the format needs must be there.
        options: how to write; None takes the defaults.

    Raises:
        InputError: no output has this suffix, or the maps lack what it needs.
    """
    suffix = Path(path).suffix.lower()
    for output in OUTPUTS.values():
        if suffix in output.suffixes:
            options = options or Options()
            return output.write(Path(path), maps.up_to(options.max_depth), options)
    known = [suffix for output in OUTPUTS.values() for suffix in output.suffixes]
    raise InputError(f"cannot write depth as {Path(path).name!r}: use one of the suffixes {', '.join(known)}")


def save_maps(path: str | Path, maps: Maps, options: Options) -> None:
    """Write one file as ``write_maps`` does, for the method ``save`` of a result: notes become warnings of its caller.

    Warns:
        InputWarning: see ``Written.notes``.
    """
    for note in write_maps(path, maps, options).notes:
        warnings.warn(f"{path}: {note}", InputWarning, stacklevel=3)
