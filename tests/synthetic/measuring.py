"""Measures of built scenes, by plain loops that share no code with the package."""

import math
from collections.abc import Callable

import numpy as np

from zoedepth.synthetic.pose import Pose
from zoedepth.synthetic.scene import Frame, Material, Scene
from zoedepth.synthetic.shapes import all_shapes

GRAY = Material("plain", (0.5, 0.5, 0.5))
DOWN = math.pi / 2
"""Pitch of a camera's way down from level, radians."""


def turned(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """Return the rotation by roll around x, then pitch around y, then yaw around z."""

    def plane(angle: float, a: int, b: int) -> np.ndarray:
        matrix = np.eye(3)
        matrix[a, a] = matrix[b, b] = math.cos(angle)
        matrix[a, b], matrix[b, a] = -math.sin(angle), math.sin(angle)
        return matrix

    return plane(yaw, 0, 1) @ plane(pitch, 2, 0) @ plane(roll, 1, 2)


def corners(scene: Scene) -> list[np.ndarray]:
    """Return the vertices of each part in the world, metres."""
    points = []
    for name, _, (x, y, z, *rest) in scene.parts:
        unit = all_shapes()[name].vertices * np.array(rest[:3])
        points.append(unit @ turned(rest[3], rest[4], rest[5]).T + np.array([x, y, z]))
    return points


def boxes(scene: Scene) -> np.ndarray:
    """Return the lowest and highest x, y, z of each part: (part, 2, 3)."""
    return np.array([(points.min(0), points.max(0)) for points in corners(scene)])


def extent(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest x, y, z of all parts."""
    bounds = boxes(scene)
    return bounds[:, 0].min(0), bounds[:, 1].max(0)


def loose(scene: Scene, *, gap: float) -> list[int]:
    """Return the parts that no chain of parts, at most ``gap`` metres apart, joins to one that touches the ground."""
    bounds = boxes(scene)
    low, high = bounds[:, 0], bounds[:, 1]
    near = np.all((low[:, None] <= high[None] + gap) & (low[None] <= high[:, None] + gap), axis=-1)
    held = low[:, 2] < 0.01
    while True:
        more = near[held].any(0) if held.any() else held
        if (more | held).sum() == held.sum():
            return np.flatnonzero(~held).tolist()
        held |= more


def built(build: Callable[[Frame, np.random.Generator], object], seed: int) -> Scene:
    """Return a scene of one thing at the origin."""
    scene = Scene()
    build(scene.at(0, 0), np.random.default_rng(seed))
    return scene


def numbers(scene: Scene) -> str:
    """Return a text that differs if anything about two scenes does."""
    parts = [(name, tuple(material), tuple(map(float, place))) for name, material, place in scene.parts]
    return repr((parts, scene.lights, scene.sun, scene.sunlit, scene.sky, scene.ambient))


def pose(x: float, y: float, z: float, *, yaw: float = math.pi / 2, pitch: float = 0.0, roll: float = 0.0) -> Pose:
    """Return a camera that sees about 53 degrees, looking along +y."""
    return Pose((x, y, z), yaw, pitch, roll, 2 * math.atan(0.5))
