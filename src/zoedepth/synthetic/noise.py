"""Tables of noise that repeat: made once, then looked up for each pixel, as sharp as the pixel can show."""

from functools import cache

import numpy as np
from jaxtyping import Float32

SIZE = 512
_LEVELS = 10


class Noise:
    """A table of ``SIZE`` x ``SIZE`` values in [0, 1], around 0.5, with all its halvings."""

    def __init__(self, table: np.ndarray) -> None:
        table = np.clip(0.5 + 0.2 * (table - table.mean()) / table.std(), 0, 1).astype(np.float32)
        levels = [table]
        for _ in range(_LEVELS - 1):
            table = (table[::2, ::2] + table[1::2, ::2] + table[::2, 1::2] + table[1::2, 1::2]) / 4
            levels.append(table)
        self._values = np.concatenate([level.ravel() for level in levels])
        self._starts = np.cumsum([0, *(level.size for level in levels[:-1])]).astype(np.int32)

    def __call__(self, u: np.ndarray, v: np.ndarray, footprint: np.ndarray) -> Float32[np.ndarray, " n"]:
        """Return the noise at points.

        Args:
            u, v: place of each point, in repeats of the table.
            footprint: size of a pixel at each point, in repeats of the table. Finer detail is averaged.
        """
        level = np.clip(np.log2(np.maximum(footprint * SIZE, 1e-6)) + 0.4, 0, _LEVELS - 1).astype(np.int32)
        size = SIZE >> level
        x, y = u * size, v * size
        left, top = np.floor(x), np.floor(y)
        fx, fy = x - left, y - top
        last = size - 1
        # Far from the origin these are large: the cast to int32 wraps them, and the mask keeps the table's period.
        column, row = left.astype(np.int64).astype(np.int32) & last, top.astype(np.int64).astype(np.int32) & last
        below, start = ((row + 1) & last) * size, self._starts[level]
        right, row = (column + 1) & last, row * size
        values = self._values
        upper = values[start + row + column] * (1 - fx) + values[start + row + right] * fx
        lower = values[start + below + column] * (1 - fx) + values[start + below + right] * fx
        return upper * (1 - fy) + lower * fy


@cache
def noise(name: str) -> Noise:
    """Return one of the tables, made on first use.

    Args:
        name: cloud (many octaves), grain (streaks along u), speckle (dots), cells (round patches) or leaf (crisp
            patches).
    """
    rng = np.random.default_rng(7)
    if name == "cloud":
        return Noise(_spectrum(rng, 1.5))
    if name == "grain":
        return Noise(_spectrum(rng, 1.3, stretch=14.0))
    if name == "speckle":
        return Noise(_spectrum(rng, 0.25))
    cells = _cells(rng, 260)
    return Noise(cells if name == "cells" else _spectrum(rng, 1.1) / 2.0 + 1.2 * cells / cells.std())


def _spectrum(rng: np.random.Generator, slope: float, *, stretch: float = 1.0) -> np.ndarray:
    """Return noise of standard deviation 1 whose amplitude falls as frequency^-slope."""
    v, u = np.meshgrid(np.fft.fftfreq(SIZE) * SIZE, np.fft.rfftfreq(SIZE) * SIZE, indexing="ij")
    frequency = np.maximum(np.hypot(u * stretch, v), 1)
    amplitude = np.where(np.hypot(u, v) < 1, 0, frequency**-slope)
    table = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(SIZE, SIZE))) * amplitude)
    return table / table.std()


def _cells(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return the distance of each place on a torus to the nearest of ``count`` random points."""
    half = SIZE // 2
    nearest = np.full((half, half), np.inf, np.float32)
    axis = np.arange(half, dtype=np.float32)
    for x, y in rng.uniform(0, half, (count, 2)):
        dx = np.abs(axis - np.float32(x))
        dy = np.abs(axis - np.float32(y))
        dx, dy = np.minimum(dx, half - dx) ** 2, np.minimum(dy, half - dy) ** 2
        np.minimum(nearest, dy[:, None] + dx, out=nearest)
    return np.sqrt(nearest).repeat(2, 0).repeat(2, 1)
