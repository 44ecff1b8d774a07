"""Facts about photos that stand beside them: in a line of a list, in ``dataset.json``, or in the JSON of a shard."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.geometry.lens import Lens
from zoedepth.stored import read_json

DEFAULTS_FILE = "dataset.json"
"""Name of the file beside the data that says what holds for all of it."""

_MIN_FOV, _MAX_FOV = 5.0, 140.0  # degrees of a lens, of which a focal length alone is said
_POSSIBLE_FOV = (1.0, 170.0)  # degrees

_CAMERA = ("fx", "fy", "cx", "cy")


@dataclass(frozen=True, slots=True)
class Facts:
    """Facts about a photo and its depth that stand beside the files; None where nobody says one."""

    depth_scale: float | None = None
    """The stored value of one metre."""
    domain: str | None = None
    """Scene type: "indoor", "outdoor" or your own."""
    camera: Intrinsics | None = None
    """The camera at the size of the photo."""
    max_depth: float | None = None
    """Depth of this many metres or more is unknown: a mark for holes or the sky, or beyond the sensor's reach."""

    def __post_init__(self) -> None:
        if self.depth_scale is not None and not 0 < self.depth_scale < math.inf:
            raise InputError(
                f"depth_scale must be finite and > 0, for example 1000 for millimetres; it is {self.depth_scale}"
            )
        if self.max_depth is not None and not 0 < self.max_depth < math.inf:
            raise InputError(f"max_depth must be finite and > 0, in metres; it is {self.max_depth}")

    def over(self, defaults: "Facts") -> "Facts":
        """Return these facts, and the defaults where these say nothing."""
        return Facts(
            self.depth_scale or defaults.depth_scale,
            self.domain or defaults.domain,
            self.camera or defaults.camera,
            self.max_depth or defaults.max_depth,
        )


def asked_over(asked: Facts, said: Facts, folder: str | Path) -> Facts:
    """Return what is asked for a data set, and what its ``dataset.json`` says where nothing is asked.

    A domain or a farthest depth that is asked replaces the one of the file. The unit of the depth is no choice.

    Args:
        asked: options, and fields of a configuration.
        said: the facts of ``dataset.json``.
        folder: where the file is, for the message.

    Raises:
        InputError: both say another depth_scale.
    """
    if asked.depth_scale and said.depth_scale and asked.depth_scale != said.depth_scale:
        raise InputError(
            f"{Path(folder, DEFAULTS_FILE)} says depth_scale {said.depth_scale:g}, and {asked.depth_scale:g} is asked "
            f"for: leave out the option, or correct the file. Data that says none may have a {DEFAULTS_FILE} of its own"
        )
    return asked.over(said)


def parse_facts(row: Mapping[str, object], where: str) -> Facts:
    """Return the facts in a row: depth_scale, domain, max_depth, and fx, fy, cx, cy, or cam_in with these four.

    Args:
        row: values are text or numbers; None and "" say nothing. Other keys are ignored.
        where: how errors begin: the file and its line.

    Raises:
        InputError: a value has the wrong type or is out of range.
    """
    domain = row.get("domain")
    if domain not in (None, "") and not isinstance(domain, str):
        raise InputError(f"{where}: domain must be text, for example indoor; it is {domain!r}")
    scale = None
    if row.get("depth_scale") not in (None, ""):
        scale = _number(row["depth_scale"])
        if scale is None:
            raise InputError(
                f"{where}: depth_scale must be a number, the stored value of one metre (1000 for millimetres); "
                f"it is {_short(row['depth_scale'])}"
            )
        if not 0 < scale < math.inf:
            raise InputError(f"{where}: depth_scale must be finite and > 0; it is {scale}")
    max_depth = None
    if row.get("max_depth") not in (None, ""):
        max_depth = _number(row["max_depth"])
        if max_depth is None or not 0 < max_depth < math.inf:
            raise InputError(
                f"{where}: max_depth must be a number > 0, the metres from which on depth is unknown; it is "
                f"{_short(row['max_depth'])}"
            )
    return Facts(scale, str(domain) if domain else None, _parse_camera(row, where), max_depth)


def camera_of_photo(known: Intrinsics | Lens | None, size: tuple[int, int]) -> Intrinsics | None:
    """Return the camera of a photo of ``size`` (height, width); None where nobody knows it.

    A lens looks through the middle of the photo. Lists in which nobody needed the focal length may have any number in
    its place: one that would see less than 5 or more than 140 degrees along the longer side says nothing.
    """
    if not isinstance(known, Lens):
        return known
    camera = known.camera(size)
    return camera.intrinsics if _MIN_FOV <= max(camera.fov_x, camera.fov_y) <= _MAX_FOV else None


def check_camera(camera: Intrinsics, size: tuple[int, int], name: object) -> None:
    """Refuse the camera of another photo, or of this one at another size: metres would be as wrong as its focal length.

    Args:
        camera: the camera that stands beside a photo.
        size: (height, width) of the photo.
        name: the photo, for the message.

    Raises:
        InputError: the principal point is outside of the photo, or the camera would see less than 1 or more than 170
            degrees along the longer side.
    """
    height, width = size
    half = 0.5  # of a pixel: the middle of the first one is 0
    told = f"{name} is {width} x {height} pixels, and its camera has fx, fy, cx, cy = " + ", ".join(
        f"{value:g}" for value in (camera.fx, camera.fy, camera.cx, camera.cy)
    )
    advice = "Give the camera of the photo at this size, or leave it out"
    if not (-half <= camera.cx <= width - half and -half <= camera.cy <= height - half):
        raise InputError(
            f"{told}: it looks through a point outside of the photo, so it is that of another size. {advice}"
        )
    fov = max(2 * math.degrees(math.atan2(side / 2, f)) for side, f in ((width, camera.fx), (height, camera.fy)))
    if not _POSSIBLE_FOV[0] <= fov <= _POSSIBLE_FOV[1]:
        raise InputError(f"{told}: it would see {fov:.3g} degrees. In pixels of which size are these? {advice}")


def read_defaults(folder: Path) -> Facts:
    """Return what ``dataset.json`` in a folder says about all photos; nothing where there is no such file.

    Raises:
        InputError: the file is malformed.
    """
    path = folder / DEFAULTS_FILE
    if not path.is_file():
        return Facts()
    return parse_facts(read_json(path), str(path))


def _parse_camera(row: Mapping[str, object], where: str) -> Intrinsics | None:
    values = [row.get(name) for name in _CAMERA]
    if all(value in (None, "") for value in values):
        listed = row.get("cam_in")
        if listed in (None, ""):
            return None
        if not isinstance(listed, list) or len(listed) != 4:
            raise InputError(f"{where}: cam_in must be the list [fx, fy, cx, cy], in pixels; it is {_short(listed)}")
        values = listed
    numbers = [_number(value) for value in values]
    if any(number is None or not math.isfinite(number) for number in numbers):
        raise InputError(
            f"{where}: fx, fy, cx, cy must be four numbers, in pixels, or all left out; they are {_short(values)}"
        )
    fx, fy, cx, cy = (float(number) for number in numbers if number is not None)
    if not (fx > 0 and fy > 0):
        raise InputError(f"{where}: the focal lengths fx and fy must be > 0; they are {fx} and {fy}")
    return Intrinsics(fx, fy, cx, cy)


def _number(value: object) -> float | None:
    """Return a number, or text that is one, as a float; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        return float(value)
    except (ValueError, OverflowError):
        return None


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:60]}…"
