"""Photos and depth of two clocks, as a recording with a depth camera has them: named by time, paired by the nearest."""

import re
from collections.abc import Sequence

import numpy as np

TOLERANCE = 0.02
"""Seconds between a photo and its depth, at most, as in the tools of TUM RGB-D: less than a frame at 30 a second."""

_SECONDS = re.compile(r"\d{1,12}\.\d+")
_NUMBERED = re.compile(r"\d{1,8}\.\d{1,2}")
_UNITS = {13: 1e-3, 16: 1e-6, 19: 1e-9}
"""Digits of a whole number → its unit in seconds, from 2001 to 2286."""


def seconds(text: str) -> float | None:
    """Return the time that a name says: seconds with a point, or whole milli-, micro- or nanoseconds since 1970.

    Numbers of frames are no times: None, as for everything else.
    """
    if _SECONDS.fullmatch(text):
        return float(text)
    unit = _UNITS.get(len(text)) if text.isascii() and text.isdigit() else None
    return None if unit is None else int(text) * unit


def seconds_of_name(name: str) -> float | None:
    """Return the time that the name of a file says, see ``seconds``; None for one of two numbers, as 3.10 after 3.9."""
    return None if _NUMBERED.fullmatch(name) else seconds(name)


def pair_by_time(photos: Sequence[float], depths: Sequence[float]) -> list[tuple[int, int]]:
    """Return (number of a photo, number of its depth), in the order of the photos.

    They go together where each is the nearest to the other, and ``TOLERANCE`` apart at most.

    Args:
        photos: times of the photos, in seconds.
        depths: times of the depth maps.
    """
    if not photos or not depths:
        return []
    to_depth, to_photo = _nearest(photos, depths), _nearest(depths, photos)
    return [
        (i, int(j))
        for i, j in enumerate(to_depth)
        if to_photo[j] == i and abs(photos[i] - depths[j]) <= TOLERANCE + 1e-6  # of rounding
    ]


def _nearest(times: Sequence[float], others: Sequence[float]) -> np.ndarray:
    """Return, for each time, the number of the nearest of the others."""
    order = np.argsort(others, kind="stable")
    ordered = np.asarray(others)[order]
    after = np.searchsorted(ordered, times).clip(0, len(ordered) - 1)
    before = (after - 1).clip(0)
    closer = np.abs(ordered[before] - times) <= np.abs(ordered[after] - times)
    return order[np.where(closer, before, after)]
