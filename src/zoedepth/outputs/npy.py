"""Metres as NumPy's array of float32."""

from pathlib import Path

import numpy as np

from zoedepth.images import atomic_path
from zoedepth.outputs.output import Maps, Options, Output, Written, needed


def _write(path: Path, maps: Maps, options: Options) -> Written:
    depth = needed(maps, "depth").astype(np.float32, copy=False)
    with atomic_path(path) as temporary, temporary.open("wb") as file:  # given a path, NumPy appends ".npy" to ".NPY"
        np.save(file, depth)
    return Written()


NPY = Output("_depth.npy", "metres as an array of float32", _write, suffixes=(".npy",))
