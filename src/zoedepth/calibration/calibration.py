"""A calibration: what has to be done to the depth of one camera, how sure it is, and for which photos it holds."""

import math
import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from zoedepth.calibration.readings import Reading
from zoedepth.config import from_dict
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import known_depth
from zoedepth.images import DepthArray, atomic_path
from zoedepth.presets import PRESETS
from zoedepth.stored import read_json, to_json

COVERAGE = 0.8
"""Share of cases in which the truth lies within a stated error."""
MAX_KEPT = 100
"""Number of readings that a file lists, at most."""

_MAX_SCALE, _MAX_POWER = 1e4, 4.0
MAX_FILE = 1 << 20
"""Bytes of a file of a calibration, at most: names of photos may be long."""
_SAME_CAMERA = 0.02  # relative difference of focal lengths and proportions below which two cameras are one
_KIND = "calibration"


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
    """Relative error of the scale: in four of five cases (``COVERAGE``), the factor that would put the median of the
    calibrated photo right lies between ``1 / (1 + scale_error)`` and ``1 + scale_error``."""
    expected_error: float = 0.0
    """Relative error of the depth at one pixel of the calibrated photo: for four pixels of five (``COVERAGE``), the
    truth lies between ``depth / (1 + expected_error)`` and ``depth * (1 + expected_error)``."""
    error_elsewhere: float = 0.0
    """Relative error of other photos of this camera, likewise. Where one photo was measured it is larger."""
    n_readings: int = 0
    """Number of readings, outliers included."""
    middle: float = 1.0
    """Depth in metres, before calibration, of the median reading: at a power other than 1, depths there change by the
    factor ``scale * middle ** (power - 1)``."""
    readings: tuple[Reading, ...] = ()
    """The readings one by one. A file has ``MAX_KEPT`` of them, evenly spread, where there are more."""
    camera: Camera | None = None
    """The camera of the photo; None where nobody said."""
    network: str | None = None
    """Name of the model whose depth was calibrated; None where nobody said."""
    weights: str | None = None
    """Hash of its weights and of the options that change their metres, see ``weights.load.weights_of``; None where
    nobody said."""
    domain: str | None = None
    """Scene type whose head made the depth; None where nobody said."""
    focal_corrected: bool = False
    """True where the depth had been corrected by the focal length before."""

    def __post_init__(self) -> None:
        _check_number("scale", self.scale, 1 / _MAX_SCALE, _MAX_SCALE)
        _check_number("power", self.power, 1 / _MAX_POWER, _MAX_POWER)
        _check_number("scale_error", self.scale_error, 0, _MAX_SCALE)
        _check_number("error_elsewhere", self.error_elsewhere, 0, _MAX_SCALE)
        _check_number("middle", self.middle, 1e-9, 1e9)
        _check_number("expected_error", self.expected_error, 0, _MAX_SCALE)
        for reading in self.readings:
            if len(reading.points) not in (1, 2):
                raise InputError(f"a reading of a calibration has one point or two, not {len(reading.points)}")
            for name in ("metres", "before", "after"):
                _check_number(f"{name} of the reading {reading.place}", getattr(reading, name), 1e-9, 1e9)
            _check_number(f"spread of the reading {reading.place}", reading.spread, 1e-3, 1e6)

    @property
    def outliers(self) -> tuple[Reading, ...]:
        """The readings that do not fit the others and were left out."""
        return tuple(reading for reading in self.readings if reading.outlier)

    @property
    def n_photos(self) -> int:
        """Number of photos that the listed readings are from."""
        return len({reading.photo for reading in self.readings})

    @property
    def error_before(self) -> float:
        """Median relative error of the depth as it was at the readings that fit; NaN without readings."""
        return self._error("before")

    @property
    def error_after(self) -> float:
        """Median relative error of the calibrated depth at the readings that fit; NaN without readings."""
        return self._error("after")

    def _error(self, when: str) -> float:
        errors = [abs(getattr(each, when) / each.metres - 1) for each in self.readings if not each.outlier]
        return float(np.median(errors)) if errors else math.nan

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
        self,
        *,
        camera: Camera | None,
        network: str | None,
        domain: str | None,
        focal_corrected: bool,
        weights: str | None = None,
    ) -> tuple[str, ...]:
        """Return the reasons for which this calibration does not hold for a photo; none where it holds.

        A calibration holds for one camera (whatever the size of its photos, and on its side, too), one model, one head,
        and depth that was corrected by the focal length or was not. A model is known by its weights where both sides
        say them, else by its name: a training may have changed what a name means. What nobody said is not compared.

        Args:
            camera: the camera of the photo.
            network: name of the model.
            domain: scene type whose head makes the depth.
            focal_corrected: True where the depth is corrected by the focal length.
            weights: hash of the model's weights, see ``weights.load.weights_of``.
        """
        found = []
        if self.camera is not None and camera is not None and (reason := other_camera(self.camera, camera)):
            found.append(reason)
        one_name = self.network is None or network is None or _one_network(network, self.network)
        one_weights = None if self.weights is None or weights is None else weights == self.weights
        if not one_name and not one_weights:
            found.append(f"it was measured with the model {self.network}, and this is {network}")
        elif one_weights is False:
            found.append(
                f"it was measured with other weights of {self.network or 'the model'}, or another --compat or --pad"
            )
        if self.domain is not None and domain is not None and domain != self.domain:
            found.append(f"it was measured with the head for {self.domain}, and this depth is of that for {domain}")
        if focal_corrected != self.focal_corrected:
            with_or_without = "with" if self.focal_corrected else "without"
            found.append(f"it was measured {with_or_without} the correction by the focal length")
        return tuple(found)

    def to_json(self) -> dict[str, Any]:
        """Return plain values for JSON, from which ``from_json`` makes this calibration again.

        Of more than ``MAX_KEPT`` readings some are left out, except from their number: evenly, of each photo as many.
        """
        return asdict(replace(self, readings=_thinned(self.readings)))

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
    check_replaceable(path)
    content = to_json({"zoedepth": _KIND, _KIND: calibration.to_json()}, indent=2)
    with atomic_path(path) as temporary:
        temporary.write_text(content + "\n", encoding="utf-8")


