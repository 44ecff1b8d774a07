"""Metres as a portable float map, the format of stereo benchmarks and of MiDaS."""

from pathlib import Path

import numpy as np

from zoedepth.images import atomic_path
from zoedepth.outputs.output import Maps, Options, Output, Written, check_map, known_or_zero, needed


def write_pfm(path: str | Path, depth: np.ndarray) -> None:
    """Write metres as a portable float map of one channel, in little-endian order, the bottom row first.

    Args:
        path: where to write; missing folders are made.
        depth: (height, width), metres. Depth that is not a finite number above 0 becomes 0.

    Raises:
        InputError: depth is not two-dimensional.
    """
    depth = known_or_zero(check_map(depth))
    height, width = depth.shape
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(f"Pf\n{width} {height}\n-1.0\n".encode())  # a number below 0 stands for little-endian
        file.write(np.ascontiguousarray(depth[::-1], "<f4").data)


def _write(path: Path, maps: Maps, options: Options) -> Written:
    write_pfm(path, needed(maps, "depth"))
    return Written()


PFM = Output("_depth.pfm", "metres as a portable float map", _write, suffixes=(".pfm",))
