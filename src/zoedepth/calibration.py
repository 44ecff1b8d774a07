"""Metres put right by measurements: some readings of a tape measure, a sparse depth map, or a known distance.

A model sees the shape of a room better than its size. One factor on all depths mends the size; some readings tell it.

    calibration = calibrate(result.depth, [(320, 240, 2.35), (50, 400, 1.1), (600, 90, 4.02)])
    depth = calibration.apply(result.depth)

The error of a depth is a factor far rather than a number of metres, so that all is reckoned in the logarithm of depth.
There a network errs with heavy tails, and people mistype: readings that fit the others badly count less, those that do
not fit at all count nothing and are named.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from zoedepth import __version__
from zoedepth.config import from_dict
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import check_size, known_depth
from zoedepth.images import DepthArray, atomic_path
from zoedepth.stored import read_json, to_json

Form = Literal["scale", "scale-shift"]
"""scale: depth * scale. scale-shift: scale and shift of the logarithm of depth, which is scale * depth ** power."""

Point: TypeAlias = tuple[float, float, float]
"""(x, y, metres): column and row of a pixel, and how far the thing is that it sees."""
Distance: TypeAlias = tuple[tuple[float, float], tuple[float, float], float]
"""((x, y), (x, y), metres): two pixels, and how far apart in space the things are that they see."""

COVERAGE = 0.8
"""Share of cases in which the truth lies within a stated error."""
PIXEL_ERROR = 0.15
"""Standard deviation of the logarithm of depth over truth at one pixel, in a photo whose scale is right."""
PRIOR_READINGS = 4.0
"""Number of readings that count as much as ``PIXEL_ERROR`` does in telling how much the readings scatter."""
MAX_KEPT = 100
"""Number of readings up to which a file lists them one by one."""

_MAX_USED = 10_000  # readings of a sparse map that are used; more would tell nothing new
_MAX_SCALE, _MAX_POWER = 1e4, 4.0
_MAX_FILE = 1 << 16  # bytes
_SAME_CAMERA = 0.02  # relative difference of focal lengths and proportions below which two cameras are one
_KIND = "calibration"
_WINDOW = 0.006  # of the shorter side: how far around a reading depth is looked at
_JUMP = 1.15  # the ratio of the depths there from which on near and far meet
_JUMP_SPREAD = 2.0  # how many times as uncertain a reading is there
_CUTOFF = 4.0  # standard deviations from which on a reading does not fit the others
_QUANTILE_SCALE, _QUANTILE_PIXEL = 1.3, 1.3  # standard deviations that hold the truth in ``COVERAGE`` of the cases
_ROUNDS = 30


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
class Calibration:
    """The metres of one camera with one model, put right: calibrated depth is scale * depth ** power.

    Raises:
        InputError: a number that no calibration has.
    """

    scale: float
    """Factor of all depths."""
    power: float = 1.0
    """Exponent of the depth in metres; 1 for a calibration by scale alone."""
    scale_error: float = 0.0
    """Relative error of the scale: in four of five cases (``COVERAGE``), the factor that puts the median of the photo
    right lies between ``scale / (1 + scale_error)`` and ``scale * (1 + scale_error)``."""
    expected_error: float = 0.0
    """Relative error of the depth at one pixel of the calibrated photo: for four pixels of five (``COVERAGE``), the
    truth lies between ``depth / (1 + expected_error)`` and ``depth * (1 + expected_error)``."""
    n_readings: int = 0
    """Number of readings, outliers included."""
    readings: tuple[Reading, ...] = ()
    """The readings one by one. A file has them where there are ``MAX_KEPT`` or fewer."""
    camera: Camera | None = None
    """The camera of the photo; None where nobody said."""
    network: str | None = None
    """Name of the model whose depth was calibrated; None where nobody said."""
    domain: str | None = None
    """Scene type whose head made the depth; None where nobody said."""
    focal_corrected: bool = False
    """True where the depth had been corrected by the focal length before."""

    def __post_init__(self) -> None:
        _check_number("scale", self.scale, 1 / _MAX_SCALE, _MAX_SCALE)
        _check_number("power", self.power, 1 / _MAX_POWER, _MAX_POWER)
        _check_number("scale_error", self.scale_error, 0, _MAX_SCALE)
        _check_number("expected_error", self.expected_error, 0, _MAX_SCALE)
        for reading in self.readings:
            if len(reading.points) not in (1, 2):
                raise InputError(f"a reading of a calibration has one point or two, not {len(reading.points)}")
            for name in ("metres", "before", "after"):
                _check_number(f"{name} of the reading {reading.name}", getattr(reading, name), 1e-9, 1e9)

    @property
    def outliers(self) -> tuple[Reading, ...]:
        """The readings that do not fit the others and were left out."""
        return tuple(reading for reading in self.readings if reading.outlier)

    def apply(self, depth: DepthArray) -> DepthArray:
        """Return the calibrated depth, float32; what is no depth (0, NaN) stays as it is."""
        return _transformed(depth, self.scale, self.power)

    def undo(self, depth: DepthArray) -> DepthArray:
        """Return the depth as it was before ``apply``, float32."""
        return _transformed(depth, self.scale ** (-1 / self.power), 1 / self.power)

    def apply_to_std(self, std: DepthArray, depth: DepthArray) -> DepthArray:
        """Return the standard deviation of the calibrated depth, float32, given that of the depth as it was.

        Args:
            std: metres.
            depth: metres, before ``apply``.
        """
        if self.power == 1:
            return (std * np.float32(self.scale)).astype(np.float32)
        known = known_depth(depth)
        slope = np.divide(self.apply(depth) * self.power, depth, out=np.zeros(depth.shape), where=known)
        return (std * slope).astype(np.float32)

    def mismatches(
        self, *, camera: Camera | None, network: str | None, domain: str | None, focal_corrected: bool
    ) -> tuple[str, ...]:
        """Return the reasons for which this calibration does not hold for a photo; none where it holds.

        A calibration holds for one camera (whatever the size of its photos, and on its side, too), one model, one head,
        and depth that was corrected by the focal length or was not. What nobody said is not compared.

        Args:
            camera: the camera of the photo.
            network: name of the model.
            domain: scene type whose head makes the depth.
            focal_corrected: whether the depth is corrected by the focal length.
        """
        found = []
        if self.camera is not None and camera is not None and (reason := _other_camera(self.camera, camera)):
            found.append(reason)
        if self.network is not None and network is not None and network != self.network:
            found.append(f"it was measured with the model {self.network}, and this is {network}")
        if self.domain is not None and domain is not None and domain != self.domain:
            found.append(f"it was measured with the head for {self.domain}, and this depth is of that for {domain}")
        if focal_corrected != self.focal_corrected:
            with_or_without = "with" if self.focal_corrected else "without"
            found.append(f"it was measured {with_or_without} the correction by the focal length")
        return tuple(found)

    def to_json(self) -> dict[str, Any]:
        """Return plain values for JSON, from which ``from_json`` makes this calibration again.

        More than ``MAX_KEPT`` readings are left out, except for their number.
        """
        kept = self.readings if len(self.readings) <= MAX_KEPT else ()
        return asdict(replace(self, readings=kept))

    @classmethod
    def from_json(cls, values: dict[str, Any], *, where: str = "calibration") -> "Calibration":
        """Make a calibration from what ``to_json`` returned.

        Args:
            values: plain values.
            where: the name of the values for messages.

        Raises:
            InputError: a field is missing, unknown, or has a value that no calibration has.
        """
        return from_dict(cls, values, where=where)


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration as a small JSON file, whole or not at all.

    Raises:
        InputError: a file is there that is no calibration of this package.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} is a folder: give a file")
    if path.exists():
        try:
            read_calibration(path)
        except InputError as error:
            raise InputError(f"{path} is no calibration and would be replaced: give another name") from error
    content = to_json({"zoedepth": __version__, _KIND: calibration.to_json()}, indent=2)
    with atomic_path(path) as temporary:
        temporary.write_text(content + "\n", encoding="utf-8")


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration that ``write_calibration`` wrote.

    Raises:
        InputError: the file cannot be read, or is no such file.
    """
    path = Path(path)
    values = read_json(path, max_bytes=_MAX_FILE)
    if not isinstance(values.get("zoedepth"), str) or not isinstance(values.get(_KIND), dict):
        raise InputError(
            f"{path} is no calibration: make one with `zoedepth calibrate PHOTO --at X,Y=METRES --out FILE`"
        )
    return Calibration.from_json(values[_KIND], where=str(path))


