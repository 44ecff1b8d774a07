"""From a large photo to metres with detail beyond the network's size: the network sees it whole, and in tiles."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float32
from PIL import Image

from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError
from zoedepth.geometry.choice import CameraChoice
from zoedepth.predict import Predictor

Tiles = tuple[int, int] | Literal["auto"]
"""(rows, columns) of the tiles in which a photo is seen, or "auto": as many as its pixels are worth."""

OVERLAP = 0.25
"""Share of a tile that the next one sees, too."""
MOST_AUTO = 4
"""Rows and columns of tiles that "auto" takes, at most."""
MOST = 32
"""Rows or columns of tiles that can be asked for, at most."""

_REACH = 8  # network pixels of the whole, to each side, within which a tile is made to agree with the whole
_AT_ONCE, _PIXELS_AT_ONCE = 4, 1 << 22  # tiles that are predicted at the same time, and pixels of the photo in them


def read_tiles(word: str) -> Tiles:
    """Return the tiles that a word means: "auto", or rows and columns such as "4x6".

    Raises:
        InputError: it is no such word, or there are too many.
    """
    found = re.fullmatch(r"([1-9]\d?)x([1-9]\d?)", word)
    if word != "auto" and found is None:
        raise InputError(f"tiles (--tiles) are auto, or rows x columns such as 4x6, up to {MOST}x{MOST}; got {word!r}")
    tiles: Tiles = "auto" if found is None else (int(found[1]), int(found[2]))
    check_tiles(tiles)
    return tiles


def check_tiles(tiles: Tiles) -> None:
    """Refuse what is no number of tiles.

    Raises:
        InputError: ``tiles`` is neither "auto" nor (rows, columns), or asks for more than ``MOST`` rows or columns.
    """
    if tiles == "auto":
        return
    if not isinstance(tiles, tuple) or len(tiles) != 2 or not all(isinstance(n, int) and 1 <= n <= MOST for n in tiles):
        raise InputError(f"tiles must be 'auto' or (rows, columns), each from 1 to {MOST}; got {tiles!r}")


@dataclass(frozen=True)
class Grid:
    """The places of tiles in a photo: rows and columns of one size, of which neighbours overlap."""

    size: tuple[int, int]
    """(height, width) of the photo."""
    rows: int
    columns: int

    @property
    def tile(self) -> tuple[int, int]:
        """(height, width) of each tile, pixels of the photo."""
        return _length(self.size[0], self.rows), _length(self.size[1], self.columns)

    @property
    def tops(self) -> list[int]:
        """The first line of each row of tiles."""
        return _starts(self.size[0], self.rows)

    @property
    def lefts(self) -> list[int]:
        """The first column of the photo in each column of tiles."""
        return _starts(self.size[1], self.columns)

    @property
    def windows(self) -> tuple[list[Float32[np.ndarray, " height"]], list[Float32[np.ndarray, " width"]]]:
        """The weights down each row of tiles, and those across each column: a pixel of a tile has their product.

        They fall towards the border of a tile where it overlaps with others. At each pixel of the photo the weights of
        all tiles sum up to 1.
        """
        (height, width), (tile_height, tile_width) = self.size, self.tile
        return _windows(self.tops, tile_height, height), _windows(self.lefts, tile_width, width)


def predict_tiled(
    predictor: Predictor,
    image: Any,
    *,
    tiles: Tiles = "auto",
    domain: str | None = None,
    camera: CameraChoice | None = None,
) -> DepthMap:
    """Predict the depth of a large photo with detail that the network does not see when it sees the photo whole.

    The photo as a whole gives the metres. Then the network sees overlapping tiles of it, each enlarged, with the tile's
    own camera and the head that the whole took. Each tile is made to agree with the whole (``agree``), and the tiles
    are averaged with weights that fall to their borders. Beyond what the whole alone takes, memory grows with one row
    of tiles.

    Args:
        predictor: a predictor of a model for ordinary photos.
        image: the photo, see ``Predictor``.
        tiles: how many. "auto" takes as many as let the network see the photo at its own size, and ``MOST_AUTO`` rows
            and columns at most. A photo that is hardly larger than what the network sees takes none.
        domain: scene type whose head to use; None leaves it to the model's router, which sees the whole.
        camera: the camera of the photo, see ``Predictor``.

    Returns:
        The depth map. Its ``tiles`` say how many were taken; None: none, and it is that of ``predictor(image)``.

    Raises:
        InputError: the photo cannot be read or predicted, ``tiles`` is wrong, or tiles are so small that the network
            sees nothing more in them than in the whole.
    """
    check_tiles(tiles)
    whole = predictor(image, domain=domain, camera=camera)
    grid = Grid(whole.size, *(_worth(whole) if tiles == "auto" else tiles))
    if (grid.rows, grid.columns) == (1, 1):
        return whole
    _check_worth(whole, grid)
    depth, std = whole.depth, whole.std
    for lines, log in _lines(predictor, whole, grid):
        # What lies beyond the range stays beyond it, as in the whole: it is not valid there either.
        finer = np.exp(log, out=log).clip(whole.depth_range[0], None, out=log)
        if std is not None:
            std[lines] *= finer / depth[lines]
        depth[lines] = finer
    return replace(whole, tiles=(grid.rows, grid.columns))


def agree(
    tile: Float32[np.ndarray, "height width"],
    whole: Float32[np.ndarray, "height width"],
    pixel: tuple[float, float],
) -> Float32[np.ndarray, "height width"]:
    """Return the depth of a tile with the metres of the whole and the detail of its own; both are logarithms of metres.

    The tile is shifted everywhere by the mean of its difference to the whole around that place: so it is the whole
    where both are blurred, and no seam is left at its border. A network blurs depth over many of its pixels; what is
    blurred less than ``_REACH`` would show edges of the whole beside those of the tile.

    Args:
        tile: the depth of a tile, at its place in the photo.
        whole: the depth of the whole photo there.
        pixel: (height, width) of a pixel of the whole's network input, in pixels of the photo.
    """
    height, width = tile.shape
    size = (max(1, round(height / pixel[0])), max(1, round(width / pixel[1])))
    shift = _mean(_resized(whole - tile, size, Image.Resampling.BOX))
    return tile + _resized(shift, (height, width), Image.Resampling.BICUBIC)


def _lines(predictor: Predictor, whole: DepthMap, grid: Grid) -> Iterator[tuple[slice, Float32[np.ndarray, "_ _"]]]:
    """Yield the logarithm of the finer depth, some lines of the photo at a time, from the top to the bottom.

    Lines that were yielded are not looked at again: the finer depth may be written in place of the whole's. They may be
    changed until the next ones are asked for.
    """
    (height, width), (tile_height, tile_width) = grid.size, grid.tile
    down, across = grid.windows
    total = np.zeros((tile_height, width), np.float32)
    for top, below, weights in zip(grid.tops, (*grid.tops[1:], height), down, strict=True):
        for (left, log), others in zip(_row(predictor, whole, grid, top), across, strict=True):
            log *= weights[:, None]
            log *= others
            total[:, left : left + tile_width] += log
        done = below - top
        yield slice(top, below), total[:done]
        total[: tile_height - done] = total[done:]
        total[tile_height - done :] = 0


def _row(
    predictor: Predictor, whole: DepthMap, grid: Grid, top: int
) -> Iterator[tuple[int, Float32[np.ndarray, "_ _"]]]:
    """Yield the first column and the logarithm of depth of each tile of a row, made to agree with the whole."""
    height, width = grid.tile
    pixel = (grid.size[0] / whole.network_size[0], grid.size[1] / whole.network_size[1])
    step = max(1, min(_AT_ONCE, _PIXELS_AT_ONCE // (height * width)))
    for first in range(0, grid.columns, step):
        lefts = grid.lefts[first : first + step]
        places = [np.s_[top : top + height, left : left + width] for left in lefts]
        cameras = [whole.camera.cropped(top, left, (height, width)) for left in lefts]
        parts = predictor.parts([whole.image[place] for place in places], cameras, domain=whole.domain)
        for left, place, part in zip(lefts, places, parts, strict=True):
            yield left, agree(np.log(part.depth), np.log(whole.depth[place]), pixel)


def _worth(whole: DepthMap) -> tuple[int, int]:
    """Return the rows and columns of tiles in which the network sees the photo at its own size, as many as help."""
    zoom = min(side / seen for side, seen in zip(whole.size, whole.network_size, strict=True))
    n = min(MOST_AUTO, max(1, round((zoom - OVERLAP) / (1 - OVERLAP))))
    return n, n


def _check_worth(whole: DepthMap, grid: Grid) -> None:
    for side, seen, name in zip(grid.tile, whole.network_size, ("high", "wide"), strict=True):
        if 2 * side < seen:
            raise InputError(
                f"{grid.rows} x {grid.columns} tiles of a photo of {whole.size[1]} x {whole.size[0]} pixels are {side} "
                f"pixels {name}, less than half of what the network sees of the whole ({seen}): they show no more. "
                "Take fewer tiles, or none"
            )


def _length(side: int, count: int) -> int:
    return min(side, math.ceil(side / (count - (count - 1) * OVERLAP)))


def _starts(side: int, count: int) -> list[int]:
    return [round(number * (side - _length(side, count)) / max(count - 1, 1)) for number in range(count)]


def _windows(starts: list[int], length: int, side: int) -> list[Float32[np.ndarray, " length"]]:
    """Return the weights of the pixels of each tile along a side. At the border of the photo they do not fall."""
    ramp = max(1, int(length * OVERLAP))
    rise = np.sin((np.arange(ramp) + 0.5) / ramp * (math.pi / 2)) ** 2
    windows, total = [], np.zeros(side)
    for start in starts:
        weights = np.ones(length)
        if start > 0:
            weights[:ramp] *= rise
        if start + length < side:
            weights[length - ramp :] *= rise[::-1]
        total[start : start + length] += weights
        windows.append(weights)
    return [
        (weights / total[start : start + length]).astype(np.float32)
        for start, weights in zip(starts, windows, strict=True)
    ]


def _mean(x: Float32[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Return the mean of what is within ``_REACH`` of each place; beyond the border, the border goes on."""
    n = 2 * _REACH + 1
    for _ in range(2):  # down, then across
        sums = np.cumsum(np.pad(x, ((_REACH + 1, _REACH), (0, 0)), mode="edge"), axis=0, dtype=np.float64)
        x = ((sums[n:] - sums[:-n]) / n).T
    return x.astype(np.float32)


def _resized(
    x: Float32[np.ndarray, "_ _"], size: tuple[int, int], how: Image.Resampling
) -> Float32[np.ndarray, "height width"]:
    return np.asarray(Image.fromarray(x).resize((size[1], size[0]), how))
