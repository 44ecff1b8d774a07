"""Unit shapes: triangles that fill the cube from -0.5 to 0.5, made once and placed many times.

z is up, and the front of a shape is at y = -0.5.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int

Points = np.ndarray
FAR = " far"
"""Ending of the name of a shape's coarse version."""


class Shape(NamedTuple):
    """A surface of triangles."""

    vertices: Float32[np.ndarray, "vertex 3"]
    triangles: Int[np.ndarray, "triangle 3"]
    normals: Float32[np.ndarray, "triangle 3 3"]
    """Unit normals at the corners of each triangle, outward; on curved faces they are smooth across edges."""
    flat: bool
    """True if all faces are plane and along the axes of the cube, as those of a box."""


@cache
def all_shapes() -> dict[str, Shape]:
    """Return all shapes by name. They are equal in every process."""
    rng = np.random.default_rng(20)
    shapes = {
        "box": _box(),
        "soft": _superellipsoid(0.25, 10, 16),
        "cushion": _superellipsoid(0.55, 10, 16),
        "sphere": _superellipsoid(1.0, 10, 18),
        "cylinder": _lathe([(0, 0), (1, 0), (1, 1), (0, 1)], sides=20),
        "rod": _lathe([(0, 0), (1, 0), (1, 1), (0, 1)], sides=8),
        "cone": _lathe([(0, 0), (1, 0), (0, 1)], sides=20),
        "frustum": _lathe([(0, 0), (1, 0), (0.65, 1), (0, 1)], sides=16),
        "trunk": _lathe([(0, 0), (1, 0), (0.7, 0.1), (0.6, 0.5), (0.4, 1)], sides=9),
        "bowl": _lathe([(0, 0), (0.45, 0), (0.8, 0.4), (1, 1), (0.93, 1), (0.72, 0.45), (0.4, 0.1), (0, 0.1)]),
        "plate": _lathe([(0, 0), (0.6, 0), (1, 0.9), (0.97, 1), (0.6, 0.35), (0, 0.3)]),
        "cup": _lathe([(0, 0), (0.8, 0), (0.95, 0.15), (1, 1), (0.9, 1), (0.86, 0.2), (0, 0.15)]),
        "vase": _lathe([(0, 0), (0.5, 0), (0.85, 0.2), (1, 0.45), (0.75, 0.7), (0.35, 0.86), (0.5, 1), (0.4, 0.98)]),
        "jar": _lathe([(0, 0), (0.9, 0), (1, 0.1), (1, 0.7), (0.7, 0.85), (0.75, 0.87), (0.75, 1), (0, 1)]),
        "bottle": _lathe([(0, 0), (0.95, 0), (1, 0.04), (1, 0.55), (0.36, 0.76), (0.34, 0.97), (0.4, 1), (0, 1)]),
        "pot": _lathe([(0, 0), (0.7, 0), (0.95, 0.85), (1, 0.85), (1, 1), (0.88, 1), (0.8, 0.8), (0, 0.8)]),
        "shade": _lathe([(1, 0), (0.6, 1)], sides=24),
        "leg": _lathe([(0.4, 0), (0.6, 0.05), (0.5, 0.3), (0.8, 0.55), (0.6, 0.75), (1, 0.8), (1, 1)], sides=10),
        "dome": _lathe([(np.cos(t), np.sin(t)) for t in np.linspace(0, np.pi / 2, 8)]),
        "ring": _torus(0.12),
        "tyre": _torus(0.28),
        "taper": _hull([(-1, -1, 1, 1, 0), (-0.7, -0.7, 0.7, 0.7, 1)]),
        "gable": _prism([(-0.5, -0.5), (0.5, -0.5), (0, 0.5)]),
        "wedge": _prism([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5)]),
        "hip": _hull([(-1, -1, 1, 1, 0), (-0.45, -0.03, 0.45, 0.03, 1)]),
        "curtain": _curtain(),
        "folds": _curtain(waves=3, gather=0.35),
        "fronds": _fronds(rng, 14, bend=0.9),
        "spikes": _fronds(rng, 18, bend=0.3),
        "tuft": _fronds(rng, 26, bend=0.5, width=0.05),
        "conifer": _conifer(rng),
        "torso": _hull(
            [
                (-0.7, -0.6, 0.7, 0.6, 0),
                (-0.62, -0.6, 0.62, 0.6, 0.35),
                (-1, -0.9, 1, 0.9, 0.8),
                (-0.5, -0.5, 0.5, 0.5, 1),
            ],
            rounded=True,
        ),
    }
    shapes |= {f"leaves{i}": _leaves(rng, count) for i, count in enumerate((150, 190, 230))}
    shapes |= {f"blob{i}": _blob(rng, amount) for i, amount in enumerate((0.25, 0.35, 0.45))}
    shapes |= {f"rock{i}": _blob(rng, 0.5, detail=2) for i in range(2)}
    for name, (body, cabin) in CARS.items():
        shapes[f"{name} body"], shapes[f"{name} cabin"] = _loft(body, 0.18, 15, 16), _loft(cabin, 0.3, 13, 12)
        shapes[f"{name} body{FAR}"], shapes[f"{name} cabin{FAR}"] = _loft(body, 0.3, 7, 8), _loft(cabin, 0.3, 5, 8)
    shapes |= {
        f"soft{FAR}": _box(),
        f"cushion{FAR}": _superellipsoid(0.6, 4, 8),
        f"sphere{FAR}": _superellipsoid(1.0, 4, 7),
        f"cylinder{FAR}": _lathe([(0, 0), (1, 0), (1, 1), (0, 1)], sides=7),
        f"rod{FAR}": _lathe([(1, 0), (1, 1)], sides=4),
        f"trunk{FAR}": _lathe([(1, 0), (0.6, 0.3), (0.4, 1)], sides=5),
        f"torso{FAR}": _superellipsoid(0.5, 4, 6),
        f"conifer{FAR}": _conifer(rng, 120),
    }
    shapes |= {f"leaves{i}{FAR}": _leaves(rng, 45, size=0.23) for i in range(3)}
    shapes |= {f"blob{i}{FAR}": _blob(rng, 0.3, rows=5) for i in range(3)}
    return shapes


