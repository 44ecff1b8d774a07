"""A scene: shapes placed in metres, their materials, and the lights. x and y are level, z is up."""

import math
from dataclasses import dataclass, field
from itertools import groupby
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32

from zoedepth.synthetic.shapes import FAR, all_shapes

_SOON_COARSE = ("leaves", "sphere", "blob", "conifer")
"""Shapes whose coarse version does nearly as well."""

Color = tuple[float, float, float]
"""sRGB, 0 to 1."""


class Material(NamedTuple):
    """The material of a part: its colours, pattern and shine."""

    pattern: str
    """One of ``zoedepth.synthetic.textures.PATTERNS``."""
    color: Color
    second: Color = (0.5, 0.5, 0.5)
    """The pattern's other colour."""
    scale: float = 1.0
    """Size of the pattern; metres of its repeat where it has one."""
    gloss: float = 0.0
    """Strength of highlights, 0 to 1."""
    mirror: float = 0.0
    """Share of light reflected as by a mirror, seen from the front."""
    glow: float = 0.0
    """Light that it gives off, of its own colour."""
    known: bool = True
    """False where there is no depth to know: the outdoors seen through a window."""
    grain: bool = False
    """True if the pattern runs along the longest side of each part."""
    world: bool = False
    """True if the pattern goes on from part to part, as over the pieces of a wall."""


class Light(NamedTuple):
    """A rectangle (a window) or a ball (a lamp) that gives light."""

    centre: tuple[float, float, float]
    power: Color
    """Radiant intensity straight ahead, linear."""
    half_u: tuple[float, float, float]
    """From the centre to the middle of a side; for a lamp the radius along an axis."""
    half_v: tuple[float, float, float]
    """From the centre to the middle of the next side; for a lamp the radius along the other axis."""
    facing: tuple[float, float, float] | None = None
    """Unit direction that a window shines in; None for a lamp, which shines everywhere."""


class Sun(NamedTuple):
    """The sun: parallel light."""

    towards: tuple[float, float, float]
    """Unit vector towards the sun."""
    color: Color
    """Irradiance of a surface that faces the sun, linear."""
    spread: float
    """Width of the sun, radians: it blurs the shadows."""


class Sky(NamedTuple):
    """The colours seen where a ray hits nothing, linear."""

    zenith: Color
    horizon: Color
    ground: Color
    clouds: float
    """Cloud cover, from 0 (clear) to 1 (overcast)."""
    haze: float
    """Distance in metres at which 63 % of the colour is the horizon's; 0 for no haze."""
    seed: float
    """Shifts the clouds."""


_BLACK = Sky((0, 0, 0), (0, 0, 0), (0, 0, 0), 0, 0, 0)