def calibrate(
    depth: DepthArray,
    readings: Sequence[Point | Distance] | Float[np.ndarray, "_ _"],
    *,
    camera: Camera | None = None,
    valid: Bool[np.ndarray, "height width"] | None = None,
    along_ray: bool = False,
    form: Form = "scale",
) -> Calibration:
    """Find the scale that brings a depth map to what was measured.

    Args:
        depth: (height, width), metres, as the model gives it.
        readings: (x, y, metres) of pixels, and ((x, y), (x, y), metres) of the distance of two points, in any mixture;
            or a sparse depth map of the depth's size, metres, 0 or NaN where nothing was measured; or an array (N, 3)
            of x, y and metres. The centre of the top left pixel is at (0, 0).
        camera: the camera of the photo at this size. Distances and ``along_ray`` need it.
        valid: True where depth can be compared; elsewhere readings are refused, and those of a map passed over.
        along_ray: readings of single points are the length of the ray from the lens to the thing, as a tape measure or
            a laser at the camera gives it, and not depth along the optical axis.
        form: "scale-shift" also fits a power, where the readings, left out one after the other, say that this predicts
            them better; elsewhere, the scale alone.

    Raises:
        InputError: no reading; one that is outside of the photo, at a pixel without valid depth, or not above 0; or a
            camera that is missing or of another size.
    """
    depth = np.asarray(depth)
    if depth.ndim != 2 or depth.size == 0:
        raise InputError(f"depth must be an array (height, width), got one of shape {depth.shape}")
    if camera is not None:
        check_size(depth, camera)
    if valid is not None and valid.shape != depth.shape:
        raise InputError(f"valid has shape {valid.shape}, and depth {depth.shape}: they must be the same")
    known = known_depth(depth) if valid is None else known_depth(depth) & valid
    measured = _measure(depth, readings, camera, known, along_ray=along_ray)
    fit = _fit(measured, form)
    before, after = measured.compared(1.0), fit.scale * measured.compared(fit.power)
    outliers = fit.weights == 0
    return Calibration(
        scale=fit.scale,
        power=fit.power,
        scale_error=fit.scale_error,
        expected_error=fit.expected_error,
        n_readings=len(before),
        readings=tuple(
            Reading(points, float(metres), float(one), float(other), bool(outlier), bool(at_jump))
            for points, metres, one, other, outlier, at_jump in zip(
                measured.points, measured.metres, before, after, outliers, measured.at_jump, strict=True
            )
        ),
        camera=camera,
    )


