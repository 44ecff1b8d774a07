"""Light that reaches points: from lamps, windows, the sun and the sky, and by one bounce off the surroundings."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int32

from zoedepth.synthetic.noise import noise
from zoedepth.synthetic.scene import Arrays, Light, Scene, Sky, Sun
from zoedepth.synthetic.surfaces import Column, Met, Table, albedo, cross, dot, meet, norm
from zoedepth.synthetic.trace import Tracer, Vectors


class Lit(NamedTuple):
    """The direct light at points."""

    diffuse: Float32[np.ndarray, "n 3"]
    """Light that the surface scatters; multiply it by the surface's colour."""
    highlight: Float32[np.ndarray, "n 3"]
    """Light that shines back; multiply it by the surface's gloss."""


def offset(points: Vectors, faces: Vectors) -> Vectors:
    """Move points off their surface, by enough for float32 at this distance from the origin."""
    return points + faces * (1e-4 + 1e-5 * np.abs(points).max(1))[:, None]


def direct_light(
    scene: Scene, tracer: Tracer, points: Vectors, normals: Vectors, views: Vectors, index: Int32[np.ndarray, " n"],
    draws: Float32[np.ndarray, "draw 3"],
) -> Lit:  # fmt: skip
    """Return the light from lamps, windows and the sun, with soft shadows.

    Args:
        points: places just off the surface.
        normals: unit normals of the surface.
        views: unit directions from the eye to the points.
        index: row of ``draws`` that each point uses.
        draws: random numbers in [0, 1): two choose the place on a light, one chooses among the lights.
    """
    diffuse, highlight = np.zeros_like(points), np.zeros_like(points)
    lights = _strongest_first(scene)
    for group in (lights[:1], lights[1:]):
        if group:
            _add_light(tracer, group, points, normals, views, index, draws, diffuse, highlight)
    if scene.sun is not None:
        _add_sun(scene.sun, scene.sunlit, tracer, points, normals, views, index, draws, diffuse, highlight)
    return Lit(diffuse, highlight)


def _strongest_first(scene: Scene) -> list[Light]:
    return sorted(scene.lights, key=lambda light: -sum(light.power))


def _add_sun(
    sun: Sun, windows: list[Light], tracer: Tracer, points: Vectors, normals: Vectors, views: Vectors,
    index: np.ndarray, draws: np.ndarray, diffuse: np.ndarray, highlight: np.ndarray,
) -> None:  # fmt: skip
    """Add the sun's light to the points that it reaches, through ``windows`` if there are any."""
    towards = np.array(sun.towards, np.float32)
    side = np.cross(towards, (0.31, 0.17, 0.93))
    side /= np.linalg.norm(side)
    spread = sun.spread * 2 * (draws[:, :2] - 0.5)
    directions = (towards + spread[:, :1] * side + spread[:, 1:] * np.cross(towards, side)).astype(np.float32)
    facing = normals @ towards
    rows = np.flatnonzero(facing > 0.01)
    directions, origins = directions.take(index.take(rows), 0), points.take(rows, 0)
    if windows:
        reach = _reach_of_sun(windows, origins, directions)
        open_rows = np.flatnonzero(reach > 0)
        rows, reach = rows.take(open_rows), reach.take(open_rows)
        directions, origins = directions.take(open_rows, 0), origins.take(open_rows, 0)
    else:
        reach = np.full(len(rows), 1e4, np.float32)
    free = np.flatnonzero(~tracer.blocked(origins, directions, reach))
    rows, directions = rows.take(free), directions.take(free, 0)
    color = np.array(sun.color, np.float32)
    diffuse[rows] += facing[rows, None] * color
    highlight[rows] += _blinn(normals.take(rows, 0), views.take(rows, 0), directions)[:, None] * color


