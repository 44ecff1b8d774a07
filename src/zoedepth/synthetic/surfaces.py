"""The surfaces that rays meet: positions, normals and colours of hits."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32

from zoedepth.synthetic.scene import Arrays, Material
from zoedepth.synthetic.textures import PATTERNS, Column, Surface, pattern_albedo
from zoedepth.synthetic.trace import Hits, Vectors


class Table(NamedTuple):
    """The materials of all parts, one row a part; colours are linear."""

    pattern: Int32[np.ndarray, " part"]
    color: Float32[np.ndarray, "part 3"]
    second: Float32[np.ndarray, "part 3"]
    mean: Float32[np.ndarray, "part 3"]
    """Rough average colour, for light that bounces off."""
    scale: Float32[np.ndarray, " part"]
    gloss: Float32[np.ndarray, " part"]
    mirror: Float32[np.ndarray, " part"]
    glow: Float32[np.ndarray, " part"]
    known: Bool[np.ndarray, " part"]
    grain: Bool[np.ndarray, " part"]
    random: Float32[np.ndarray, " part"]
    """A number in [0, 1) that shifts the pattern; the same for all parts with the world's pattern."""
    origin: Float32[np.ndarray, " part"]
    """1 where the pattern starts at the part's middle, 0 where it is the world's."""


def material_table(materials: list[Material], rng: np.random.Generator) -> Table:
    """Return the materials as columns; ``rng`` shifts the pattern of each part."""
    number = {name: index for index, name in enumerate(PATTERNS)}
    color, second = (
        linear(np.array(colors, np.float32)) for colors in zip(*((m.color, m.second) for m in materials), strict=True)
    )

    def column(values: list[float]) -> Float32[np.ndarray, " part"]:
        return np.array(values, np.float32)

    world = np.array([m.world for m in materials])
    return Table(
        pattern=np.array([number[m.pattern] for m in materials], np.int32),
        color=color,
        second=second,
        mean=0.7 * color + 0.3 * second,
        scale=column([m.scale for m in materials]),
        gloss=column([m.gloss for m in materials]),
        mirror=column([m.mirror for m in materials]),
        glow=column([m.glow for m in materials]),
        known=np.array([m.known for m in materials]),
        grain=np.array([m.grain for m in materials]),
        random=np.where(world, 0.37, rng.uniform(size=len(materials))).astype(np.float32),
        origin=np.where(world, 0, 1).astype(np.float32),
    )


class Met(NamedTuple):
    """The places where rays met something."""

    part: Int32[np.ndarray, " n"]
    point: Vectors
    normal: Vectors
    """Unit normal towards the viewer, smooth on curved shapes."""
    face: Vectors
    """Unit normal of the triangle, towards the viewer."""
    distance: Column
    """Distance in lengths of the ray's direction."""


def meet(arrays: Arrays, hits: Hits, origins: Vectors, directions: Vectors, *, smooth: bool = True) -> Met:
    """Return positions and normals of hits, none of which may be a miss.

    Args:
        smooth: interpolate the normals of curved shapes, or use those of the triangles.
    """
    part = arrays.owner.take(hits.triangle)
    point = origins + directions * hits.distance[:, None]
    face = hits.face
    sign = np.where(dot(face, directions) > 0, np.float32(-1), np.float32(1))
    face = face * (sign / np.maximum(norm(face), 1e-20))[:, None]
    if not smooth:
        return Met(part, point, face, face, hits.distance)
    corners = arrays.corner_normals.take(arrays.normal_row.take(hits.triangle), 0)
    first, second = hits.first[:, None], hits.second[:, None]
    local = corners[:, 0] * (1 - first - second) + corners[:, 1] * first + corners[:, 2] * second
    local /= arrays.size.take(part, 0)
    normal = turn(arrays.rotation.take(part, 0), local)
    sign = np.where(dot(normal, face) < 0, np.float32(-1), np.float32(1))
    normal *= (sign / np.maximum(norm(normal), 1e-20))[:, None]
    return Met(part, point, normal, face, hits.distance)


def albedo(arrays: Arrays, table: Table, met: Met, pixel: Column) -> tuple[Float32[np.ndarray, "n 3"], Column]:
    """Return (linear colour, share of mirrored light) of hits.

    Args:
        pixel: size of a pixel at each hit, metres.
    """
    part = met.part
    back = arrays.rotation.take(part, 0).transpose(0, 2, 1)
    local = turn(back, met.point - (arrays.centre * table.origin[:, None]).take(part, 0))
    facing = np.abs(turn(back, met.normal))
    x, y, z = facing.T
    upright, along_x = (z < x) | (z < y), (x > y) & (x >= z)
    size = arrays.size.take(part, 0)
    u, half_u = np.where(along_x, local[:, 1], local[:, 0]), np.where(along_x, size[:, 1], size[:, 0])
    v, half_v = np.where(upright, local[:, 2], local[:, 1]), np.where(upright, size[:, 2], size[:, 1])
    turned = table.grain[part] & (half_v > half_u)
    if turned.any():
        u, v = np.where(turned, v, u), np.where(turned, u, v)
        half_u, half_v = np.where(turned, half_v, half_u), np.where(turned, half_u, half_v)
    colors, mirror = np.empty_like(met.point), table.mirror[part]
    patterns = table.pattern.take(part)
    for number in np.unique(patterns):
        rows = np.flatnonzero(patterns == number)
        p = part.take(rows)
        surface = Surface(
            u=u.take(rows),
            v=v.take(rows),
            pixel=pixel.take(rows),
            half_u=half_u.take(rows) / 2,
            half_v=half_v.take(rows) / 2,
            scale=table.scale.take(p),
            random=table.random.take(p),
            color=table.color.take(p, 0),
            second=table.second.take(p, 0),
            mirror=mirror.take(rows),
        )
        colors[rows] = pattern_albedo(PATTERNS[number], surface)
        mirror[rows] = surface.mirror
    return colors, mirror


def linear(colors: np.ndarray) -> np.ndarray:
    """Turn sRGB colours into linear ones, by a power of 2.2."""
    return (np.clip(colors, 0, 1) ** 2.2).astype(np.float32)


def dot(a: Vectors, b: Vectors) -> Column:
    """Return the dot product of each row, several times faster than ``np.einsum`` for three columns."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def turn(matrices: Float32[np.ndarray, "n 3 3"], vectors: Vectors) -> Vectors:
    """Multiply each matrix by the vector of its row."""
    return np.stack([dot(matrices[:, row], vectors) for row in range(3)], 1)


def cross(a: Vectors, b: Vectors) -> Vectors:
    """Return the cross product of each row, several times faster than ``np.cross``."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], 1)


def norm(a: Vectors) -> Column:
    """Return the length of each row."""
    return np.sqrt(dot(a, a))
