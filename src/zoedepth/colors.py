"""Depth as a picture: colour tables, a bar with the metres, and the photo beside its depth.

The tables are matplotlib's, 256 colours each, baked into ``assets/colormaps.npz`` so that matplotlib is not needed:
magma (S. van der Walt and N. Smith, CC0), Spectral (C. Brewer's ColorBrewer, Apache 2.0), turbo (A. Mikhailov, Google,
Apache 2.0).
"""

import math
from collections.abc import Sequence
from functools import cache
from importlib.resources import files

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from zoedepth.errors import InputError, no_such
from zoedepth.images import ImageArray

COLORMAPS = ("magma", "turbo", "gray", "Spectral")
"""Names of the colour tables. Each also exists reversed, with ``_r`` at the end of its name."""

INVALID_COLOR = (128, 128, 128)
_PAPER, _INK = (255, 255, 255), (20, 20, 20)


def colorize(
    depth: np.ndarray,
    *,
    vmin: float | None = None,
    vmax: float | None = None,
    percentiles: tuple[float, float] = (2.0, 85.0),
    colormap: str = "magma_r",
) -> ImageArray:
    """Colour a depth map: from the table's first colour at ``vmin`` and nearer to its last at ``vmax`` and farther.

    Args:
        depth: (height, width), metres. Non-finite or non-positive depth is invalid, and grey in the picture.
        vmin: depth of the first colour; None takes the lower percentile. Fix both to compare pictures.
        vmax: depth of the last colour; None takes the upper percentile.
        percentiles: the percentiles of the valid depths; ZoeDepth was published with (2, 85).
        colormap: one of ``COLORMAPS``, reversed with ``_r`` at its end.

    Raises:
        InputError: there is no such colour map.
    """
    vmin, vmax = depth_range(depth, vmin=vmin, vmax=vmax, percentiles=percentiles)
    valid = _valid(depth)
    fraction = (np.where(valid, depth, vmin) - vmin) / (vmax - vmin)
    colors = _color_table(colormap)[(fraction.clip(0, 1) * 255).round().astype(np.uint8)]
    colors[~valid] = INVALID_COLOR
    return colors


def depth_range(
    depth: np.ndarray,
    *,
    vmin: float | None = None,
    vmax: float | None = None,
    percentiles: tuple[float, float] = (2.0, 85.0),
) -> tuple[float, float]:
    """Return the depths (metres) of the first and the last colour: as given, or else percentiles of the valid depth.

    Raises:
        InputError: one that is given is not finite, or both are given and vmin is not below vmax.
    """
    for name, given in (("vmin", vmin), ("vmax", vmax)):
        if given is not None and not math.isfinite(given):
            raise InputError(f"{name} must be a finite number of metres, got {given}")
    if vmin is not None and vmax is not None and not vmin < vmax:
        raise InputError(f"vmin must be below vmax, got {vmin} and {vmax}")
    valid = depth[_valid(depth)]
    low, high = np.percentile(valid, percentiles) if valid.size else (0.0, 1.0)
    first = float(low if vmin is None else vmin)
    last = float(high if vmax is None else vmax)
    if last - first >= 1e-6:
        return first, last
    # One depth everywhere, or all of it beyond what was given: any span will do, and the bar must have one.
    if vmax is None:
        return first, first + _span(first)
    return last - _span(last), last


def _span(metres: float) -> float:
    return max(0.01 * abs(metres), 1e-3)