def _add_light(
    tracer: Tracer, group: list[Light], points: Vectors, normals: Vectors, views: Vectors, index: np.ndarray,
    draws: np.ndarray, diffuse: np.ndarray, highlight: np.ndarray,
) -> None:  # fmt: skip
    """Add to each point the light of one lamp or window, drawn from the group, times the size of the group."""
    chosen = np.minimum((draws[:, 2] * len(group)).astype(np.int32), len(group) - 1)
    centre, power, half_u, half_v = (np.array([light[k] for light in group], np.float32)[chosen] for k in range(4))
    place = 2 * draws[:, :2] - 1
    target = centre + place[:, :1] * half_u + place[:, 1:] * half_v
    front = np.array([light.facing or (0, 0, 0) for light in group], np.float32)[chosen]
    lamp = np.array([light.facing is None for light in group])[chosen]
    # The shadow ray stops short of the lamp's own glass.
    short = np.where(lamp, 1.5 * norm(half_u) + 0.02, 0.03).astype(np.float32)
    to_light = target.take(index, 0) - points
    distance = norm(to_light)
    to_light /= np.maximum(distance, 1e-3)[:, None]
    facing = dot(normals, to_light)
    strength = (
        np.where(lamp.take(index), 1, -dot(front.take(index, 0), to_light))
        * len(group)
        / np.maximum(distance, 0.35) ** 2
    )
    rows = np.flatnonzero((facing > 0) & (strength > 1e-4))
    directions = to_light.take(rows, 0)
    far = np.maximum(distance.take(rows) - short.take(index.take(rows)), 1e-3)
    free = np.flatnonzero(~tracer.blocked(points.take(rows, 0), directions, far))
    rows, directions = rows.take(free), directions.take(free, 0)
    light = power.take(index.take(rows), 0) * strength.take(rows)[:, None].astype(np.float32)
    diffuse[rows] += facing.take(rows)[:, None] * light
    highlight[rows] += _blinn(normals.take(rows, 0), views.take(rows, 0), directions)[:, None] * light


def _blinn(normals: Vectors, views: Vectors, lights: Vectors) -> Column:
    """Return the strength of Blinn's highlight, with the exponent 32."""
    half = lights - views
    half /= np.maximum(norm(half), 1e-6)[:, None]
    power = np.clip(dot(half, normals), 0, 1)
    for _ in range(5):  # 2**5 = 32
        power = power * power
    return 3 * power


def _reach_of_sun(windows: list[Light], points: Vectors, directions: Vectors) -> Column:
    """Return the distance to the window through which each point sees the sun; 0 where there is none."""
    reach = np.zeros(len(points), np.float32)
    for window in windows:
        centre, half_u, half_v = (np.array(window[k], np.float32) for k in (0, 2, 3))
        facing = np.array(window.facing, np.float32)
        along = directions @ facing
        distance = ((centre - points) @ facing) / np.where(along < -1e-3, along, -1e9)
        place = points + directions * distance[:, None] - centre
        inside = np.abs(place @ half_u) < half_u @ half_u
        inside &= np.abs(place @ half_v) < half_v @ half_v
        reach = np.where(inside & (distance > 0), distance - 0.04, reach)
    return np.maximum(reach, 0).astype(np.float32)


def bounced_light(
    scene: Scene, arrays: Arrays, table: Table, tracer: Tracer, points: Vectors, normals: Vectors, draws: np.ndarray
) -> Float32[np.ndarray, "n 3"]:
    """Return the light from the surroundings, by one ray a point in the direction that two numbers in [0, 1) draw."""
    turn, radius = 2 * np.pi * draws[:, 0], np.sqrt(draws[:, 1])
    helper = np.where(np.abs(normals[:, :1]) > 0.7, np.array([0, 1, 0], np.float32), np.array([1, 0, 0], np.float32))
    tangent = cross(normals, helper)
    tangent /= norm(tangent)[:, None]
    x, y, z = radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - draws[:, 1])
    directions = x[:, None] * tangent + y[:, None] * cross(normals, tangent) + z[:, None] * normals
    directions = directions.astype(np.float32)
    return incoming(scene, arrays, table, tracer, points, directions)


def incoming(
    scene: Scene, arrays: Arrays, table: Table, tracer: Tracer, points: Vectors, directions: Vectors
) -> Float32[np.ndarray, "n 3"]:
    """Return roughly the light that comes along rays, without textures and shadows."""
    light, rows, met = _look(scene, arrays, tracer, points, directions, clouds=False, smooth=False)
    if met is not None:
        # A surface close by is itself shaded by the point it shines on.
        near = (met.distance / (met.distance + 0.25))[:, None]
        arrives = np.array(scene.ambient, np.float32) + 0.5 * unshadowed(scene, met.point, met.normal)
        light[rows] = table.mean.take(met.part, 0) * arrives * near
    return light


