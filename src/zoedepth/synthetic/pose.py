"""The place and direction of a camera, and the check that a picture from there is worth taking."""

import math
from typing import NamedTuple

import numpy as np

from zoedepth.geometry.camera import Intrinsics
from zoedepth.synthetic.render import View
from zoedepth.synthetic.scene import Arrays
from zoedepth.synthetic.trace import Tracer


class Pose(NamedTuple):
    """A camera: its place in metres, its angles in radians."""

    position: tuple[float, float, float]
    yaw: float
    """Direction of sight, counted from x towards y."""
    pitch: float
    """Positive looks up."""
    roll: float
    field_of_view: float
    """Angle across the picture's width."""

    def view(self, size: tuple[int, int], shift: tuple[float, float] = (0.0, 0.0)) -> View:
        """Return the pinhole camera of a picture taken from here.

        Args:
            size: (height, width) of the picture, pixels.
            shift: how far the principal point lies to the right of and below the middle, pixels.
        """
        cy, sy, cp, sp = math.cos(self.yaw), math.sin(self.yaw), math.cos(self.pitch), math.sin(self.pitch)
        ahead = np.array([cy * cp, sy * cp, sp])
        right = np.array([sy, -cy, 0.0])
        down = np.cross(ahead, right)
        cr, sr = math.cos(self.roll), math.sin(self.roll)
        rotation = np.stack([cr * right + sr * down, cr * down - sr * right, ahead], 1)
        focal = size[1] / 2 / math.tan(self.field_of_view / 2)
        camera = Intrinsics(focal, focal, (size[1] - 1) / 2 + shift[0], (size[0] - 1) / 2 + shift[1])
        return View(np.array(self.position, np.float32), rotation.astype(np.float32), camera, size)


def count_parts(view: View, arrays: Arrays, tracer: Tracer, *, nearest: float, middle: float) -> int:
    """Count the parts that a few hundred rays find.

    Return 0 if the camera is inside of a thing, or if the picture would show little but sky or one surface.

    Args:
        nearest: distance in metres that at most 1 % of the rays may stay below.
        middle: smallest median depth, metres.
    """
    step = max(1, min(view.size) // 18)
    rays = view.rays(step)
    hits = tracer.hits(view.position, rays)
    seen = hits.triangle >= 0
    if seen.mean() < 0.4 or (hits.distance < nearest).mean() > 0.01 or np.median(hits.distance[seen]) < middle:
        return 0
    counts = np.unique(arrays.owner[hits.triangle[seen]], return_counts=True)[1]
    return 0 if counts.max() > 0.55 * len(rays) else len(counts)