@dataclass
class Scene:
    """Parts and lights, added one by one; ``arrays`` gives them all at once to the renderer."""

    parts: list[tuple[str, Material, tuple[float, ...]]] = field(default_factory=list)
    """(shape, material, (centre x y z, size x y z, yaw, pitch, roll))."""
    lights: list[Light] = field(default_factory=list)
    sun: Sun | None = None
    sunlit: list[Light] = field(default_factory=list)
    """Windows that let the sun in; empty outdoors, where the sun shines everywhere."""
    sky: Sky = _BLACK
    ambient: Color = (0.1, 0.1, 0.1)
    """Light from everywhere that one bounce does not explain, linear."""
    near: float = 100.0
    """Parts farther than this from the eye, metres, are coarse or left out if they would look small."""

    def at(self, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> "Frame":
        """Return a place to build at: x, y, z in metres, yaw in radians around z."""
        return Frame(self, x, y, z, yaw)

    def arrays(self, eye: tuple[float, float, float]) -> "Arrays":
        """Return all parts as triangles, as fine as they are seen from about ``eye``."""
        shapes = all_shapes()
        numbers = np.array([part[2] for part in self.parts], np.float32)
        names, angle = self._detail(numbers, eye)
        # Parts of one shape stand together, so that numpy places all its copies at once.
        order = sorted(np.flatnonzero(angle > 0.005), key=names.__getitem__)
        names, numbers = [names[i] for i in order], numbers[order]
        rotations = _rotations(numbers[:, 6:])
        vertices, triangles, normals, owners, normal_rows = [], [], [], [], []
        start = n_vertices = n_rows = 0
        for name, group in groupby(names):
            shape, count = shapes[name], len(list(group))
            end, n_triangles = start + count, len(shape.triangles)
            stretched = rotations[start:end] * numbers[start:end, None, 3:6]
            placed = shape.vertices @ stretched.transpose(0, 2, 1) + numbers[start:end, None, :3]
            vertices.append(placed.reshape(-1, 3))
            first = n_vertices + len(shape.vertices) * np.arange(count, dtype=np.int32)
            triangles.append((shape.triangles + first[:, None, None]).reshape(-1, 3))
            normals.append(shape.normals)
            owners.append(np.repeat(np.arange(start, end, dtype=np.int32), n_triangles))
            normal_rows.append(np.tile(np.arange(n_rows, n_rows + n_triangles, dtype=np.int32), count))
            n_vertices, n_rows, start = n_vertices + count * len(shape.vertices), n_rows + n_triangles, end
        return Arrays(
            vertices=np.concatenate(vertices),
            triangles=np.concatenate(triangles),
            owner=np.concatenate(owners),
            normal_row=np.concatenate(normal_rows),
            corner_normals=np.concatenate(normals),
            centre=numbers[:, :3],
            size=numbers[:, 3:6],
            rotation=rotations,
            flat=np.array([shapes[name].flat for name in names]),
            materials=[self.parts[i][1] for i in order],
        )

    def _detail(self, numbers: np.ndarray, eye: tuple[float, float, float]) -> tuple[list[str], np.ndarray]:
        """Choose (the fine or the coarse shape of each part, the angle under which it is seen, about, radians)."""
        shapes = all_shapes()
        names = [part[0] for part in self.parts]
        away = np.maximum(np.linalg.norm(numbers[:, :3] - np.array(eye, np.float32), axis=1) - self.near, 0.1)
        angle = numbers[:, 3:6].max(1) / away
        for i in np.flatnonzero(angle < 0.2):
            name = names[i] + FAR
            if name in shapes and (angle[i] < 0.07 or name.startswith(_SOON_COARSE)):
                names[i] = name
        return names, angle


class Arrays(NamedTuple):
    """The triangles and parts of a scene."""

    vertices: Float32[np.ndarray, "vertex 3"]
    triangles: Int32[np.ndarray, "triangle 3"]
    owner: Int32[np.ndarray, " triangle"]
    """The part that each triangle belongs to."""
    normal_row: Int32[np.ndarray, " triangle"]
    """Row of each triangle in ``corner_normals``."""
    corner_normals: Float32[np.ndarray, "row 3 3"]
    """Normals at the corners of the unit shapes' triangles."""
    centre: Float32[np.ndarray, "part 3"]
    size: Float32[np.ndarray, "part 3"]
    rotation: Float32[np.ndarray, "part 3 3"]
    """Turns directions of the part into directions of the world."""
    flat: Bool[np.ndarray, " part"]
    """True for boxes; see ``Shape.flat``."""
    materials: list[Material]


@dataclass(frozen=True)
class Frame:
    """A place to build at, turned around z. Sizes and places are in metres along its own axes."""

    scene: Scene
    x: float
    y: float
    z: float
    yaw: float

    def at(self, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> "Frame":
        """Return a place within this one."""
        x, y, z = self.world(x, y, z)
        return Frame(self.scene, x, y, z, self.yaw + yaw)

    def world(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """Return where a point of this frame lies in the world."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + c * x - s * y, self.y + s * x + c * y, self.z + z

    def add(
        self,
        shape: str,
        material: Material,
        size: tuple[float, float, float],
        at: tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        yaw: float = 0.0,
        pitch: float = 0.0,
        roll: float = 0.0,
    ) -> None:
        """Stand a shape on a point.

        Args:
            size: the shape's extent along x, y and z before it is turned.
            at: the middle of the shape's underside before it is turned.
            yaw, pitch, roll: radians around z, y and x; the shape turns about its middle in the order roll, pitch, yaw.
        """
        x, y, z = self.world(at[0], at[1], at[2] + size[2] / 2)
        self.scene.parts.append((shape, material, (x, y, z, *size, self.yaw + yaw, pitch, roll)))

    def rod(
        self,
        material: Material,
        start: tuple[float, float, float],
        end: tuple[float, float, float],
        radius: float,
        *,
        shape: str = "rod",
    ) -> None:
        """Put a bar between two points."""
        dx, dy, dz = (b - a for a, b in zip(start, end, strict=True))
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        x, y, z = self.world(*((a + b) / 2 for a, b in zip(start, end, strict=True)))
        yaw, pitch = math.atan2(dy, dx), math.acos(max(-1.0, min(1.0, dz / max(length, 1e-9))))
        size = (2 * radius, 2 * radius, length)
        self.scene.parts.append((shape, material, (x, y, z, *size, self.yaw + yaw, pitch, 0.0)))


def _rotations(angles: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of each row of (yaw, pitch, roll), radians."""
    (cy, cp, cr), (sy, sp, sr) = np.cos(angles).T, np.sin(angles).T
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1), np.float32)
