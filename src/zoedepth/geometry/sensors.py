"""Sizes of the sensors of cameras that say their focal length in millimetres, but neither the 35-mm equivalent nor the
resolution of their sensor.
"""

import re

_FULL_FRAME, _NIKON_DX, _CANON_APSC, _FOUR_THIRDS = (36.0, 24.0), (23.5, 15.6), (22.3, 14.9), (17.3, 13.0)
_ONE_INCH, _ONE_BY_1_7, _ONE_BY_2_3 = (13.2, 8.8), (7.44, 5.58), (6.17, 4.55)

_SENSORS: dict[str, tuple[float, float]] = {
    # Drones: no other camera of one model has so many photos in the world.
    "dji fc220": (6.17, 4.55),
    "dji fc300x": _ONE_BY_2_3,
    "dji fc330": _ONE_BY_2_3,
    "dji fc6310": _ONE_INCH,
    "dji fc6520": _FOUR_THIRDS,
}
"""Make and model in lower case -> width and height of the sensor in millimetres."""


def sensor_size(make: str, model: str) -> tuple[float, float] | None:
    """Return the width and the height of a camera's sensor in millimetres; None where the table does not know it.

    Args:
        make: the maker as EXIF names it, e.g. "NIKON CORPORATION".
        model: the model as EXIF names it, with or without the maker's name before it, e.g. "NIKON D90".
    """
    maker = re.sub(r"[^a-z0-9 ]", " ", make.lower()).split()
    words = re.sub(r"[\s_]+", " ", model.lower()).split()
    if not maker or not words:
        return None
    return _SENSORS.get(" ".join([maker[0], *(words[1:] if words[0] == maker[0] else words)]))
