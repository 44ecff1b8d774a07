"""What is said about photos beside the files themselves: a line of a list, ``dataset.json``, the JSON of a shard."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

DEFAULTS_FILE = "dataset.json"
"""Name of the file beside the data that says what holds for all of it."""

_MAX_BYTES = 1 << 20
_CAMERA = ("fx", "fy", "cx", "cy")


@dataclass(frozen=True, slots=True)
class Facts:
    """What is said about a photo and its depth; None where nothing is."""

    depth_scale: float | None = None
    """The stored value of one metre."""
    domain: str | None = None
    """Scene type: "indoor", "outdoor" or your own."""
    camera: Intrinsics | None = None
    """Of the photo at its size."""

    def __post_init__(self) -> None:
        if self.depth_scale is not None and not 0 < self.depth_scale < math.inf:
            raise InputError(f"depth_scale must be finite and > 0; it is {self.depth_scale}")

    def over(self, defaults: "Facts") -> "Facts":
        """These, and the others' where these say nothing."""
        return Facts(
            self.depth_scale or defaults.depth_scale, self.domain or defaults.domain, self.camera or defaults.camera
        )


def parse_facts(row: Mapping[str, object], where: str) -> Facts:
    """The facts among the keys of a row: depth_scale, domain, and fx, fy, cx, cy or cam_in with these four in a list.

    Args:
        row: values are text or numbers; None and "" say nothing. Other keys are left alone.
        where: what errors begin with.

    Raises:
        InputError: a value that cannot be one.
    """
    domain = row.get("domain")
    if domain not in (None, "") and not isinstance(domain, str):
        raise InputError(f"{where}: domain must be text, for example indoor")
    scale = None
    if row.get("depth_scale") not in (None, ""):
        scale = _number(row["depth_scale"])
        if scale is None:
            raise InputError(f"{where}: depth_scale must be the stored value of one metre")
        if not 0 < scale < math.inf:
            raise InputError(f"{where}: depth_scale must be finite and > 0; it is {scale}")
    return Facts(scale, str(domain) if domain else None, _parse_camera(row, where))


def read_defaults(folder: Path) -> Facts:
    """What ``dataset.json`` in a folder says about all photos; nothing where there is none.

    Raises:
        InputError: it is malformed.
    """
    path = folder / DEFAULTS_FILE
    if not path.is_file():
        return Facts()
    with path.open("rb") as file:
        content = file.read(_MAX_BYTES + 1)
    return parse_facts(parse_json(content, str(path)), str(path))


def parse_json(content: str | bytes, where: str, *, max_bytes: int = _MAX_BYTES) -> dict[str, object]:
    """The JSON object that a small text holds.

    Raises:
        InputError: it holds something else, or is larger than ``max_bytes``.
    """
    if len(content) > max_bytes:
        raise InputError(f"{where}: longer than {max_bytes:,} bytes")
    try:
        value = json.loads(content)
    except (ValueError, RecursionError) as error:  # UnicodeDecodeError is a ValueError
        raise InputError(f"{where}: not a JSON object ({error})") from error
    if not isinstance(value, dict):
        raise InputError(f"{where}: not a JSON object, but {type(value).__name__}")
    return value


def _parse_camera(row: Mapping[str, object], where: str) -> Intrinsics | None:
    values = [row.get(name) for name in _CAMERA]
    if all(value in (None, "") for value in values):
        listed = row.get("cam_in")
        if listed in (None, ""):
            return None
        if not isinstance(listed, list) or len(listed) != 4:
            raise InputError(f"{where}: cam_in must be the list [fx, fy, cx, cy], pixels")
        values = listed
    numbers = [_number(value) for value in values]
    if any(number is None or not math.isfinite(number) for number in numbers):
        raise InputError(f"{where}: fx, fy, cx, cy must be four numbers, pixels, or all left out; they are {values}")
    fx, fy, cx, cy = (float(number) for number in numbers if number is not None)
    if not (fx > 0 and fy > 0):
        raise InputError(f"{where}: focal lengths must be > 0; fx, fy are {fx}, {fy}")
    return Intrinsics(fx, fy, cx, cy)


def _number(value: object) -> float | None:
    """A number, or text that is one."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        return float(value)
    except (ValueError, OverflowError):
        return None
