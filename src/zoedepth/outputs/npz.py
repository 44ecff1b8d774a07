"""All maps of a photo in one compressed file of NumPy: float32 arrays by name."""

from pathlib import Path
from typing import Any

import numpy as np

from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.outputs.output import Maps, Options, Output, Written


def _write(path: Path, maps: Maps, options: Options) -> Written:
    """Write what there is of ``depth`` and ``std`` in metres, ``confidence`` in (0, 1], and ``relative``."""
    known = {"depth": maps.depth, "std": maps.std, "confidence": maps.confidence, "relative": maps.relative}
    # Any: NumPy's own keyword `allow_pickle` has another type.
    arrays: dict[str, Any] = {
        name: values.astype(np.float32, copy=False) for name, values in known.items() if values is not None
    }
    if not arrays:
        raise InputError(f"there is no map to write to {path}: give depth or relative")
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)
    return Written()


NPZ = Output(
    ".npz", "the arrays depth, std and confidence, or relative", _write, suffixes=(".npz",), maps=("depth", "relative")
)
