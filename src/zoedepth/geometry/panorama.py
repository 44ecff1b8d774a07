"""Panorama: a photo of everything around the camera, 360 x 180 degrees, as views of ordinary cameras and back.

A panorama is equirectangular: its columns are equal steps of longitude, its rows of latitude. The middle looks along z,
a quarter of the width to the right along x, the bottom along y, which is down: OpenCV's axes. Its depth is a
*distance*: the length of the ray, as no axis is special.

Models see views of ordinary cameras, which overlap (``panorama_views``, ``cut_out``). Each view's depth has a scale of
its own; ``merge`` makes the scales agree where views overlap, and blends.
"""

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, Shaped, UInt8
from PIL import Image

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.jumps import find_flying, find_jumps, inverse_depth
from zoedepth.geometry.mesh import Mesh, grid_step, join, reduce_triangles, vertex_normals
from zoedepth.geometry.normals import slope
from zoedepth.geometry.points import known_depth

FOV = 90.0
"""Degrees from left to right that a view sees."""
RINGS = ((0.0, 8), (50.0, 6), (-50.0, 6), (90.0, 1), (-90.0, 1))
"""The views: degrees above the horizon, and how many look there, in equal steps around."""

_MARGIN = (
    24  # columns repeated beyond both borders, where a search for jumps looks at neighbours; more where it is wide
)
_WIDE = 300
_COMPARED = 128  # rows of the panorama at which overlapping views are compared
_FEW = 20  # pixels that two views must share to be compared
_SHARPNESS = 2  # of the borders between views in the blend


class View(NamedTuple):
    """An ordinary camera that looks somewhere in a panorama."""

    camera: Camera
    rotation: Float[np.ndarray, "3 3"]
    """Turns directions of the camera into directions of the panorama."""


class Merged(NamedTuple):
    """The distance all around, and what the views said of it."""

    distance: Float32[np.ndarray, "height width"]
    """Metres along the ray."""
    scales: Float[np.ndarray, " views"]
    """The factor by which the distances of each view were multiplied."""
    disagreement: float
    """Mean difference of two views of one place after that, as a fraction of the distance: 0.1 is 10 %."""


def panorama_views(size: tuple[int, int] = (480, 640)) -> list[View]:
    """Return cameras that see all of a panorama, each place three times on average: see ``RINGS``.

    Args:
        size: (height, width) of each view, 4 : 3 or taller.
    """
    camera = Camera.from_fov(size, horizontal=FOV)
    return [
        View(camera, turn(math.radians(above), 2 * math.pi * number / count))
        for above, count in RINGS
        for number in range(count)
    ]


def cut_out(panorama: UInt8[np.ndarray, "height width 3"], view: View) -> UInt8[np.ndarray, "_ _ 3"]:
    """Return what a view sees of a panorama, interpolated. Reduce a panorama of finer pixels first, with ``resized``.

    Raises:
        InputError: the panorama is not twice as wide as high.
    """
    check_panorama(panorama.shape)
    rays = view.camera.rays() @ view.rotation.T.astype(np.float32)
    row, column = _places(rays, panorama.shape)
    return np.rint(_sample(panorama, row, column)).astype(np.uint8)


def sharp_height(view: View) -> int:
    """Return the height of the panorama whose pixels are as large as those in the middle of a view."""
    return round(math.pi * view.camera.focal_px)


def resized(
    panorama: Shaped[np.ndarray, "height width *channels"], size: tuple[int, int]
) -> Shaped[np.ndarray, "_ _ *channels"]:
    """Return a panorama, a photo or distances, at another (height, width): its left and right border are neighbours.

    Raises:
        InputError: it is not twice as wide as high.
    """
    check_panorama(panorama.shape)
    check_panorama(size)
    height, width = panorama.shape[:2]
    if size == (height, width):
        return panorama
    margin = min(width, math.ceil(3 * max(1, height / size[0])))
    wrapped = Image.fromarray(_wrapped(panorama, margin))
    box = (margin, 0, margin + width, height)
    return np.array(wrapped.resize((size[1], size[0]), Image.Resampling.BILINEAR, box=box))


