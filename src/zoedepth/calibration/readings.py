"""Readings: what was measured at places of a photo, and what the depth map says there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import known_depth
from zoedepth.images import DepthArray

Point: TypeAlias = tuple[float, float, float]
"""(x, y, metres): column and row of a pixel, and how far the thing is that it sees."""
Distance: TypeAlias = tuple[tuple[float, float], tuple[float, float], float]
"""((x, y), (x, y), metres): two pixels, and how far apart in space the things are that they see."""

MAX_USED = 10_000
"""Number of readings of a sparse map that are used, evenly spread; more would tell nothing new."""

_WINDOW = 0.006  # of the shorter side: how far around a reading depth is looked at
_JUMP = 1.15  # the ratio of the depths there from which on near and far meet
_JUMP_SPREAD = 2.0  # how many times as uncertain a reading is there


@dataclass(frozen=True)
class Reading:
    """A measurement beside the depth that it was compared with."""

    points: tuple[tuple[float, float], ...]
    """Column and row of the pixel; of both, where the distance of two points was measured."""
    metres: float
    """Measured metres: depth along the optical axis, or the distance of the two points."""
    before: float
    """The same from the depth as it was, metres."""
    after: float
    """The same from the calibrated depth, metres."""
    outlier: bool = False
    """True where it does not fit the other readings, and was left out."""
    at_jump: bool = False
    """True where it lies at a border between near and far: the median of the pixels around was taken."""

    @property
    def name(self) -> str:
        """The reading as `zoedepth calibrate` takes it, e.g. "320,240=2.35"."""
        return _name(self.points, self.metres)

    @property
    def residual(self) -> float:
        """Calibrated over measured, minus 1: 0.05 is 5 % too far."""
        return self.after / self.metres - 1


@dataclass(frozen=True)
class Measured:
    """Readings, and what the depth map says at their places; an entry a reading."""

    points: Sequence[tuple[tuple[float, float], ...]]
    metres: Float[np.ndarray, " readings"]
    depth: Float[np.ndarray, "readings 2"]
    """Metres along the optical axis at the first and the second point; the second is NaN where there is none."""
    rays: Float[np.ndarray, "readings 2 3"]
    """Points at depth 1 that the two pixels see. A point whose depth was measured sees (0, 0, 1): its depth counts."""
    at_jump: Bool[np.ndarray, " readings"]

    @property
    def single(self) -> bool:
        """True if no reading is a distance of two points."""
        return bool(np.isnan(self.depth[:, 1]).all())

    def compared(self, power: float) -> Float[np.ndarray, " readings"]:
        """Return what was measured as depth ** power has it, metres."""
        raised = self.depth**power
        first, second = (raised[:, i, None] * self.rays[:, i] for i in (0, 1))
        return np.linalg.norm(first - np.nan_to_num(second), axis=-1)

    @property
    def spread(self) -> Float[np.ndarray, " readings"]:
        """How many times as uncertain as the depth of one pixel each reading is.

        A distance along the line of sight is the small difference of two large depths.
        """
        first, second = (self.depth[:, i, None] * self.rays[:, i] for i in (0, 1))
        between = first - second
        square = np.sum(between**2, axis=-1)
        slopes = np.stack([np.sum(first * between, axis=-1), np.sum(second * between, axis=-1)]) / square
        both = np.sqrt(np.maximum(1, np.sum(slopes**2, axis=0)))
        return np.where(np.isnan(both), 1.0, both) * np.where(self.at_jump, _JUMP_SPREAD, 1.0)


def measure(
    depth: DepthArray,
    readings: Sequence[Point | Distance] | Float[np.ndarray, "_ _"],
    camera: Camera | None,
    known: Bool[np.ndarray, "height width"],
    *,
    along_ray: bool,
) -> Measured:
    """Look up the depth at the places of the readings, and refuse those that cannot be compared."""
    if along_ray and camera is None:
        raise InputError("readings along the ray need the camera: pass camera=, or measure along the optical axis")
    if isinstance(readings, np.ndarray) and readings.shape == depth.shape:
        listed = _of_map(readings, known)
    elif isinstance(readings, np.ndarray) and (readings.ndim != 2 or readings.shape[1] != 3):
        raise InputError(
            f"readings must be a map of the depth's size {depth.shape} or (N, 3) of x, y and metres; "
            f"they have shape {readings.shape}"
        )
    else:
        listed = [_checked(reading, depth.shape) for reading in readings]
    if not listed:
        raise InputError("there is no reading: give at least one point and its depth in metres")
    depths, rays = np.full((len(listed), 2), np.nan), np.zeros((len(listed), 2, 3))
    at_jump = np.zeros(len(listed), bool)
    for row, (points, metres) in enumerate(listed):
        for i, point in enumerate(points):
            depths[row, i], jump = _depth_at(point, depth, known, _name(points, metres))
            at_jump[row] |= jump
            seen = (along_ray or len(points) == 2) and camera is not None
            rays[row, i] = camera.ray(*point) if seen and camera is not None else (0, 0, 1)
        if len(points) == 2 and camera is None:
            raise InputError(f"the distance {_name(points, metres)} needs the camera: pass camera=")
    return Measured([points for points, _ in listed], np.array([m for _, m in listed]), depths, rays, at_jump)


def _of_map(
    sparse: Float[np.ndarray, "height width"], known: Bool[np.ndarray, "height width"]
) -> list[tuple[tuple[tuple[float, float], ...], float]]:
    """Return the readings of a sparse depth map, spread evenly over it where they are many."""
    rows, columns = np.nonzero(known_depth(sparse) & known)
    if not len(rows):
        raise InputError("the sparse depth map has no reading at a pixel with valid depth: is it of this photo?")
    kept = slice(None, None, -(-len(rows) // MAX_USED))
    rows, columns = rows[kept], columns[kept]
    return [
        (((float(x), float(y)),), float(metres))
        for x, y, metres in zip(columns, rows, sparse[rows, columns], strict=True)
    ]


def _checked(reading: Any, size: tuple[int, ...]) -> tuple[tuple[tuple[float, float], ...], float]:
    """Return the points and the metres of a reading.

    Raises:
        InputError: it is no reading, is outside of the photo, or is not above 0.
    """
    try:
        first, second, metres = reading
        if np.ndim(first):
            points = tuple((float(x), float(y)) for x, y in (first, second))
        else:
            points = ((float(first), float(second)),)
        metres = float(metres)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"a reading is (x, y, metres), or ((x, y), (x, y), metres) for the distance of two points; got {reading!r}"
        ) from error
    name = _name(points, metres)
    if not 0 < metres < math.inf:
        raise InputError(f"the reading {name} must be above 0 and finite, in metres")
    for x, y in points:
        if not (-0.5 <= x < size[1] - 0.5 and -0.5 <= y < size[0] - 0.5):  # also where one is not a number
            raise InputError(
                f"the reading {name} lies outside of the photo, which has columns 0 to {size[1] - 1} and rows 0 to "
                f"{size[0] - 1}: give column, then row, at the photo's own size"
            )
    if len(set(points)) < len(points):
        raise InputError(f"the reading {name} has the same point twice: give two points")
    return points, metres


def _depth_at(
    point: tuple[float, float], depth: DepthArray, known: Bool[np.ndarray, "height width"], name: str
) -> tuple[float, bool]:
    """Return the depth at a pixel, and whether near and far meet there: then it is the median of the pixels around."""
    row, column = (min(round(value), side - 1) for value, side in zip(point[::-1], depth.shape, strict=True))
    if not known[row, column]:
        raise InputError(f"the reading {name} is at a pixel without valid depth: measure at another place")
    reach = max(1, round(_WINDOW * min(depth.shape)))
    around = (slice(max(0, row - reach), row + reach + 1), slice(max(0, column - reach), column + reach + 1))
    near_and_far = depth[around][known[around]]
    if near_and_far.max() > _JUMP * near_and_far.min():
        return float(np.median(near_and_far)), True
    return float(depth[row, column]), False


def _name(points: tuple[tuple[float, float], ...], metres: float) -> str:
    return f"{','.join(f'{value:g}' for point in points for value in point)}={metres:g}"
