"""The files a prediction is written as, a file of this package a kind. They know arrays and no model.

A new kind is a file with an ``Output`` in it, and a line in ``OUTPUTS``: `zoedepth predict --save` and
``DepthMap.save`` offer it then.
"""

from pathlib import Path

from zoedepth.errors import InputError
from zoedepth.outputs.depth import DEPTH
from zoedepth.outputs.npy import NPY
from zoedepth.outputs.npz import NPZ
from zoedepth.outputs.output import Maps, Options, Output, Written
from zoedepth.outputs.preview import PREVIEW
from zoedepth.outputs.relative import RELATIVE

__all__ = ["OUTPUTS", "Maps", "Options", "Output", "Written", "write_maps"]

OUTPUTS: dict[str, Output] = {
    "depth": DEPTH,
    "relative": RELATIVE,
    "preview": PREVIEW,
    "npy": NPY,
    "npz": NPZ,
}


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
            return output.write(Path(path), maps, options or Options())
    known = [suffix for output in OUTPUTS.values() for suffix in output.suffixes]
    raise InputError(f"cannot write depth as {Path(path).name!r}: use one of the suffixes {', '.join(known)}")