CARS = {
    "sedan": (
        [(0, 0.8, 0.3, 0.72), (0.04, 0.95, 0.12, 0.9), (0.3, 1, 0, 1), (0.7, 1, 0, 1), (0.93, 0.93, 0.08, 0.8),
         (1, 0.75, 0.25, 0.6)],
        [(0, 0.9, 0, 0.12), (0.25, 0.76, 0, 0.95), (0.6, 0.75, 0, 1), (1, 0.95, 0, 0.1)],
    ),
    "hatchback": (
        [(0, 0.85, 0.25, 0.85), (0.05, 0.97, 0.1, 1), (0.7, 1, 0, 0.97), (0.93, 0.93, 0.08, 0.78), (1, 0.75, 0.2, 0.6)],
        [(0, 0.9, 0, 0.3), (0.12, 0.78, 0, 0.92), (0.6, 0.77, 0, 1), (1, 0.95, 0, 0.1)],
    ),
    "suv": (
        [(0, 0.92, 0.2, 0.95), (0.04, 1, 0.05, 1), (0.75, 1, 0, 1), (0.95, 0.96, 0.05, 0.88), (1, 0.85, 0.15, 0.75)],
        [(0, 0.93, 0, 0.4), (0.06, 0.84, 0, 0.97), (0.68, 0.82, 0, 1), (1, 0.95, 0, 0.1)],
    ),
    "van": (
        [(0, 0.97, 0.05, 1), (0.02, 1, 0, 1), (0.8, 1, 0, 1), (0.97, 0.95, 0.05, 0.9), (1, 0.85, 0.15, 0.7)],
        [(0, 0.95, 0, 0.95), (0.03, 0.9, 0, 1), (0.75, 0.88, 0, 1), (1, 0.95, 0, 0.1)],
    ),
}  # fmt: skip
"""Name → outlines of the body and of the cabin: (place along the length, half width, bottom, top) from tail to nose."""


