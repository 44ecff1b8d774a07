"""A rendered room that a known camera sees, and where it sees points: the truth for tests of cameras."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import unproject
from zoedepth.synthetic.photo import photograph
from zoedepth.synthetic.render import render
from zoedepth.synthetic.room import build_room
from zoedepth.synthetic.trace import Tracer

SIZE = (90, 120)
"""(height, width) of the photo: 150 pixels from corner to corner."""

FILM = 24
"""The focal length of the lens in millimetres, on 35-mm film."""

FOCAL = FILM / math.hypot(36, 24) * 150
"""The same in pixels of the photo."""


class Scene(NamedTuple):
    """A photo, and what is true of it."""

    image: np.ndarray
    """uint8 (height, width, 3)."""
    depth: np.ndarray
    """Metres; 0 in windows."""
    places: Float[np.ndarray, "height width 2"]
    """Column and row of each pixel."""


@cache
def rendered_room(shift: tuple[float, float] = (0.0, 0.0)) -> Scene:
    """Return a room through a lens of ``FILM`` mm, whose axis lies ``shift`` pixels right of and below the middle."""
    rng = np.random.default_rng(7)
    place = build_room(rng)
    lens = 2 * math.atan(SIZE[1] / 2 / FOCAL)
    pose = place.draw_pose(rng)._replace(field_of_view=lens)
    arrays = place.scene.arrays(pose.position)
    picture = render(place.scene, arrays, Tracer(arrays), pose.view(SIZE, shift), rng)
    assert (picture.depth > 0).mean() > 0.9
    places = np.stack(np.meshgrid(np.arange(SIZE[1]), np.arange(SIZE[0])), axis=-1).astype(float)
    return Scene(photograph(picture.color, rng), picture.depth, places)


def worst_error(
    depth: np.ndarray,
    camera: Camera,
    places: Float[np.ndarray, "height width 2"],
    *,
    shift: tuple[float, float] = (0.0, 0.0),
    axes: np.ndarray | None = None,
) -> float:
    """Return how far, in pixels, points land from the places of the rendered photo at which they were seen.

    Args:
        depth: metres, of the photo after it was changed.
        camera: the camera that is said to have taken the changed photo.
        places: column and row of each of its pixels in the rendered photo.
        shift: that of ``rendered_room``.
        axes: 3 x 3, which turns points of the changed photo into those of the rendered one.
    """
    points = unproject(depth, camera).astype(float) @ (np.eye(3) if axes is None else axes).T
    x, y, z = np.moveaxis(points, -1, 0)
    middle = (SIZE[1] - 1) / 2 + shift[0], (SIZE[0] - 1) / 2 + shift[1]
    landed = np.stack([FOCAL * x / z + middle[0], FOCAL * y / z + middle[1]], axis=-1)
    distances = np.linalg.norm(landed - places, axis=-1)[depth > 0]
    assert len(distances) > 1000
    return float(distances.max())
