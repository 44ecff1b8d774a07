"""Relative depth as a 16-bit grey PNG."""

from pathlib import Path

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from zoedepth.errors import InputError
from zoedepth.images import PNG_MAX, atomic_path
from zoedepth.outputs.output import Maps, Options, Output, Written, check_map, needed


def write_relative_png(path: str | Path, relative: np.ndarray) -> tuple[float, float]:
    """Write relative depth as a 16-bit grey PNG, as MiDaS does: the farthest is 0, the nearest 65535.

    Args:
        path: where to write; missing folders are made.
        relative: (height, width), inverse depth up to scale and shift, finite.

    Returns:
        The least and the greatest value: relative = least + level / 65535 * (greatest - least). They are in the text
        chunks ``RelativeMin`` and ``RelativeMax`` too.

    Raises:
        InputError: relative is not two-dimensional, or not finite.
    """
    relative = check_map(relative, "relative").astype(np.float64)
    if not np.isfinite(relative).all():
        raise InputError("relative depth must be finite, but it holds NaN or infinity: replace these values first")
    low, high = float(relative.min()), float(relative.max())
    levels = np.rint((relative - low) / max(high - low, 1e-12) * PNG_MAX).astype(np.uint16)
    text = PngInfo()
    text.add_text("RelativeMin", f"{low:.10g}")
    text.add_text("RelativeMax", f"{high:.10g}")
    text.add_text("Description", "relative inverse depth, near is large; no unit")
    with atomic_path(path) as temporary:
        Image.fromarray(levels).save(temporary, format="PNG", pnginfo=text)
    return low, high


def _write(path: Path, maps: Maps, options: Options) -> Written:
    return Written({"png_range": list(write_relative_png(path, needed(maps, "relative")))})


RELATIVE = Output("_relative.png", "relative depth as a 16-bit PNG", _write, maps=("relative",))
