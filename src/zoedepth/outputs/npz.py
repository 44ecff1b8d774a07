"""All maps of a photo in one compressed file of NumPy, by name."""

from pathlib import Path
from typing import Any

import numpy as np

from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.outputs.output import Maps, Options, Output, Written


def _write(path: Path, maps: Maps, options: Options) -> Written:
    """Write what there is of ``depth`` and ``std`` in metres, ``confidence`` in (0, 1], and ``relative``, in float32.

    Beside depth are ``valid``, True where it makes a point (see ``Maps.valid``), and of a camera that is known its
    ``intrinsics``, 3 x 3 in pixels, float64, and ``camera_source``, a word: given, exif or assumed. A panorama has the
    word equirectangular as ``projection``.
    """
    known = {"depth": maps.depth, "std": maps.std, "confidence": maps.confidence, "relative": maps.relative}
    # Any: NumPy's own keyword `allow_pickle` has another type.
    arrays: dict[str, Any] = {
        name: values.astype(np.float32, copy=False) for name, values in known.items() if values is not None
    }
    if not arrays:
        raise InputError(f"there is no map to write to {path}: give depth or relative")
    if maps.valid is not None:
        arrays["valid"] = maps.valid
    if maps.panorama:
        arrays["projection"] = np.array(maps.projection)
    if maps.camera is not None:
        arrays |= {"intrinsics": maps.camera.matrix, "camera_source": np.array(maps.camera.source)}
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)
    return Written()


NPZ = Output(
    ".npz",
    "the arrays depth, std, confidence, valid and intrinsics, or relative",
    _write,
    suffixes=(".npz",),
    maps=("depth", "relative"),
)
