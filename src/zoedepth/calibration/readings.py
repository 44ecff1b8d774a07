"""Readings: what was measured at places of a photo, and what the depth map says there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from zoedepth.data.plausible import POSSIBLE, UNIT, find_mark, glance
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import known_depth
from zoedepth.images import DepthArray

Point: TypeAlias = tuple[float, float, float]
"""(x, y, metres): column and row of a pixel, and how far the thing is that it sees."""
Distance: TypeAlias = tuple[tuple[float, float], tuple[float, float], float]
"""((x, y), (x, y), metres): two pixels, and how far apart in space the things are that they see."""

MAX_USED = 1000
"""Number of readings of a sparse map that are used, evenly spread; more would tell nothing new."""
JUMP = 1.1
"""Ratio of the depths around a pixel from which on near and far meet there: one or two pixels in a hundred."""

_BORDER = 0.1  # of each side, where no place is proposed
_PLACES = 12  # along a side, among which places are proposed
_WINDOW = 0.006  # of the shorter side: how far around a pixel depth is looked at
_ROUGH = 0.05
"""Change of the log depth around a pixel that makes its error 1.4 times as large. Measured with zoed-lite on NYU's test
set: where the farthest depth around is 2, 5, 10 and 20 % beyond the nearest, the median error is 0.08, 0.10, 0.16 and
0.25."""


@dataclass(frozen=True)
class Reading:
    """A measurement beside the depth that it was compared with."""

    points: tuple[tuple[float, float], ...]
    """Column and row of the pixel; of both, where the distance of two points was measured."""
    metres: float
    """Measured metres: depth along the optical axis, or the distance of the two points."""
    before: float
    """Metres that the depth as it was gives there."""
    after: float
    """Metres that the calibrated depth gives there."""
    outlier: bool = False
    """True where it does not fit the other readings, and was left out."""
    at_jump: bool = False
    """True where it lies at a border between near and far: the median of the pixels around was taken."""
    spread: float = 1.0
    """Number of times as uncertain as the depth of a pixel on smooth ground it is."""
    photo: str = ""
    """Name of the photo, where there are several."""

    @property
    def place(self) -> str:
        """Column and row of each point, e.g. "320,240"."""
        return ",".join(f"{value:g}" for point in self.points for value in point)

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
    roughness: Float[np.ndarray, "readings 2"]
    """See ``roughness_at``; NaN where there is no second point."""

    @property
    def at_jump(self) -> Bool[np.ndarray, " readings"]:
        """True where near and far meet at one of the points."""
        return np.nanmax(self.roughness, axis=1) > math.log(JUMP)

    @property
    def single(self) -> bool:
        """True if no reading is a distance of two points."""
        return bool(np.isnan(self.depth[:, 1]).all())

    def compared(self, power: float) -> Float[np.ndarray, " readings"]:
        """Return what was measured as depth ** power has it, metres."""
        first, second = (self.depth[:, i, None] ** power * self.rays[:, i] for i in (0, 1))
        return np.linalg.norm(first - np.nan_to_num(second), axis=-1)

    @property
    def spread(self) -> Float[np.ndarray, " readings"]:
        """How many times as uncertain each reading is as the depth of a pixel on smooth ground.

        A distance along the line of sight is the small difference of two large depths, and very uncertain. Errors of
        two points on one surface are alike, so that no distance is less uncertain than a depth.
        """
        spread = spread_of(self.roughness)
        first, second = (self.depth[:, i, None] * self.rays[:, i] for i in (0, 1))
        between = first - second
        slopes = np.stack([np.sum(first * between, axis=-1), np.sum(second * between, axis=-1)], axis=-1)
        variance = np.sum((slopes * spread) ** 2, axis=-1) / np.sum(between**2, axis=-1) ** 2
        return np.where(np.isnan(variance), spread[:, 0], np.sqrt(np.maximum(1, variance)))


def measure(
    depth: DepthArray,
    readings: Sequence[Point | Distance] | Float[np.ndarray, "_ _"],
    camera: Camera | None,
    known: Bool[np.ndarray, "height width"],
    *,
    along_ray: bool,
) -> Measured:
    """Look up the depth at the places of readings; see ``fit.calibrate``.

    Raises:
        InputError: there is no reading, or one cannot be compared with the depth.
    """
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
        listed = _thinned([_checked(reading, depth.shape) for reading in readings], known)
    if not listed:
        raise InputError("there is no reading: give at least one point and its depth in metres")
    depths, roughness = np.full((len(listed), 2), np.nan), np.full((len(listed), 2), np.nan)
    rays = np.tile(np.array([0.0, 0.0, 1.0]), (len(listed), 2, 1))
    for i in (0, 1):
        here = [row for row, (points, _) in enumerate(listed) if i < len(points)]
        if not here:
            continue
        columns, rows = np.floor(np.array([listed[row][0][i] for row in here]) + 0.5).astype(int).T
        rows, columns = rows.clip(0, depth.shape[0] - 1), columns.clip(0, depth.shape[1] - 1)
        for row in np.array(here)[~known[rows, columns]]:
            raise InputError(
                f"the reading {_name(*listed[row])} is at a pixel without valid depth: measure at another place"
            )
        around = _around(depth, known, rows, columns)
        roughness[here, i] = _roughness(around)
        jump = roughness[here, i] > math.log(JUMP)
        depths[here, i] = depth[rows, columns]
        depths[np.array(here)[jump], i] = np.nanmedian(around[jump], axis=1)
    for row, (points, metres) in enumerate(listed):
        if len(points) == 2 and camera is None:
            raise InputError(f"the distance {_name(points, metres)} needs the camera: pass camera=")
        if camera is not None and (along_ray or len(points) == 2):
            rays[row, : len(points)] = [camera.ray(*point) for point in points]
    return Measured([points for points, _ in listed], np.array([m for _, m in listed]), depths, rays, roughness)


def places_to_measure(depth: DepthArray, valid: Bool[np.ndarray, "height width"]) -> list[tuple[int, int]]:
    """Return (column, row) of places that are good to measure: smooth, away from the border, near, middle and far.

    Three places, or fewer where little of the photo has valid depth.
    """
    height, width = depth.shape
    rows, columns = (
        np.linspace(_BORDER * side, (1 - _BORDER) * (side - 1), _PLACES).round().astype(int) for side in depth.shape
    )
    rows, columns = (places.ravel() for places in np.meshgrid(rows, columns, indexing="ij"))
    here = valid[rows, columns]
    rows, columns = rows[here], columns[here]
    if not len(rows):
        return []
    rough = roughness_at(depth, valid, rows, columns)
    smooth = np.flatnonzero(rough <= np.median(rough))
    chosen: list[int] = []
    for third in np.array_split(smooth[np.argsort(depth[rows, columns][smooth], kind="stable")], 3):
        if len(third):
            # In each third of the depths, the place that is farthest from those chosen before, or from the middle.
            others = [(rows[i] / height, columns[i] / width) for i in chosen] or [(0.5, 0.5)]
            away = [min(math.hypot(rows[i] / height - y, columns[i] / width - x) for y, x in others) for i in third]
            chosen.append(int(third[int(np.argmax(away)) if chosen else int(np.argmin(away))]))
    return [(int(columns[i]), int(rows[i])) for i in chosen]


def roughness_at(
    depth: DepthArray,
    known: Bool[np.ndarray, "height width"],
    rows: Int[np.ndarray, " places"],
    columns: Int[np.ndarray, " places"],
) -> Float[np.ndarray, " places"]:
    """Return the logarithm of the farthest over the nearest depth around pixels with known depth."""
    return _roughness(_around(depth, known, rows, columns))


def spread_of(roughness: Float[np.ndarray, "*places"]) -> Float[np.ndarray, "*places"]:
    """Return how many times as uncertain depth is as on smooth ground, given how rough it is around."""
    return np.sqrt(1 + (roughness / _ROUGH) ** 2)


_Listed = tuple[tuple[tuple[float, float], ...], float]
"""A point, or the two of a distance, and metres."""


def _of_map(sparse: Float[np.ndarray, "height width"], known: Bool[np.ndarray, "height width"]) -> list[_Listed]:
    """Return the readings of a sparse depth map, spread evenly over it where they are many."""
    measured = known_depth(sparse)
    _refuse_mark(sparse[measured], "sparse depth map")
    rows, columns = np.nonzero(measured & known)
    if not len(rows):
        raise InputError("the sparse depth map has no reading at a pixel with valid depth: is it of this photo?")
    median = float(np.median(sparse[rows, columns]))
    if not POSSIBLE[0] <= median <= POSSIBLE[1]:
        raise InputError(f"the median of the sparse depth map is {median:.4g} m. {UNIT}")
    kept = slice(None, None, -(-len(rows) // MAX_USED))
    rows, columns = rows[kept], columns[kept]
    return [
        (((float(x), float(y)),), float(metres))
        for x, y, metres in zip(columns, rows, sparse[rows, columns], strict=True)
    ]


def _thinned(listed: list[_Listed], known: Bool[np.ndarray, "height width"]) -> list[_Listed]:
    """Return some of very many readings, as of a sparse depth map: nobody has typed them, one by one."""
    if len(listed) <= MAX_USED:
        return listed
    _refuse_mark(np.array([metres for _, metres in listed], np.float32), "readings")
    places = (np.floor(np.array([points[0] for points, _ in listed]) + 0.5).astype(int)).T
    here = known[places[1].clip(0, known.shape[0] - 1), places[0].clip(0, known.shape[1] - 1)]
    kept = [reading for reading, there in zip(listed, here, strict=True) if there or len(reading[0]) > 1]
    if not kept:
        raise InputError("no reading is at a pixel with valid depth: are they of this photo?")
    return kept[:: -(-len(kept) // MAX_USED)]


def _refuse_mark(metres: Float[np.ndarray, " readings"], what: str) -> None:
    """Refuse measured depths of which many are one large value that stands for unknown."""
    mark = find_mark([glance("", "", metres)])
    if mark is not None and mark.certain:
        raise InputError(
            f"{mark.share:.1%} of the {what} hold the largest value, {mark.value:.6g} m, and nearly all others are "
            f"nearer than {mark.others:.4g} m: it stands for unknown. Write 0 there, or leave them out"
        )


def _checked(reading: Any, size: tuple[int, ...]) -> _Listed:
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


def _around(
    depth: DepthArray,
    known: Bool[np.ndarray, "height width"],
    rows: Int[np.ndarray, " places"],
    columns: Int[np.ndarray, " places"],
) -> Float[np.ndarray, "places pixels"]:
    """Return the depths in the squares around pixels, NaN where there is none."""
    reach = max(1, round(_WINDOW * min(depth.shape)))
    down, across = (places.ravel() for places in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    rows = (rows[:, None] + down).clip(0, depth.shape[0] - 1)
    columns = (columns[:, None] + across).clip(0, depth.shape[1] - 1)
    return np.where(known[rows, columns], depth[rows, columns], np.nan).astype(np.float64)


def _roughness(around: Float[np.ndarray, "places pixels"]) -> Float[np.ndarray, " places"]:
    return np.log(np.nanmax(around, axis=1) / np.nanmin(around, axis=1))


def _name(points: tuple[tuple[float, float], ...], metres: float) -> str:
    return f"{','.join(f'{value:g}' for point in points for value in point)}={metres:g}"
