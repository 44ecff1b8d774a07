"""A scene: shapes placed in metres, what they are made of, and the lights. x and y are level, z is up."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int32

from zoedepth.synthetic.shapes import FAR, all_shapes

_SOON_COARSE = ("leaves", "sphere", "blob", "conifer")
"""Shapes whose coarse version does nearly as well."""

Color = tuple[float, float, float]
"""sRGB, 0 to 1."""


class Material(NamedTuple):
    """What a part is made of."""

    pattern: str
    """A function of ``zoedepth.synthetic.textures``."""
    color: Color
    second: Color = (0.5, 0.5, 0.5)
    """The pattern's other colour."""
    scale: float = 1.0
    """Size of the pattern's repeat, metres."""
    gloss: float = 0.0
    """Strength of highlights, 0 to 1."""
    mirror: float = 0.0
    """Share of light reflected as a mirror does, seen from the front."""
    glow: float = 0.0
    """Light it gives off itself, of its own colour."""
    known: bool = True
    """False: a view of what has no depth, as the outdoors seen through a window."""
    grain: bool = False
    """The pattern runs along the longest side of each part."""
    world: bool = False
    """The pattern goes on from part to part, as over the pieces of a wall."""


class Light(NamedTuple):
    """A rectangle (a window) or a ball (a lamp) that gives light."""

    centre: tuple[float, float, float]
    power: Color
    """Radiant intensity straight ahead, linear."""
    half_u: tuple[float, float, float]
    half_v: tuple[float, float, float]
    """From the centre to the middle of two sides. A lamp: the radius along two axes."""
    facing: tuple[float, float, float] | None = None
    """The direction a window shines in; None shines everywhere."""


class Sun(NamedTuple):
    """Parallel light."""

    towards: tuple[float, float, float]
    """Unit vector to the sun."""
    color: Color
    """Irradiance of a surface that faces it, linear."""
    spread: float
    """Blur of its shadows, radians."""


class Sky(NamedTuple):
    """What is seen where nothing is hit, linear."""

    zenith: Color
    horizon: Color
    ground: Color
    clouds: float
    """0 clear to 1 overcast."""
    haze: float
    """Distance in metres at which 63 % of the colour is the horizon's; 0 is no haze."""
    seed: float


_BLACK = Sky((0, 0, 0), (0, 0, 0), (0, 0, 0), 0, 0, 0)


