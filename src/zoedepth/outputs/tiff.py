"""Metres as a TIFF of float32."""

from pathlib import Path

import numpy as np
from PIL import Image

from zoedepth.images import OWN_MARK, atomic_path
from zoedepth.outputs.output import Maps, Options, Output, Written, check_map, known_or_zero, needed


def write_tiff(path: str | Path, depth: np.ndarray, *, along: str = "optical axis") -> None:
    """Write metres as a TIFF of one channel of float32, not compressed, which every reader of TIFF takes.

    Args:
        path: where to write; missing folders are made.
        depth: (height, width), metres. Depth that is not a finite number above 0 becomes 0.
        along: the line along which depth is measured, for the description in the file: see ``Maps.depth_along``.

    Raises:
        InputError: depth is not two-dimensional.
    """
    picture = Image.fromarray(known_or_zero(check_map(depth)))
    with atomic_path(path) as temporary:
        picture.save(
            temporary, format="TIFF", software=OWN_MARK, description=f"depth along the {along} in metres; 0 = none"
        )


def _write(path: Path, maps: Maps, options: Options) -> Written:
    write_tiff(path, needed(maps, "depth"), along=maps.depth_along)
    return Written()


TIFF = Output("_depth.tiff", "metres as a TIFF of float32", _write, suffixes=(".tiff", ".tif"))
