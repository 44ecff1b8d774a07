"""The renderer: a scene and a camera give a picture in linear light and its exact depth."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int32

from zoedepth.geometry.camera import Intrinsics
from zoedepth.synthetic.light import bounced_light, direct_light, offset, reflection, sky_color
from zoedepth.synthetic.scene import Arrays, Scene
from zoedepth.synthetic.surfaces import Met, Table, albedo, dot, material_table, meet, norm
from zoedepth.synthetic.trace import Tracer, Vectors

_TILE = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]])
_SAMPLES = ((-0.3, -0.25), (0.3, 0.25))
_NEIGHBOURS = tuple(sorted(((y, x) for y in (-1, 0, 1) for x in (-1, 0, 1)), key=lambda o: o[0] ** 2 + o[1] ** 2))


class View(NamedTuple):
    """A camera in the world, and the size of its picture."""

    position: Float32[np.ndarray, " 3"]
    rotation: Float32[np.ndarray, "3 3"]
    """Turns directions of the camera (x right, y down, z ahead) into directions of the world."""
    camera: Intrinsics
    size: tuple[int, int]
    """(height, width)."""

    def rays(self, step: int = 1) -> Vectors:
        """Return the rays of every ``step``-th pixel both ways, row after row; each reaches depth 1."""
        size = -(-self.size[0] // step), -(-self.size[1] // step)
        camera = self.camera if step == 1 else self.camera.scaled(1 / step, 1 / step)
        return (camera.rays(size).reshape(-1, 3) @ self.rotation.T).astype(np.float32)


class Rendering(NamedTuple):
    """A picture and its exact depth."""

    color: Float32[np.ndarray, "height width 3"]
    """Linear light."""
    depth: Float32[np.ndarray, "height width"]
    """Metres along the optical axis at the centre of each pixel; 0 where there is none."""


def render(scene: Scene, arrays: Arrays, tracer: Tracer, view: View, rng: np.random.Generator) -> Rendering:
    """Trace and shade one picture of a scene.

    Args:
        arrays: the scene's triangles.
        tracer: the scene's triangles, ready for rays.
        rng: shifts the patterns and the noise of the soft shadows.
    """
    table = material_table(arrays.materials, rng)
    height, width = view.size
    rays = view.rays()
    hits = tracer.hits(view.position, rays)
    seen = np.flatnonzero(hits.triangle >= 0)
    color = np.empty_like(rays)
    missed = hits.triangle < 0
    color[missed] = sky_color(scene.sky, rays[missed])
    keys = np.full(height * width, -1, np.int32)
    depth = np.zeros(height * width, np.float32)
    if len(seen):
        directions = rays.take(seen, 0)
        met = meet(arrays, hits.take(seen), view.position, directions)
        keys[seen] = _face_keys(arrays, met)
        views = directions / norm(directions)[:, None]
        color[seen] = _shade(scene, arrays, table, tracer, view, met, views, seen, keys.reshape(height, width), rng)
        depth[seen] = np.where(table.known[met.part], met.distance, 0)
    picture = _antialias(color.reshape(height, width, 3), keys.reshape(height, width), view, arrays, tracer)
    return Rendering(picture, depth.reshape(height, width))


def _shade(
    scene: Scene, arrays: Arrays, table: Table, tracer: Tracer, view: View, met: Met, views: Vectors,
    seen: np.ndarray, keys: Int32[np.ndarray, "height width"], rng: np.random.Generator,
) -> Vectors:  # fmt: skip
    """Return the colour of each hit: its light, its glow, its highlights and mirror images, through the haze.

    Args:
        views: unit directions from the eye to the hits.
        seen: number of each hit's pixel.
        keys: the face that each pixel shows; see ``_face_keys``.
    """
    cosine = np.clip(-dot(views, met.face), 0.02, 1)
    pixel = met.distance / view.camera.fx / np.sqrt(cosine)
    colors, mirror = albedo(arrays, table, met, pixel.astype(np.float32))
    outside = offset(met.point, met.face)
    light, highlight = _light(scene, arrays, table, tracer, outside, met.normal, views, seen, keys, rng)
    glow, gloss = table.glow[met.part], table.gloss[met.part]
    shaded = colors * (light * (1 - mirror[:, None]) + glow[:, None]) + highlight * gloss[:, None]
    fresnel = mirror + (1 - mirror) * gloss * 0.6 * (1 - cosine) ** 4
    rows = np.flatnonzero(fresnel > 0.04)
    if len(rows):
        normals = met.normal[rows]
        mirrored = (views[rows] - 2 * dot(views[rows], normals)[:, None] * normals).astype(np.float32)
        image = reflection(scene, arrays, table, tracer, outside[rows], mirrored, view.camera.fx)
        shaded[rows] += fresnel[rows, None] * image
    if scene.sky.haze > 0:
        share = 1 - np.exp(-met.distance / scene.sky.haze)[:, None]
        shaded += (np.array(scene.sky.horizon, np.float32) - shaded) * share
    return shaded


def _light(
    scene: Scene, arrays: Arrays, table: Table, tracer: Tracer, points: Vectors, normals: Vectors, views: Vectors,
    seen: np.ndarray, keys: Int32[np.ndarray, "height width"], rng: np.random.Generator,
) -> tuple[Vectors, Vectors]:  # fmt: skip
    """Return (scattered light, highlights) of the hits.

    Each pixel casts one ray to one light; the mean over neighbours on the same face takes the noise away. Light that
    bounces changes slowly, so every other pixel both ways is enough for it.
    """
    height, width = keys.shape
    index, draws = _draws(height, width, rng)
    lit = direct_light(scene, tracer, points, normals, views, index[seen], draws)
    direct = np.zeros((height * width, 6), np.float32)
    direct[seen, :3], direct[seen, 3:] = lit.diffuse, lit.highlight
    direct = _smooth(direct.reshape(height, width, 6), keys, 4 if scene.lights else 3).reshape(-1, 6)
    light, highlight = np.ascontiguousarray(direct[:, :3]), direct[:, 3:].take(seen, 0)
    coarse = np.zeros((height, width), bool)
    coarse[::2, ::2] = True
    chosen = coarse.ravel()[seen]
    index = _draws((height + 1) // 2, (width + 1) // 2, rng)[0]
    index = index[keys[::2, ::2].ravel() >= 0]
    bounced = np.zeros((height, width, 3), np.float32)
    for numbers in (draws[index], (draws[index] + (0.37, 0.61, 0.0)) % 1):
        bounced.reshape(-1, 3)[seen[chosen]] += 0.5 * bounced_light(
            scene, arrays, table, tracer, points[chosen], normals[chosen], numbers.astype(np.float32)
        )
    light += _enlarge(_smooth(bounced[::2, ::2], keys[::2, ::2], 4), keys).reshape(-1, 3)
    light += 0.25 * np.array(scene.ambient, np.float32)
    return light.take(seen, 0), highlight


def _face_keys(arrays: Arrays, met: Met) -> Int32[np.ndarray, " n"]:
    """Return a number for the face of each hit: one for each side of a box, one for the whole of a curved part."""
    return met.part * 8 + np.where(arrays.flat[met.part], _side(met.face), 7)


def _side(normals: Vectors) -> Int32[np.ndarray, " n"]:
    """Return 0 to 5: the axis that a normal is nearest to, and its direction along it."""
    axis = np.abs(normals).argmax(1)
    positive = np.take_along_axis(normals, axis[:, None], 1)[:, 0] > 0
    return (2 * axis + positive).astype(np.int32)


def _draws(
    height: int, width: int, rng: np.random.Generator
) -> tuple[Int32[np.ndarray, " n"], Float32[np.ndarray, "16 3"]]:
    """Return (index of each pixel's draw, sixteen draws of three numbers in [0, 1)).

    Each draw occurs once in any 4x4 pixels, so a mean over 4x4 pixels is always one over the same draws: it shows no
    noise.
    """
    tile = _TILE[np.arange(height)[:, None] % 4, np.arange(width) % 4].astype(np.int32)
    steps = np.array([0.8191725134, 0.6710436067, 0.5497004779])  # M. Roberts' sequence R3
    return tile.ravel(), ((rng.random(3) + np.arange(16)[:, None] * steps) % 1).astype(np.float32)


def _smooth(
    field: Float32[np.ndarray, "h w c"], keys: Int32[np.ndarray, "h w"], width: int
) -> Float32[np.ndarray, "h w c"]:
    """Average over ``width`` x ``width`` pixels, as far as they show the same face."""
    for axis in (0, 1):
        total, weight = field.copy(), np.ones(keys.shape, np.float32)
        for step in range(-((width - 1) // 2), width // 2 + 1):
            if step == 0:
                continue
            here, there = [slice(None), slice(None)], [slice(None), slice(None)]
            here[axis], there[axis] = (
                (slice(-step, None), slice(None, step)) if step < 0 else (slice(None, -step), slice(step, None))
            )
            a, b = tuple(here), tuple(there)
            same = (keys[a] == keys[b]).astype(np.float32)
            total[a] += field[b] * same[..., None]
            weight[a] += same
        field = total / weight[..., None]
    return field


def _enlarge(small: Float32[np.ndarray, "h w 3"], keys: Int32[np.ndarray, "H W"]) -> Float32[np.ndarray, "H W 3"]:
    """Go from every other pixel to all: average the neighbours on the same face or, if there are none, all of them."""
    height, width = keys.shape
    result = np.empty((height, width, 3), np.float32)
    padded = np.pad(small, ((0, 1), (0, 1), (0, 0)), mode="edge")
    padded_keys = np.pad(keys[::2, ::2], ((0, 1), (0, 1)), mode="edge")
    for oy in (0, 1):
        for ox in (0, 1):
            own = keys[oy::2, ox::2]
            h, w = own.shape
            total, plain, weight = (
                np.zeros((h, w, 3), np.float32),
                np.zeros((h, w, 3), np.float32),
                np.zeros((h, w), np.float32),
            )
            for dy in range(oy + 1):
                for dx in range(ox + 1):
                    near = padded[dy : dy + h, dx : dx + w]
                    same = (padded_keys[dy : dy + h, dx : dx + w] == own).astype(np.float32)
                    total += near * same[..., None]
                    plain += near
                    weight += same
            mean = total / np.maximum(weight, 1)[..., None]
            result[oy::2, ox::2] = np.where(weight[..., None] > 0, mean, plain / ((oy + 1) * (ox + 1)))
    return result


def _antialias(color: np.ndarray, keys: np.ndarray, view: View, arrays: Arrays, tracer: Tracer) -> np.ndarray:
    """Smooth the edges: a pixel there becomes the mean of itself and of what two more rays meet.

    The two rays are not shaded: they take the colour of a neighbour that shows the face they meet.
    """
    height, width = keys.shape
    edge = np.zeros((height, width), bool)
    for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        differs = keys[a] != keys[b]
        edge[a] |= differs
        edge[b] |= differs
    y, x = np.nonzero(edge)
    if not len(y):
        return color
    total = color[y, x]
    camera = view.camera
    for dx, dy in _SAMPLES:
        plane = np.stack([(x + dx - camera.cx) / camera.fx, (y + dy - camera.cy) / camera.fy, np.ones(len(x))], 1)
        directions = (plane @ view.rotation.T).astype(np.float32)
        hits = tracer.hits(view.position, directions)
        key = np.full(len(y), -1, np.int32)
        rows = np.flatnonzero(hits.triangle >= 0)
        met = meet(arrays, hits.take(rows), view.position, directions.take(rows, 0), smooth=False)
        key[rows] = _face_keys(arrays, met)
        source = y * width + x
        open_rows = np.ones(len(y), bool)
        for oy, ox in _NEIGHBOURS:
            ny, nx = np.clip(y + oy, 0, height - 1), np.clip(x + ox, 0, width - 1)
            take = open_rows & (keys[ny, nx] == key)
            source = np.where(take, ny * width + nx, source)
            open_rows &= ~take
        total += color.reshape(-1, 3)[source]
    result = color.copy()
    result[y, x] = total / (1 + len(_SAMPLES))
    return result