@dataclass(frozen=True)
class _Measured:
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


class _Fit(NamedTuple):
    scale: float
    power: float
    scale_error: float
    expected_error: float
    weights: Float[np.ndarray, " readings"]
    """From 0 for outliers to 1."""


def _measure(
    depth: DepthArray,
    readings: Sequence[Point | Distance] | Float[np.ndarray, "_ _"],
    camera: Camera | None,
    known: Bool[np.ndarray, "height width"],
    *,
    along_ray: bool,
) -> _Measured:
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
    return _Measured([points for points, _ in listed], np.array([m for _, m in listed]), depths, rays, at_jump)


def _of_map(
    sparse: Float[np.ndarray, "height width"], known: Bool[np.ndarray, "height width"]
) -> list[tuple[tuple[tuple[float, float], ...], float]]:
    """Return the readings of a sparse depth map, spread evenly over it where they are many."""
    rows, columns = np.nonzero(known_depth(sparse) & known)
    if not len(rows):
        raise InputError("the sparse depth map has no reading at a pixel with valid depth: is it of this photo?")
    kept = slice(None, None, -(-len(rows) // _MAX_USED))
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


def _fit(measured: _Measured, form: Form) -> _Fit:
    """Find the scale, and the power where it is asked for and helps."""
    spread = measured.spread
    metres = np.log(measured.metres)
    ratios = metres - np.log(measured.compared(1.0))
    shift, sigma, weights = _location(ratios, spread)
    power = 1.0
    if form == "scale-shift":
        if not measured.single:
            raise InputError("the distance of two points tells the scale alone: give points and their depth, too")
    n = float(np.sum(weights / spread**2))
    scale_error = math.expm1(_QUANTILE_SCALE * sigma / math.sqrt(max(n, 1e-3)))
    expected = math.expm1(_QUANTILE_PIXEL * sigma * math.sqrt(1 + 1 / max(n, 1e-3)))
    return _Fit(math.exp(shift), power, scale_error, expected, weights)


def _location(
    y: Float[np.ndarray, " readings"], spread: Float[np.ndarray, " readings"]
) -> tuple[float, float, Float[np.ndarray, " readings"]]:
    """Return the robust mean of y, its standard deviation at one pixel, and the weights, 0 for outliers (Tukey's)."""
    center, sigma, weights = _weighted_median(y, 1 / spread), PIXEL_ERROR, np.ones(len(y))
    for _ in range(_ROUNDS):
        error = (y - center) / spread
        sigma = _pixel_error(error)
        weights = np.maximum(0, 1 - (error / (_CUTOFF * sigma)) ** 2) ** 2
        if not weights.any():
            break
        before, center = center, float(np.average(y, weights=weights / spread**2))
        if abs(center - before) < 1e-9:
            break
    return center, sigma, weights


def _pixel_error(error: Float[np.ndarray, " readings"]) -> float:
    """Return the standard deviation of errors, of which some are wrong, and of what is known of models."""
    n = len(error)
    spread = 1.4826 * float(np.median(np.abs(error))) if n > 1 else 0.0
    known = PRIOR_READINGS * PIXEL_ERROR**2
    return math.sqrt((known + (n - 1) * spread**2) / (PRIOR_READINGS + n - 1))


def _weighted_median(y: Float[np.ndarray, " readings"], weights: Float[np.ndarray, " readings"]) -> float:
    order = np.argsort(y)
    share = np.cumsum(weights[order]) / np.sum(weights)
    low, high = (y[order[np.searchsorted(share, 0.5 + offset)]] for offset in (-1e-9, 1e-9))
    return float(low + high) / 2


def _transformed(depth: DepthArray, scale: float, power: float) -> DepthArray:
    """Return scale * depth ** power where there is depth; what is none stays as it is."""
    if power == 1:
        return (depth * np.float32(scale)).astype(np.float32)
    known = known_depth(depth)
    return np.where(known, np.where(known, depth, 1) ** power * scale, depth).astype(np.float32)


def _name(points: tuple[tuple[float, float], ...], metres: float) -> str:
    return f"{','.join(f'{value:g}' for point in points for value in point)}={metres:g}"


def _check_number(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:  # also where it is not a number
        raise InputError(f"the {name} of a calibration must be from {low:g} to {high:g}, got {value}")


def _other_camera(one: Camera, other: Camera) -> str | None:
    """Return why two cameras are not one, or None. Size does not matter, nor whether the camera lies on its side."""

    def differ(a: float, b: float) -> bool:
        return abs(math.log(a / b)) > _SAME_CAMERA

    if differ(max(one.size) / min(one.size), max(other.size) / min(other.size)):
        return (
            f"its photo has {one.size[1]} x {one.size[0]} pixels, and this one {other.size[1]} x {other.size[0]}: "
            "another camera, or another crop"
        )
    said = [camera for camera in (one, other) if camera.source != "assumed"]
    if len(said) == 1:
        which = "this photo says" if other is said[0] else "its photo says"
        return f"{which} its camera, and the other does not"
    views = [math.degrees(2 * math.atan(math.hypot(*c.size) / 2 / c.focal_px)) for c in (one, other)]
    if differ(one.focal_px / math.hypot(*one.size), other.focal_px / math.hypot(*other.size)):
        return f"its camera sees {views[0]:.1f} degrees from corner to corner, and that of this photo {views[1]:.1f}"
    return None