def merge(depths: Sequence[Float[np.ndarray, "_ _"]], views: Sequence[View], size: tuple[int, int]) -> Merged:
    """Merge the depths of views to one distance all around.

    Each view's distances are multiplied by one factor, so that they agree where views overlap, without going further
    from the view's own metres than needed: least squares of the logarithms. There is an equation for each pair of views
    (their factors make up for the median of the difference), weighted by the pixels that they share, and one for each
    view (its factor is 1), weighted by its pixels. Then the distances are averaged, with weights that fall to zero at
    the border of each view. One more factor gives the average the same mean distance as the views have without theirs.

    Args:
        depths: metres along the optical axis of each view, finite and above 0.
        views: their cameras.
        size: (height, width) of the result.

    Raises:
        InputError: the views leave a part unseen, a depth is not of the size of its view or not above 0 everywhere, or
            the size is not that of a panorama.
    """
    check_panorama(size)
    logs = [_log_distance(depth, view) for depth, view in zip(depths, views, strict=True)]
    shifts, disagreement = _agreement(logs, views, min(_COMPARED, size[0]))
    total, raw, weights = (np.zeros(size[0] * size[1], np.float32) for _ in range(3))
    for log, view, shift in zip(logs, views, shifts, strict=True):
        place, values, weight = spread(log, view, size)
        weighted = weight * np.exp(values)
        weights[place] += weight
        raw[place] += weighted
        total[place] += weighted * np.float32(math.exp(shift))
    if not (weights > 0).all():
        raise InputError("the views of a panorama must see all of it: use those of panorama_views")
    area = np.repeat(np.cos(_angles(*size)[1]), size[1])
    factor = float((raw / weights * area).sum() / (total / weights * area).sum())
    distance = (total / weights).reshape(size) * np.float32(factor)
    return Merged(distance, np.exp(shifts) * factor, disagreement)


def spread(
    values: Float32[np.ndarray, "_ _"], view: View, size: tuple[int, int]
) -> tuple[np.ndarray, Float32[np.ndarray, " places"], Float32[np.ndarray, " places"]]:
    """Return where in a panorama of ``size`` a view lies: (numbers of the pixels, row by row, its values, weights).

    The values are interpolated. The weights are 1 in the middle of the view and fall to 0 at its border.
    """
    longitude, latitude = _angles(*size)
    camera, ahead = view.camera, view.rotation[:, 2]
    corner = camera.ray(-0.5, -0.5)
    reach = math.acos(1 / float(np.linalg.norm(corner)))
    above = math.asin(max(-1.0, min(1.0, -float(ahead[1]))))
    rows = np.flatnonzero(np.abs(latitude - above) <= reach)
    rays = _unit(longitude[None], latitude[rows, None]).reshape(-1, 3)
    place = np.flatnonzero(rays @ ahead.astype(np.float32) > math.cos(reach))
    x, y = np.moveaxis(camera.project(rays[place] @ view.rotation.astype(np.float32)), -1, 0)
    height, width = camera.size
    across, along = (x + 0.5) * (2 / width) - 1, (y + 0.5) * (2 / height) - 1
    inside = (np.abs(across) < 1) & (np.abs(along) < 1)
    place, x, y, across, along = place[inside], x[inside], y[inside], across[inside], along[inside]
    weight = ((1 - across**2) * (1 - along**2)) ** _SHARPNESS
    column, row = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, top = np.minimum(column.astype(np.int32), width - 2), np.minimum(row.astype(np.int32), height - 2)
    right, down = column - left, row - top
    upper = values[top, left] * (1 - right) + values[top, left + 1] * right
    lower = values[top + 1, left] * (1 - right) + values[top + 1, left + 1] * right
    return place + rows[0] * size[1], upper * (1 - down) + lower * down, weight


def directions(size: tuple[int, int]) -> Float32[np.ndarray, "height width 3"]:
    """Return the unit vector along which each pixel of a panorama of ``size`` (height, width) looks."""
    longitude, latitude = _angles(*size)
    return _unit(longitude[None], latitude[:, None])