def color_bar(height: int, *, vmin: float, vmax: float, colormap: str = "magma_r", unit: str = "m") -> ImageArray:
    """Draw a vertical bar from ``vmin`` (bottom) to ``vmax`` (top) with ticks at round numbers, e.g. "2.5 m".

    Args:
        height: height of the bar in pixels. Less than 60 leaves no room for labels, so 60 is taken then.
        vmin: value of the first colour.
        vmax: value of the last colour, above vmin.
        colormap: see ``colorize``.
        unit: written after each number.
    """
    height = max(height, 60)
    size = _font_size(height)
    font = ImageFont.load_default(size)
    values = _ticks(vmin, vmax, count=max(2, min(6, height // (3 * size))))
    decimals = next((n for n in range(4) if np.allclose(values, np.round(values, n), atol=1e-6 * (vmax - vmin))), 4)
    labels = [f"{value:.{decimals}f} {unit}" for value in values]
    text_width = int(max(font.getlength(label) for label in labels)) + 1
    bar_width, tick, margin = size, max(2, size // 4), size // 2

    canvas = Image.new("RGB", (margin + bar_width + tick + margin + text_width + margin, height), _PAPER)
    colors = _color_table(colormap)[np.linspace(255, 0, height).round().astype(int)]
    canvas.paste(Image.fromarray(np.repeat(colors[:, None], bar_width, axis=1)), (margin, 0))
    draw = ImageDraw.Draw(canvas)
    for value, label in zip(values, labels, strict=True):
        y = round((vmax - value) / (vmax - vmin) * (height - 1))
        draw.line([(margin + bar_width, y), (margin + bar_width + tick, y)], fill=_INK, width=max(1, size // 12))
        y_text = min(max(y, size // 2 + 1), height - size // 2 - 2)  # whole labels at both ends
        draw.text((margin + bar_width + tick + margin // 2, y_text), label, font=font, fill=_INK, anchor="lm")
    return np.array(canvas)


def panel(
    image: ImageArray, *, size: tuple[int, int] | None = None, bar: ImageArray | None = None, caption: str = ""
) -> ImageArray:
    """Draw one picture of a sheet: resized to ``size`` (height, width), with a bar to its right and a caption above."""
    height, width = size or image.shape[:2]
    picture = Image.fromarray(image)
    if size and size != image.shape[:2]:
        enlarged = height > image.shape[0]
        picture = picture.resize((width, height), Image.Resampling.NEAREST if enlarged else Image.Resampling.LANCZOS)
    line = _font_size(height) if caption else 0
    top = line + line // 2
    bar_height, bar_width = (0, 0) if bar is None else bar.shape[:2]
    canvas = Image.new("RGB", (width + bar_width, top + max(height, bar_height)), _PAPER)
    if caption:
        ImageDraw.Draw(canvas).text((2, top // 2), caption, font=ImageFont.load_default(line), fill=_INK, anchor="lm")
    canvas.paste(picture, (0, top))
    if bar is not None:
        canvas.paste(Image.fromarray(bar), (width, top))
    return np.array(canvas)


def sheet(rows: Sequence[Sequence[ImageArray]], *, gap: int = 12) -> ImageArray:
    """Draw panels in rows on white paper. Each column is as wide as its widest panel."""
    heights = [max(item.shape[0] for item in row) for row in rows]
    n_columns = max(len(row) for row in rows)
    widths = [max(row[i].shape[1] for row in rows if i < len(row)) for i in range(n_columns)]
    page = np.full((sum(heights) + gap * (len(rows) + 1), sum(widths) + gap * (n_columns + 1), 3), _PAPER, np.uint8)
    y = gap
    for row, height in zip(rows, heights, strict=True):
        x = gap
        for item, width in zip(row, widths, strict=False):
            page[y : y + item.shape[0], x : x + item.shape[1]] = item
            x += width + gap
        y += height + gap
    return page


def preview(
    image: ImageArray,
    depth: np.ndarray,
    *,
    vmin: float | None = None,
    vmax: float | None = None,
    percentiles: tuple[float, float] = (1.0, 99.0),
    colormap: str = "magma_r",
    unit: str = "m",
    max_side: int = 960,
) -> ImageArray:
    """Draw the photo beside its depth with a bar in metres, or above it when the photo is much wider than high.

    Args:
        image: uint8 (height, width, 3), RGB.
        depth: (height, width), metres.
        vmin: depth of the first colour, see ``colorize``.
        vmax: depth of the last colour.
        percentiles: see ``colorize``; wider here, so that the bar covers nearly everything in the picture.
        colormap: see ``colorize``.
        unit: unit of the numbers at the bar.
        max_side: the longer side of each of the two pictures. Small photos are enlarged to at least 320.
    """
    height, width = image.shape[:2]
    longer = max(height, width)
    step = max(1, longer // max_side)
    depth = depth[::step, ::step]  # no more pixels than are shown: colouring 50 megapixels takes seconds
    vmin, vmax = depth_range(depth, vmin=vmin, vmax=vmax, percentiles=percentiles)
    scale = min(max(longer, min(320, max_side)), max_side) / longer
    size = (max(1, round(height * scale)), max(1, round(width * scale)))
    bar = color_bar(max(size[0], 120), vmin=vmin, vmax=vmax, colormap=colormap, unit=unit)
    left, right = panel(image, size=size), panel(colorize(depth, vmin=vmin, vmax=vmax, colormap=colormap), size=size)
    right = panel(right, bar=bar)
    return sheet([[left], [right]] if width > 2 * height else [[left, right]])


def preview_relative(image: ImageArray, relative: np.ndarray, *, colormap: str = "magma") -> ImageArray:
    """Draw the photo beside its relative depth in percent: 0 is the farthest of this photo, 100 the nearest."""
    low, high = float(relative.min()), float(relative.max())
    percent = 100 * (relative - low) / max(high - low, 1e-12)
    # 0 would be drawn as unknown.
    return preview(image, percent.clip(1e-3, None), vmin=0.0, vmax=100.0, colormap=colormap, unit="%")


def _valid(depth: np.ndarray) -> np.ndarray:
    return np.isfinite(depth) & (depth > 0)


def _font_size(height: int) -> int:
    """Return a size that is legible beside a picture of this height."""
    return min(max(12, height // 24), 40)


def _ticks(vmin: float, vmax: float, *, count: int) -> np.ndarray:
    """Return about ``count`` round numbers in [vmin, vmax], at least one: 1, 2 or 5 times a power of ten apart."""
    span = vmax - vmin
    power = 10.0 ** np.floor(np.log10(span / count))
    for step in (power, 2 * power, 5 * power, 10 * power):
        first, last = np.ceil(vmin / step - 1e-9), np.floor(vmax / step + 1e-9)
        if last - first + 1 <= count + 1:
            break
    values = np.arange(first, last + 1) * step + 0.0  # no -0
    return values if values.size else np.array([(vmin + vmax) / 2])


@cache
def _color_tables() -> dict[str, np.ndarray]:
    with (files("zoedepth") / "assets" / "colormaps.npz").open("rb") as file, np.load(file) as baked:
        tables = {name: baked[name] for name in baked.files}
    tables["gray"] = np.arange(256, dtype=np.uint8)[:, None].repeat(3, axis=1)
    return tables


def _color_table(name: str) -> UInt8[np.ndarray, "256 3"]:
    base = name.removesuffix("_r")
    if base not in COLORMAPS:
        raise no_such("colour map", name, [*COLORMAPS, *(f"{known}_r" for known in COLORMAPS)])
    table = _color_tables()[base]
    return table[::-1] if name.endswith("_r") else table
