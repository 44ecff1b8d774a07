"""Does the depth lie on the photo? Two cameras side by side, as those of a Kinect, see different cuts of the world.

Where nobody has brought the depth into the photo's camera, every pixel has the depth of another one. Edges tell it:
where depth jumps, photos have edges nearly always. The scale and shift at which most jumps fall on edges are those
between the two cameras. The data set is only read.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from PIL import Image

MOST = 24
"""Maps that are looked at."""

_HEIGHT = 240  # rows at which edges are compared
_JUMP = 0.08  # of the depth, between two neighbours
_MIN_JUMPS, _MOST_JUMPS = 200, 1000  # of a map: fewer do not count, and of more some are taken
_MIN_MAPS = 4
_SCALES = np.geomspace(0.8, 1.25, 25)
_STEP, _N_STEPS = 0.016, 3  # of shifts, as a part of the height, and how many in each direction
_SAME_SCALE, _SAME_SHIFT = 0.02, 0.017  # differences that are within what edges tell
_CLEARLY = 1.3  # times as much edge at the best place as where the depth lies
_MARGIN = 4


@dataclass(frozen=True)
class Edges:
    """The edges of a photo, and the places where its depth jumps, at a small size."""

    strength: Float[np.ndarray, "height width"]
    """Slope of the photo's brightness, its mean is 1."""
    jumps: Int[np.ndarray, "n 2"]
    """(row, column) of each, or of some, evenly spread."""


@dataclass(frozen=True)
class Registration:
    """The place at which the depth of a data set fits its photos best."""

    scale: float
    """Size that the depth must be given, about the middle: 0.9 is smaller by a tenth."""
    shift: tuple[float, float]
    """Down and right, as a part of the photo's height."""
    gain: float
    """Edges under the jumps of the depth at that place, over those where it lies."""
    n: int
    """Maps that were looked at."""
    inside: bool = True
    """False where the best place is the outermost that was tried: then it is no best place."""

    @property
    def fits(self) -> bool:
        """True where the depth lies on the photos, as far as edges tell."""
        near = abs(self.scale - 1) <= _SAME_SCALE and max(map(abs, self.shift)) <= _SAME_SHIFT
        return near or self.gain < _CLEARLY or not self.inside

    def __str__(self) -> str:
        down, right = (100 * each for each in self.shift)
        moved = [
            f"{abs(value):.1f} % of the height {positive if value > 0 else negative}"
            for value, positive, negative in ((down, "down", "up"), (right, "right", "left"))
            if abs(value) > 100 * _SAME_SHIFT
        ]
        place = f" and moved {' and '.join(moved)}" if moved else ""
        return (
            f"the edges of {self.n} depth maps lie on those of the photos best where the depth is made "
            f"{self.scale:.2f} times as large{place} ({self.gain:.1f} times as much edge). Is it that of another "
            "camera beside the photo's? Then bring it into the photo's camera first (RealSense: rs.align; OpenCV: "
            "rgbd.registerDepth), and give the photo's camera, not the sensor's"
        )


def edges(image: Float[np.ndarray, "3 height width"], depth: Float[np.ndarray, "height width"]) -> Edges | None:
    """Find the edges of a photo, and the jumps of its depth.

    Args:
        image: RGB in [0, 1].
        depth: metres, 0 where unknown; at the photo's size.

    Returns:
        None where the map is very small, or has too few jumps, as scattered points of lidar have.
    """
    height, width = depth.shape
    if min(height, width) < _HEIGHT // 2:
        return None
    size = (max(1, round(width * _HEIGHT / height)), _HEIGHT)
    grey = Image.fromarray(image.mean(axis=0).astype(np.float32))
    down, right = np.gradient(np.asarray(grey.resize(size, Image.Resampling.BOX)))
    strength = np.hypot(down, right)
    small = np.asarray(Image.fromarray(depth.astype(np.float32)).resize(size, Image.Resampling.NEAREST))
    jump = np.zeros(small.shape, bool)
    jump[:, 1:] |= _jumps(small[:, :-1], small[:, 1:])
    jump[1:] |= _jumps(small[:-1], small[1:])
    inner = np.argwhere(jump)
    if len(inner) < _MIN_JUMPS or not strength.mean() > 0:
        return None
    return Edges(strength / strength.mean(), inner[:: max(1, len(inner) // _MOST_JUMPS)])


def _jumps(one: Float[np.ndarray, "rows columns"], other: Float[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "..."]:
    """Return True between two known neighbours whose depths are far apart."""
    return (one > 0) & (other > 0) & (np.abs(one - other) > _JUMP * np.minimum(one, other))


def register(maps: Sequence[Edges]) -> Registration | None:
    """Find the scale and shift at which the jumps of depth maps lie on the edges of their photos best.

    Returns:
        None where there are too few maps to tell.
    """
    if len(maps) < _MIN_MAPS:
        return None
    maps = maps[:MOST]
    steps = _STEP * np.arange(-_N_STEPS, _N_STEPS + 1)
    scale, down, right = _best(maps, _SCALES, steps, steps)
    inside = bool(_SCALES[0] < scale < _SCALES[-1] and max(abs(down), abs(right)) < steps[-1])
    finer = _STEP * np.arange(-0.5, 0.6, 0.25)
    scale, down, right = _best(maps, scale * np.array([0.995, 1, 1.005]), down + finer, right + finer)
    gain = _strength(maps, scale, down, right) / max(_strength(maps, 1, 0, 0), 1e-9)
    return Registration(scale, (down, right), gain, len(maps), inside)


def _best(maps: Sequence[Edges], *choices: Float[np.ndarray, " _"]) -> tuple[float, float, float]:
    """Return the scale and the shifts, of those that are given, with the strongest edges."""
    places = [(float(scale), float(down), float(right)) for scale, down, right in itertools.product(*choices)]
    return max(places, key=lambda place: _strength(maps, *place))


def _strength(maps: Sequence[Edges], scale: float, down: float, right: float) -> float:
    """Return the mean strength of the photos' edges under the jumps of the depth, if it were at another place."""
    values = []
    for each in maps:
        size = np.array(each.strength.shape)
        middle = (size - 1) / 2
        places = np.rint((each.jumps - middle) * scale + middle + np.array([down, right]) * size[0]).astype(int)
        inside = ((places >= _MARGIN) & (places < size - _MARGIN)).all(axis=1)
        rows, columns = places[inside].T
        if len(rows):
            values.append(each.strength[rows, columns].mean())
    return float(np.mean(values)) if values else 0.0
