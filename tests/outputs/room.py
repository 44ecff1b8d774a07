"""A rendered room of known size, in which coloured panels show which way is left, up and ahead."""

from functools import cache
from math import pi

import numpy as np

from zoedepth.geometry.camera import Camera
from zoedepth.outputs import Maps
from zoedepth.synthetic.pose import Pose
from zoedepth.synthetic.render import render
from zoedepth.synthetic.scene import Material, Scene
from zoedepth.synthetic.trace import Tracer

WIDTH, HEIGHT, AHEAD = 4.0, 2.5, 3.0
"""Metres: from wall to wall, from floor to ceiling, and from the camera to the wall that it looks at."""

PANELS = {
    "red": (-1.99, -0.5, 2.0),  # on the left wall, above the camera
    "green": (0.8, 0.99, 2.0),  # on the floor, to the right
    "blue": (1.0, 0.3, 2.99),  # on the wall ahead, to the right
}
"""Colour → the middle of a panel: metres to the right of the camera, below it, and ahead."""

_EYE = 1.0  # metres above the floor
_SIDE, _THICK = 0.6, 0.01
_COLORS = {"red": (0.9, 0.05, 0.05), "green": (0.05, 0.9, 0.05), "blue": (0.05, 0.05, 0.9)}


@cache
def rendered_room() -> Maps:
    """Return the maps of a photo of the room, 150 x 200 pixels, from a camera that looks straight ahead."""
    scene = Scene(ambient=(3.0, 3.0, 3.0))
    gray = Material("plain", (0.5, 0.5, 0.5))
    walls = {
        (WIDTH + 2, 20, 1): ((0, 0, -1), (0, 0, HEIGHT)),
        (1, 20, HEIGHT): ((-WIDTH / 2 - 0.5, 0, 0), (WIDTH / 2 + 0.5, 0, 0)),
        (WIDTH + 2, 1, HEIGHT): ((0, AHEAD + 0.5, 0),),
    }
    for size, places in walls.items():
        for place in places:
            scene.at(0, 0).add("box", gray, size, place)
    for name, (right, down, ahead) in PANELS.items():
        size = [_SIDE] * 3
        size[{"red": 0, "green": 2, "blue": 1}[name]] = _THICK
        bottom = _EYE - down - size[2] / 2
        scene.at(0, 0).add("box", Material("plain", _COLORS[name]), tuple(size), (right, ahead, bottom))
    view = Pose((0, 0, _EYE), yaw=pi / 2, pitch=0, roll=0, field_of_view=1.7).view((150, 200), (3.5, -2.0))
    arrays = scene.arrays((0, 0, _EYE))
    picture = render(scene, arrays, Tracer(arrays), view, np.random.default_rng(0))
    image = (picture.color.clip(0, 1) ** (1 / 2.2) * 255).round().astype(np.uint8)
    return Maps(depth=picture.depth, image=image, camera=Camera.of(view.camera, view.size))


def assert_true(points: np.ndarray, colors: np.ndarray) -> None:
    """Check the size of the room, and the places of its panels, in points whose axes are x right, y down, z ahead.

    Args:
        points: (points, 3), metres.
        colors: (points, 3), RGB from 0 to 255.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose(high[0] - low[0], WIDTH, rtol=1e-3)
    np.testing.assert_allclose(high[1] - low[1], HEIGHT, rtol=1e-3)
    np.testing.assert_allclose(high[2], AHEAD, rtol=1e-3)
    assert low[2] > 0
    for channel, place in enumerate(PANELS.values()):
        others = np.delete(colors, channel, axis=1).max(axis=1).astype(int)
        panel = points[colors[:, channel].astype(int) > 2 * others + 20]
        assert len(panel) > 50
        np.testing.assert_allclose((panel.min(axis=0) + panel.max(axis=0)) / 2, place, atol=0.06)
