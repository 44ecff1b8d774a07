"""Metres as a 16-bit grey PNG that says its scale."""

from pathlib import Path

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from zoedepth.geometry.points import known_depth
from zoedepth.images import PNG_MAX, PNG_SCALE_KITTI, PNG_SCALE_MILLIMETRE, atomic_path
from zoedepth.outputs.output import Maps, Options, Output, Written, check_map, check_png_scale, needed
from zoedepth.stored import SCALE_KEY


def write_depth_png(
    path: str | Path, depth: np.ndarray, *, scale: float = PNG_SCALE_MILLIMETRE, along: str = "optical axis"
) -> None:
    """Write metres as a 16-bit grey PNG: value = round(depth * scale), 0 = no depth.

    Depth too far for the file is clipped to 65535 and never wraps around; depth too near becomes 1, so that a valid
    pixel stays valid. Non-finite and non-positive depth becomes 0. The text chunks ``DepthScale`` and ``DepthUnit`` say
    how to read the file back.

    Args:
        path: where to write; missing folders are made.
        depth: (height, width), metres.
        scale: PNG levels per metre; 1000 is millimetres (up to 65.535 m), 256 is KITTI's (up to 255.996 m).
        along: the line along which depth is measured, for the description in the file: see ``Maps.depth_along``.

    Raises:
        InputError: depth is not two-dimensional, or the scale is not a positive number.
    """
    check_png_scale(scale)
    depth = check_map(depth)
    valid = np.isfinite(depth) & (depth > 0)
    levels = np.where(valid, depth, 0).astype(np.float64)
    levels *= scale
    np.clip(np.rint(levels, out=levels), valid, PNG_MAX, out=levels)  # from 1 where valid
    levels = levels.astype(np.uint16)
    text = PngInfo()
    text.add_text(SCALE_KEY, f"{scale:.10g}")
    text.add_text("DepthUnit", "metre")
    text.add_text("Description", f"depth along the {along} in metres = value / {scale:.10g}; 0 = no depth")
    with atomic_path(path) as temporary:
        # Level 1 of zlib takes a quarter of the time of Pillow's 6, for a file a quarter larger.
        Image.fromarray(levels).save(temporary, format="PNG", pnginfo=text, compress_level=1)


def fitting_scale(depth: np.ndarray) -> float:
    """Return the PNG levels per metre that ``depth`` fits: 1000 (millimetres) up to 65.535 m, else 256 (KITTI's)."""
    valid = depth[np.isfinite(depth)]
    fits = valid.size == 0 or valid.max() * PNG_SCALE_MILLIMETRE <= PNG_MAX
    return PNG_SCALE_MILLIMETRE if fits else PNG_SCALE_KITTI


def _write(path: Path, maps: Maps, options: Options) -> Written:
    depth = needed(maps, "depth")
    scale = fitting_scale(depth) if options.png_scale is None else options.png_scale
    write_depth_png(path, depth, scale=scale, along=maps.depth_along)
    notes = []
    if options.png_scale is None and scale != PNG_SCALE_MILLIMETRE:
        notes.append("beyond 65.535 m: the PNG has 256 levels per metre, not 1000")
    levels = depth[known_depth(depth)].astype(np.float64) * scale
    if levels.size and np.rint(levels.max()) > PNG_MAX:
        notes.append("clipped: too far for the scale of the PNG; a smaller --png-scale (scale=) fits more")
    if levels.size and np.rint(levels.min()) < 1:
        notes.append("clipped: too near for the scale of the PNG; a larger --png-scale (scale=), or an EXR, tells it")
    return Written({"png_scale": scale}, tuple(notes))


DEPTH = Output("_depth.png", "metres as a 16-bit PNG", _write, suffixes=(".png",))