def reflection(
    scene: Scene, arrays: Arrays, table: Table, tracer: Tracer, points: Vectors, directions: Vectors, focal: float
) -> Float32[np.ndarray, "n 3"]:
    """Return the light seen in mirrors: with textures, without shadows.

    Args:
        points: places on the mirrors.
        directions: unit directions of the mirrored rays.
        focal: focal length of the camera in pixels, for the size of a pixel on the surfaces seen.
    """
    light, rows, met = _look(scene, arrays, tracer, points, directions, clouds=True, smooth=True)
    if met is not None:
        colors, _ = albedo(arrays, table, met, ((met.distance + 2) / focal).astype(np.float32))
        glow = table.glow[met.part][:, None]
        arrives = np.array(scene.ambient, np.float32) + 0.7 * unshadowed(scene, met.point, met.normal)
        light[rows] = colors * (1.3 * arrives + glow)
    return light


def _look(
    scene: Scene, arrays: Arrays, tracer: Tracer, points: Vectors, directions: Vectors, *, clouds: bool, smooth: bool
) -> tuple[Float32[np.ndarray, "n 3"], Int32[np.ndarray, " met"], Met | None]:
    """Trace rays: (the sky's light where nothing is hit, the rays that met something, and what they met)."""
    hits = tracer.hits(points, directions)
    missed = hits.triangle < 0
    light = np.empty_like(points)
    light[missed] = sky_color(scene.sky, directions[missed], clouds=clouds)
    rows = np.flatnonzero(~missed)
    if not len(rows):
        return light, rows, None
    met = meet(arrays, hits.take(rows), points.take(rows, 0), directions.take(rows, 0), smooth=smooth)
    return light, rows, met


def unshadowed(scene: Scene, points: Vectors, normals: Vectors) -> Float32[np.ndarray, "n 3"]:
    """Return the direct light of the four strongest lamps and windows and of the sun, as if nothing were in the way."""
    total = np.zeros_like(points)
    lights = _strongest_first(scene)
    for light in lights[:4]:
        to_light = np.array(light.centre, np.float32) - points
        distance = np.maximum(norm(to_light), 0.5)
        facing = np.clip(dot(normals, to_light) / distance, 0, 1)
        if light.facing is not None:
            facing *= np.clip(-(to_light @ np.array(light.facing, np.float32)) / distance, 0, 1)
        total += (facing / distance**2)[:, None] * np.array(light.power, np.float32)
    if len(lights) > 4:  # the first four stand for all
        total *= np.float32(sum(sum(light.power) for light in lights) / sum(sum(light.power) for light in lights[:4]))
    if scene.sun is not None and not scene.sunlit:
        facing = np.clip(normals @ np.array(scene.sun.towards, np.float32), 0, 1)
        total += facing[:, None] * np.array(scene.sun.color, np.float32)
    return total


def sky_color(sky: Sky, directions: Vectors, *, clouds: bool = True) -> Float32[np.ndarray, "n 3"]:
    """Return the colour of the sky in directions of any length."""
    rise = directions[:, 2] / np.maximum(norm(directions), 1e-9)
    zenith, horizon, ground = (np.array(color, np.float32) for color in sky[:3])
    share = np.clip(rise, 0, 1)[:, None] ** 0.6
    color = horizon + (zenith - horizon) * share
    color = np.where(rise[:, None] < 0, ground, color)
    if clouds and sky.clouds > 0:
        flat = directions[:, :2] / (np.maximum(rise, 0.02) * norm(directions) + 0.15)[:, None]
        density = noise("cloud")(flat[:, 0] * 0.13 + sky.seed, flat[:, 1] * 0.13, np.full(len(rise), 0.001, np.float32))
        cover = np.clip(4 * (density - 0.75 + 0.6 * sky.clouds), 0, 1) * np.clip(rise * 6, 0, 1)
        white = horizon.mean() * (1.25 - 0.5 * np.clip(density * cover - 0.4, 0, 1))
        color = color + (white[:, None] - color) * (0.9 * cover)[:, None]
    return color.astype(np.float32)