def panorama_points(distance: Float[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width 3"]:
    """Return the point that each pixel of a panorama sees, in OpenCV's axes, metres; NaN where there is no distance.

    Raises:
        InputError: the panorama is not twice as wide as high.
    """
    check_panorama(distance.shape)
    known = np.where(known_depth(distance), distance, np.nan).astype(np.float32)
    return directions((distance.shape[0], distance.shape[1])) * known[..., None]


def panorama_normals(distance: Float[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width 3"]:
    """Return the unit normal of the surface at each pixel of a panorama, see ``normals.estimate_normals``.

    Raises:
        InputError: the panorama is not twice as wide as high.
    """
    check_panorama(distance.shape)
    height, width = distance.shape
    closed = _wrapped(distance, 1)
    inverse = inverse_depth(closed)
    across, along = _jumps_around(distance)
    focal_across, focal_along = _focals(height, width)
    # Of a plane, the inverse distance is a linear function of the ray, whose gradient is the normal.
    to_right = (slope(inverse, ~across) * focal_across.astype(np.float32))[:, 1:-1, None]
    downwards = (slope(inverse.T, ~along.T).T * np.float32(focal_along))[:, 1:-1, None]
    longitude, latitude = _angles(height, width)
    right = _unit(longitude[None] + math.pi / 2, np.zeros((1, 1)))
    below = _unit(longitude[None], latitude[:, None] - math.pi / 2)
    normals = -(inverse[:, 1:-1, None] * directions((height, width)) + to_right * right + downwards * below)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def flying_in_panorama(distance: Float[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    """Return the pixels of a panorama that hang in the air, see ``jumps.flying_pixels``.

    Raises:
        InputError: the panorama is not twice as wide as high.
    """
    check_panorama(distance.shape)
    height, width = distance.shape
    margin = min(width, _MARGIN * max(1, width // _WIDE))
    return find_flying(_wrapped(distance, margin), *_focals(height, width))[:, margin : margin + width]


def build_panorama_mesh(
    distance: Float[np.ndarray, "height width"],
    *,
    valid: Bool[np.ndarray, "height width"] | None = None,
    max_triangles: int | None = None,
) -> Mesh:
    """Join neighbouring pixels of a panorama to triangles all around, but not across jumps of the distance.

    The left border is joined with the right one, and the top and the bottom row are closed at their poles: there is no
    seam. A corner at the border of the photo has two places in it, and is listed twice; there, ``uv`` goes on beyond 1,
    for a texture that repeats.

    Args:
        distance: metres along the ray; a pixel without a finite number above 0 is left out.
        valid: pixels to take; None takes all that are no flying pixels.
        max_triangles: the most triangles; None keeps all, one or two for each pixel.

    Raises:
        InputError: the panorama is not twice as wide as high, ``valid`` is of another size, or ``max_triangles`` is
            below 1.
        MissingExtraError: ``max_triangles`` is given, and fast-simplification is not installed.
    """
    check_panorama(distance.shape)
    if valid is None:
        valid = ~flying_in_panorama(distance)
    if valid.shape != distance.shape:
        raise InputError(f"valid has shape {valid.shape} and the distance {distance.shape}: give them the same size")
    longitude, latitude = _angles(*distance.shape)
    step = grid_step(distance.shape, max_triangles)
    some = np.s_[step // 2 :: step]
    distance, valid, longitude, latitude = distance[some, some], valid[some, some], longitude[some], latitude[some]
    taken = valid & known_depth(distance)
    faces = _faces_around(np.where(taken, distance, np.nan), taken)
    points = _unit(longitude[None], latitude[:, None]) * np.where(taken, distance, 1)[..., None]
    poles = [
        (0, sign * float(np.median(distance[row][taken[row]])) if taken[row].any() else sign, 0)
        for row, sign in ((0, -1), (-1, 1))
    ]
    vertices = np.concatenate([points.reshape(-1, 3), np.array(poles, np.float32)]).astype(np.float32)
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    vertices, faces = vertices[used], (np.cumsum(used, dtype=np.int32) - 1)[faces]
    if max_triangles is not None:
        vertices, faces = reduce_triangles(vertices, faces, max_triangles)
    return _textured(vertices, faces)


def turn(above: float, around: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation of a camera that looks so far above the horizon and around to the right, radians."""
    ahead = np.array([
        math.cos(above) * math.sin(around), -math.sin(above), math.cos(above) * math.cos(around)
    ])  # fmt: skip
    right = np.array([math.cos(around), 0.0, -math.sin(around)])
    return np.stack([right, np.cross(ahead, right), ahead], axis=1)


def check_panorama(size: tuple[int, ...]) -> None:
    """Refuse a size that is not that of a panorama.

    Raises:
        InputError: it is not twice as wide as high, to two pixels.
    """
    height, width = size[:2]
    if height < 2 or abs(width - 2 * height) > 2:
        raise InputError(
            f"a panorama of 360 x 180 degrees is twice as wide as high, and this has {width} x {height} pixels. Put a "
            "part of one into its place in a picture of the whole first"
        )


def _angles(height: int, width: int) -> tuple[Float[np.ndarray, " width"], Float[np.ndarray, " height"]]:
    """Return the longitude of each column, to the right, and the latitude of each row, upwards; radians."""
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 2 * math.pi
    latitude = (0.5 - (np.arange(height) + 0.5) / height) * math.pi
    return longitude, latitude


def _unit(longitude: Float[np.ndarray, "..."], latitude: Float[np.ndarray, "..."]) -> Float32[np.ndarray, "..."]:
    level = np.cos(latitude)
    vector = np.broadcast_arrays(level * np.sin(longitude), -np.sin(latitude), level * np.cos(longitude))
    return np.stack(vector, axis=-1).astype(np.float32)


def _places(
    rays: Float32[np.ndarray, "*places 3"], size: tuple[int, ...]
) -> tuple[Float32[np.ndarray, "*places"], Float32[np.ndarray, "*places"]]:
    """Return (row, column) of a panorama at which rays of any length meet it."""
    x, y, z = np.moveaxis(rays, -1, 0)
    longitude, latitude = np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z))
    return (0.5 - latitude / math.pi) * size[0] - 0.5, (longitude / (2 * math.pi) + 0.5) * size[1] - 0.5


def _sample(
    panorama: UInt8[np.ndarray, "height width 3"], row: Float32[np.ndarray, "*places"], column: np.ndarray
) -> Float32[np.ndarray, "*places 3"]:
    """Return the colours between pixels, interpolated. Behind a pole, the columns opposite go on."""
    height, width = panorama.shape[:2]
    top, bottom = (np.roll(panorama[[edge]], width // 2, axis=1) for edge in (0, -1))
    colors = np.concatenate([top, panorama, bottom]).reshape(-1, 3)
    y, x = np.floor(row).astype(np.int32), np.floor(column).astype(np.int32)
    down, right = (row - y)[..., None].astype(np.float32), (column - x)[..., None].astype(np.float32)
    upper, lower = (np.clip(y + under, 0, height + 1) * width for under in (1, 2))
    left, after = x % width, (x + 1) % width

    def along(start: np.ndarray) -> np.ndarray:
        first = colors.take(start + left, axis=0).astype(np.float32)
        return first + (colors.take(start + after, axis=0) - first) * right

    above = along(upper)
    return above + (along(lower) - above) * down


def _log_distance(depth: Float[np.ndarray, "_ _"], view: View) -> Float32[np.ndarray, "_ _"]:
    if depth.shape != tuple(view.camera.size):
        raise InputError(f"the depth of a view has shape {depth.shape}, and the view {tuple(view.camera.size)}")
    if not known_depth(depth).all():
        raise InputError("the depth of a view must be finite and above 0 everywhere")
    return np.log(depth * np.linalg.norm(view.camera.rays(), axis=-1)).astype(np.float32)


def _agreement(
    logs: list[Float32[np.ndarray, "_ _"]], views: Sequence[View], height: int
) -> tuple[Float[np.ndarray, " views"], float]:
    """Return what is to be added to the logarithm of each view so that they agree, and how far they do not then."""
    n = len(views)
    seen = np.full((n, height * 2 * height), np.nan, np.float32)
    for row, log, view in zip(seen, logs, views, strict=True):
        place, values, _ = spread(log, view, (height, 2 * height))
        row[place] = values
    area = np.repeat(np.cos(_angles(height, 2 * height)[1]), 2 * height)  # of a pixel: small at the poles
    own = np.sqrt([area[~np.isnan(row)].sum() for row in seen])
    equations, differences, pairs = list(np.diag(own)), [0.0] * n, []
    for one, other in combinations(range(n), 2):
        both = np.flatnonzero(~np.isnan(seen[one]) & ~np.isnan(seen[other]))
        if len(both) < _FEW:
            continue
        weight = math.sqrt(area[both].sum())
        equation = np.zeros(n)
        equation[one], equation[other] = weight, -weight
        equations.append(equation)
        differences.append(-weight * float(np.median(seen[one, both] - seen[other, both])))
        pairs.append((one, other, both))
    shifts = np.linalg.lstsq(np.array(equations), np.array(differences), rcond=None)[0]
    seen += shifts[:, None].astype(np.float32)
    total = sum(float((area[both] * np.abs(seen[one, both] - seen[other, both])).sum()) for one, other, both in pairs)
    shared = sum(float(area[both].sum()) for _, _, both in pairs)
    return shifts, total / shared if shared else 0.0


def _wrapped(
    panorama: Shaped[np.ndarray, "height width *channels"], margin: int
) -> Shaped[np.ndarray, "height _ *channels"]:
    """Return a panorama with its last columns repeated before the first, and its first behind the last."""
    return np.concatenate([panorama[:, panorama.shape[1] - margin :], panorama, panorama[:, :margin]], axis=1)


def _focals(height: int, width: int) -> tuple[Float[np.ndarray, "height 1"], float]:
    """Return how many pixels of each row, and of a column, a radian takes."""
    return width / (2 * math.pi) / np.cos(_angles(height, width)[1])[:, None], height / math.pi


def _jumps_around(
    distance: Float[np.ndarray, "height width"],
) -> tuple[Bool[np.ndarray, "height gaps_across"], Bool[np.ndarray, "gaps_along columns"]]:
    """Return the jumps of a panorama with its last column before the first, and its first one behind the last."""
    height, width = distance.shape
    margin = min(_MARGIN, width)
    across, along = find_jumps(_wrapped(distance, margin), *_focals(height, width))
    return across[:, margin - 1 : margin + width], along[:, margin - 1 : margin + width + 1]


def _faces_around(
    distance: Float[np.ndarray, "height width"], taken: Bool[np.ndarray, "height width"]
) -> Int32[np.ndarray, "faces 3"]:
    """Return the triangles between pixels, counted row by row; behind them are the numbers of the upper and lower pole.

    They are counterclockwise as seen from the middle.
    """
    height, width = distance.shape
    across, along = _jumps_around(distance)
    across, along = across[:, 1:], along[:, 1:]
    faces = join(_wrapped(distance, 1)[:, 1:], _wrapped(taken, 1)[:, 1:], across, along)
    faces = faces // (width + 1) * width + faces % (width + 1) % width
    fans = []
    for row, pole in ((0, height * width), (height - 1, height * width + 1)):
        first = np.flatnonzero(~across[row])
        one, other = row * width + first, row * width + (first + 1) % width
        top = np.full(len(first), pole)
        fans.append(np.stack([top, one, other] if row == 0 else [one, top, other], axis=1))
    return np.concatenate([faces, *fans]).astype(np.int32)


def _textured(vertices: Float32[np.ndarray, "vertices 3"], faces: Int32[np.ndarray, "faces 3"]) -> Mesh:
    """Return a mesh with the places of its corners in the photo, those at the photo's border twice."""
    normals = vertex_normals(vertices, faces)
    row, column = _places(vertices, (1, 1))
    u, v = column + 0.5, row + 0.5
    corners = u[faces]
    beyond = (corners.max(axis=1, keepdims=True) - corners > 0.5).astype(np.int32)  # they are right of the border, too
    pole = np.hypot(vertices[:, 0], vertices[:, 2]) < 1e-6 * np.abs(vertices[:, 1])  # has no longitude of its own
    key = faces + len(vertices) * beyond
    at_pole, corner = np.nonzero(pole[faces])
    key[at_pole, corner] = 2 * len(vertices) + np.arange(len(at_pole))
    kept, numbers = np.unique(key, return_inverse=True)
    source = np.where(kept < 2 * len(vertices), kept % len(vertices), 0)
    place = u[source] + (kept // len(vertices) == 1)
    if len(at_pole):
        own = kept >= 2 * len(vertices)
        source[own] = faces[at_pole, corner]
        others = np.where(np.arange(3) == corner[:, None], 0, (corners + beyond)[at_pole])
        place[own] = others.sum(axis=1) / 2
    return Mesh(
        vertices=vertices[source],
        faces=numbers.reshape(faces.shape).astype(np.int32),
        uv=np.stack([place, v[source]], axis=1).astype(np.float32),
        normals=normals[source],
        camera=None,
    )