def check_replaceable(path: Path) -> None:
    """Refuse to write a calibration where something else is.

    Raises:
        InputError: a folder is there, or a file that is no calibration of this package.
    """
    if path.is_dir():
        raise InputError(f"{path} is a folder: give a file")
    if os.path.lexists(path):  # also a link that leads nowhere
        try:
            read_calibration(path)
        except InputError as error:
            raise InputError(f"{path} is no calibration and would be replaced: give another name") from error


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration that ``write_calibration`` wrote.

    Raises:
        InputError: the file cannot be read, or is no such file.
    """
    path = Path(path)
    values = read_json(path, max_bytes=MAX_FILE)
    if values.get("zoedepth") != _KIND or not isinstance(values.get(_KIND), dict):
        raise InputError(
            f"{path} is no calibration: make one with `zoedepth calibrate PHOTO --at X,Y=METRES --out FILE`"
        )
    return Calibration.from_json(values[_KIND], where=str(path))


def _thinned(readings: tuple[Reading, ...]) -> tuple[Reading, ...]:
    """Return ``MAX_KEPT`` readings at most, evenly spread over each photo, and all photos with the same number.

    A photo of which nothing is left would have no say when others are added. Of more photos than that, one of each.
    """
    if len(readings) <= MAX_KEPT:
        return readings
    of_photo: dict[str, list[Reading]] = {}
    for reading in readings:
        of_photo.setdefault(reading.photo, []).append(reading)
    share = max(1, MAX_KEPT // len(of_photo))
    kept = [each[:: -(-len(each) // share)] for each in of_photo.values()]
    return tuple(reading for each in kept for reading in each)


def _transformed(depth: DepthArray, scale: float, power: float) -> DepthArray:
    """Return scale * depth ** power where there is depth; what is none stays as it is."""
    if power == 1:
        return (depth * np.float32(scale)).astype(np.float32)
    known = known_depth(depth)
    return np.where(known, np.where(known, depth, 1) ** power * scale, depth).astype(np.float32)


def _one_network(one: str, other: str) -> bool:
    """Return True if two names may be of one model: one is the other, or the end of its path.

    A folder that is called as a published model is another one.
    """
    if one in PRESETS or other in PRESETS:
        return one == other
    names = (PurePath(name).parts[::-1] for name in (one, other))
    return all(a == b for a, b in zip(*names, strict=False))


def _check_number(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:  # also where it is not a number
        raise InputError(f"the {name} of a calibration must be from {low:g} to {high:g}, got {value}")


def other_camera(one: Camera, other: Camera) -> str | None:
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