def _fitted(
    vertices: Points, faces: Int[np.ndarray, "triangle 3"], *, crease: float = 40.0, flat: bool = False
) -> Shape:
    """Stretch triangles to the unit cube and add normals; edges sharper than ``crease`` degrees stay sharp."""
    low, high = vertices.min(0), vertices.max(0)
    vertices = (vertices - (low + high) / 2) / np.maximum(high - low, 1e-9)
    corners = vertices[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(face_normals, axis=-1)
    corners, face_normals = corners[area > 1e-9], face_normals[area > 1e-9]
    unit = face_normals / np.linalg.norm(face_normals, axis=-1, keepdims=True)
    _, same = np.unique(np.round(corners.reshape(-1, 3), 4), axis=0, return_inverse=True)
    same = same.ravel()
    order = np.argsort(same, kind="stable")
    starts = np.searchsorted(same[order], np.arange(same.max() + 2))
    counts = np.diff(starts)[same]
    left = np.repeat(np.arange(len(same)), counts)  # all pairs of corners at one place
    within = np.arange(len(left)) - np.repeat(np.cumsum(counts) - counts, counts)
    right = order[starts[same[left]] + within]
    smooth = (unit[left // 3] * unit[right // 3]).sum(-1) > np.cos(np.deg2rad(crease))
    normals = np.zeros((len(same), 3))
    np.add.at(normals, left[smooth], face_normals[right[smooth] // 3])
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    merged = np.zeros((same.max() + 1, 3), np.float32)
    merged[same] = corners.reshape(-1, 3)
    return Shape(merged, same.reshape(-1, 3).astype(np.int32), normals.reshape(-1, 3, 3).astype(np.float32), flat)


def _grid(points: Points, *, crease: float = 40.0) -> Shape:
    """Make the sheet through a grid of points (rows, columns, 3)."""
    vertices, faces = _grid_faces(points)
    return _fitted(vertices, faces, crease=crease)


def _grid_faces(points: Points) -> tuple[Points, np.ndarray]:
    """Return the vertices of a grid of points and two triangles for each of its cells."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return points.reshape(-1, 3), faces


def _box() -> Shape:
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])
    return _fitted(corners, faces, flat=True)


def _lathe(profile: Sequence[tuple[float, float]], *, sides: int = 20) -> Shape:
    """Turn an outline around z; ``profile`` lists its (radius, height) from the bottom up."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    radius, height = np.array(profile, float).T
    points = np.stack(
        np.broadcast_arrays(radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle), height[:, None]), -1
    )
    return _grid(points)


def _superellipsoid(exponent: float, rows: int, columns: int) -> Shape:
    """Make a sphere (``exponent`` 1) or, towards 0, a box with round edges."""

    def power(x: np.ndarray) -> np.ndarray:
        return np.sign(x) * np.abs(x) ** exponent

    latitude, longitude = (
        np.linspace(-np.pi / 2, np.pi / 2, rows + 1)[:, None],
        np.linspace(-np.pi, np.pi, columns + 1) + np.pi / columns,
    )
    c, s = power(np.cos(latitude)), power(np.sin(latitude))
    points = np.stack(np.broadcast_arrays(c * power(np.cos(longitude)), c * power(np.sin(longitude)), s), -1)
    return _grid(points, crease=50)


def _torus(thickness: float) -> Shape:
    """Make a ring around the y axis, like a wheel that rolls along x."""
    around, tube = np.linspace(0, 2 * np.pi, 21)[:, None], np.linspace(0, 2 * np.pi, 9)
    radius = 1 - thickness + thickness * np.cos(tube)
    points = np.stack([radius * np.cos(around), thickness * np.sin(tube) + 0 * around, radius * np.sin(around)], -1)
    return _grid(points[::-1], crease=60)


def _hull(levels: Sequence[tuple[float, float, float, float, float]], *, rounded: bool = False) -> Shape:
    """Join rectangles into a closed surface; ``rounded`` makes them ellipses.

    Args:
        levels: (x0, y0, x1, y1, height) of each rectangle, from the bottom up.
    """
    rows = []
    for x0, y0, x1, y1, z in levels:
        if rounded:
            angle = np.linspace(0, 2 * np.pi, 15)
            outline = np.stack([(x1 - x0) / 2 * np.cos(angle), (y1 - y0) / 2 * np.sin(angle), 0 * angle + z], -1)
        else:
            outline = np.array([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z), (x0, y0, z)], float)
        rows.append(outline)
    ends = [np.broadcast_to(row.mean(0), row.shape) for row in (rows[0], rows[-1])]
    return _grid(np.stack([ends[0], *rows, ends[1]]), crease=50 if rounded else 25)


def _loft(stations: Sequence[tuple[float, float, float, float]], rounding: float, rows: int, columns: int) -> Shape:
    """Join rounded cross sections along x; for the stations see ``CARS``."""
    fine = np.linspace(0, 1, rows)
    place, half, bottom, top = np.array(stations, float).T
    half, bottom, top = (np.interp(fine, place, values) for values in (half, bottom, top))
    angle = np.linspace(0, 2 * np.pi, columns + 1) + np.pi / 4
    y = np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** rounding
    z = np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** rounding
    middle, rise = (top + bottom)[:, None] / 2, (top - bottom)[:, None] / 2
    sections = np.stack([fine[:, None] + 0 * y, half[:, None] * y * (1 - 0.06 * (z > 0)), middle + rise * z], -1)
    ends = [np.broadcast_to(section.mean(0), section.shape) for section in (sections[0], sections[-1])]
    return _grid(np.concatenate([ends[0][None], sections, ends[1][None]]), crease=45)


def _prism(outline: Sequence[tuple[float, float]]) -> Shape:
    """Extrude a convex outline along y; it lists (x, z) counter-clockwise."""
    front = np.array([(x, -0.5, z) for x, z in outline])
    points, n = np.concatenate([front, front + np.array([0, 1, 0])]), len(outline)
    faces = [(0, i, i + 1) for i in range(1, n - 1)] + [(n, n + i + 1, n + i) for i in range(1, n - 1)]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, n + i, n + j), (i, n + j, j)]
    return _fitted(points, np.array(faces))


def _curtain(*, waves: float = 9, gather: float = 0.0) -> Shape:
    x, z = np.linspace(0, 1, 46), np.linspace(0, 1, 5)[:, None]
    y = np.sin(x * waves * 2 * np.pi) + 0.4 * np.sin(x * waves * 3.3 + 2 * z)
    pull = 1 - gather * np.sin(np.pi * z) ** 2
    return _grid(np.stack([x * pull, y * np.ones_like(z), z + 0 * x], -1), crease=80)


def _sprinkled(centres: Points, tangents: Points, others: Points) -> Shape:
    """Put a leaf at each centre, spanned by two vectors."""
    quads = np.stack([centres - tangents, centres - others, centres + tangents, centres + others], 1).reshape(-1, 3)
    index = 4 * np.arange(len(centres))[:, None]
    faces = np.concatenate([index + np.array([0, 1, 2]), index + np.array([0, 2, 3])])
    return _fitted(quads, faces)


def _leaves(rng: np.random.Generator, count: int, *, size: float = 0.125) -> Shape:
    """Spread loose leaves over an uneven ball."""
    direction = _directions(rng, count)
    bumps = _directions(rng, 7)
    radius = 0.6 + 0.4 * ((direction @ bumps.T).max(1) ** 3)
    centres = direction * (radius * rng.uniform(0.75, 1, count))[:, None]
    tangent = np.cross(direction, _directions(rng, count)) + 0.4 * _directions(rng, count)
    tangent *= size / np.linalg.norm(tangent, axis=1, keepdims=True)
    other = 0.6 * np.cross(tangent, _directions(rng, count))
    return _sprinkled(centres, tangent, other)


def _fronds(rng: np.random.Generator, count: int, *, bend: float, width: float = 0.13) -> Shape:
    """Grow long leaves from one root."""
    parts: list[Points] = []
    along = np.linspace(0, 1, 6)
    for i in range(count):
        turn, lean, length = 2.4 * i + rng.uniform(0, 0.5), rng.uniform(0.15, 1.0), rng.uniform(0.6, 1)
        out = length * (np.sin(lean) * along + 0.35 * bend * lean * along**2)
        up = length * (np.cos(lean) * along - bend * 0.55 * lean * along**2)
        half = width * length * np.sin(np.pi * np.clip(along, 0.08, 0.97)) ** 0.8
        spine = np.stack([np.cos(turn) * out, np.sin(turn) * out, up], -1)
        side = half[:, None] * np.array([-np.sin(turn), np.cos(turn), 0.25])
        parts.append(np.stack([spine - side, spine + side]))
    return _joined([_grid_faces(part) for part in parts])


def _conifer(rng: np.random.Generator, count: int = 330) -> Shape:
    """Hang drooping twigs around a stem, longer towards the ground."""
    height = 1 - np.sqrt(rng.uniform(0, 1, count))
    turn = rng.uniform(0, 2 * np.pi, count)
    reach = (1 - height) * rng.uniform(0.35, 1.0, count) * (0.75 + 0.25 * np.sin(height * 60))
    outward = np.stack([np.cos(turn), np.sin(turn), -0.35 + 0 * turn], -1)
    centres = np.stack([np.cos(turn) * reach, np.sin(turn) * reach, 2.2 * height - 0.25 * reach], -1)
    long = (0.03 + 0.16 * (1 - height)[:, None]) * (330 / count) ** 0.4
    across = np.stack([-np.sin(turn), np.cos(turn), rng.uniform(-0.5, 0.5, count)], -1)
    return _sprinkled(centres, outward * long, across * long * 0.55)


def _joined(parts: Sequence[tuple[Points, np.ndarray]]) -> Shape:
    offsets = np.cumsum([0, *(len(points) for points, _ in parts[:-1])])
    faces = np.concatenate([face + offset for (_, face), offset in zip(parts, offsets, strict=True)])
    return _fitted(np.concatenate([points for points, _ in parts]), faces, crease=60)


def _blob(rng: np.random.Generator, amount: float, *, detail: int = 5, rows: int = 10) -> Shape:
    """Make a lumpy ball."""
    sphere = _superellipsoid(1.0, rows, int(1.5 * rows))
    ball = sphere.vertices.astype(float) * 2

    def wave(frequency: float) -> Points:
        return np.sin(ball @ (frequency * _directions(rng, 3)).T + rng.uniform(0, 6, 3)).mean(1)

    radius = 1 + amount * (wave(2.5) + 0.7 * wave(float(detail)) + 0.5 * wave(2.0 * detail))
    return _fitted(ball * radius[:, None], sphere.triangles, crease=60 if detail > 2 else 20)


def _directions(rng: np.random.Generator, count: int) -> Points:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