@dataclass
class Scene:
    """Parts and lights, added one by one; ``arrays`` has them all at once for the renderer."""

    parts: list[tuple[str, Material, tuple[float, ...]]] = field(default_factory=list)
    """(shape, material, (centre x y z, size x y z, yaw, pitch, roll))."""
    lights: list[Light] = field(default_factory=list)
    sun: Sun | None = None
    sunlit: list[Light] = field(default_factory=list)
    """The windows that let the sun in; empty where there is no roof."""
    sky: Sky = _BLACK
    ambient: Color = (0.1, 0.1, 0.1)
    """Light from everywhere that one bounce does not explain, linear."""
    near: float = 100.0
    """Parts farther than this from the eye, metres, are coarse or left out where they would look small."""

    def at(self, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> "Frame":
        """A place to build at: x, y, z metres, yaw radians around z."""
        return Frame(self, x, y, z, yaw)

    def arrays(self, eye: tuple[float, float, float]) -> "Arrays":
        """All parts as triangles, as fine as is seen from about ``eye``."""
        shapes = all_shapes()
        numbers = np.array([part[2] for part in self.parts], np.float32)
        names = [part[0] for part in self.parts]
        away = np.maximum(np.linalg.norm(numbers[:, :3] - np.array(eye, np.float32), axis=1) - self.near, 0.1)
        angle = numbers[:, 3:6].max(1) / away
        for i in np.flatnonzero(angle < 0.2):
            name = names[i] + FAR
            if name in shapes and (angle[i] < 0.07 or name.startswith(_SOON_COARSE)):
                names[i] = name
        order = sorted(np.flatnonzero(angle > 0.005), key=names.__getitem__)
        parts, names, numbers = [self.parts[i] for i in order], [names[i] for i in order], numbers[order]
        rotations = _rotations(numbers[:, 6:])
        vertices, triangles, normals, owners = [], [], [], []
        start = n_vertices = 0
        while start < len(parts):
            end = start
            while end < len(parts) and names[end] == names[start]:
                end += 1
            shape, count = shapes[names[start]], end - start
            stretched = rotations[start:end] * numbers[start:end, None, 3:6]
            placed = shape.vertices @ stretched.transpose(0, 2, 1) + numbers[start:end, None, :3]
            vertices.append(placed.reshape(-1, 3))
            first = n_vertices + len(shape.vertices) * np.arange(count, dtype=np.int32)
            triangles.append((shape.triangles + first[:, None, None]).reshape(-1, 3))
            n_vertices += count * len(shape.vertices)
            n_triangles = len(shape.triangles)
            normals.append(np.broadcast_to(np.arange(n_triangles), (count, n_triangles)).ravel())
            owners.append(np.repeat(np.arange(start, end, dtype=np.int32), n_triangles))
            start = end
        # The row of a triangle in the table of all unit shapes' corner normals.
        table, rows_of = [], {}
        for name in dict.fromkeys(names):
            rows_of[name] = sum(len(rows) for rows in table)
            table.append(shapes[name].normals)
        offsets = np.array([rows_of[name] for name in names], np.int32)
        owner = np.concatenate(owners)
        return Arrays(
            vertices=np.concatenate(vertices),
            triangles=np.concatenate(triangles),
            owner=owner,
            normal_row=np.concatenate(normals).astype(np.int32) + offsets[owner],
            corner_normals=np.concatenate(table),
            centre=numbers[:, :3],
            size=numbers[:, 3:6],
            rotation=rotations,
            flat=np.array([shapes[name].flat for name in names]),
            materials=[part[1] for part in parts],
        )


class Arrays(NamedTuple):
    """A scene's triangles and parts."""

    vertices: Float32[np.ndarray, "vertex 3"]
    triangles: Int32[np.ndarray, "triangle 3"]
    owner: Int32[np.ndarray, " triangle"]
    """The part each belongs to."""
    normal_row: Int32[np.ndarray, " triangle"]
    corner_normals: Float32[np.ndarray, "row 3 3"]
    centre: Float32[np.ndarray, "part 3"]
    size: Float32[np.ndarray, "part 3"]
    rotation: Float32[np.ndarray, "part 3 3"]
    """World from part."""
    flat: np.ndarray
    materials: list[Material]


@dataclass(frozen=True)
class Frame:
    """A place to build at, turned around z. Sizes and places are metres in its own axes."""

    scene: Scene
    x: float
    y: float
    z: float
    yaw: float

    def at(self, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> "Frame":
        """A place within this one."""
        x, y, z = self.world(x, y, z)
        return Frame(self.scene, x, y, z, self.yaw + yaw)

    def world(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """A point of this frame in the world."""
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
        """Stand a shape of this size at a point, which is the middle of its underside before it is tilted.

        Args:
            yaw, pitch, roll: radians around z, y and x, applied in the order roll, pitch, yaw about its middle.
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
        """A bar from point to point."""
        dx, dy, dz = (b - a for a, b in zip(start, end, strict=True))
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        x, y, z = self.world(*((a + b) / 2 for a, b in zip(start, end, strict=True)))
        yaw, pitch = math.atan2(dy, dx), math.acos(max(-1.0, min(1.0, dz / max(length, 1e-9))))
        size = (2 * radius, 2 * radius, length)
        self.scene.parts.append((shape, material, (x, y, z, *size, self.yaw + yaw, pitch, 0.0)))


def _rotations(angles: np.ndarray) -> np.ndarray:
    """(n, 3, 3) from yaw, pitch, roll."""
    (cy, cp, cr), (sy, sp, sr) = np.cos(angles).T, np.sin(angles).T
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1), np.float32)
