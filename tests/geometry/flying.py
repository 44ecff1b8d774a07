"""Rendered scenes with the depth that a network would give of them, and which of its points hang in the air."""

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float32

from zoedepth.geometry.camera import Camera
from zoedepth.synthetic.pose import count_parts
from zoedepth.synthetic.render import View
from zoedepth.synthetic.room import build_room
from zoedepth.synthetic.trace import Tracer

RADIUS = 0.05
"""Metres: a point farther from any surface hangs in the air."""
_FACTOR = 4
_DIRECTIONS = 96


class Blurred(NamedTuple):
    """A rendered room and its depth without the detail that networks do not see."""

    camera: Camera
    depth: Float32[np.ndarray, "height width"]
    """Metres, four times reduced and enlarged again."""
    truth: Float32[np.ndarray, "height width"]
    """Metres."""
    flying: Bool[np.ndarray, "height width"]
    """True where the point lies farther than ``RADIUS`` from any surface of the room, hidden ones included."""
    good: Bool[np.ndarray, "height width"]
    """True where the point lies within ``RADIUS`` of what the camera sees. The rest is near a hidden surface only."""


class Room(NamedTuple):
    """A room, seen by a camera."""

    view: View
    tracer: Tracer
    truth: Float32[np.ndarray, "height width"]


def draw_room(seed: int, size: tuple[int, int] = (480, 640)) -> Room:
    """Draw rooms and cameras until one sees enough of a room, with a surface in every pixel."""
    rng = np.random.default_rng((seed, 77))
    while True:
        place = build_room(rng)
        poses = [place.draw_pose(rng) for _ in range(12)]
        arrays = place.scene.arrays(poses[0].position)
        tracer = Tracer(arrays)
        for pose in poses:
            view = pose.view(size)
            if count_parts(view, arrays, tracer, nearest=0.45, middle=1.0) >= 9:
                truth = tracer.hits(view.position, view.rays()).distance.reshape(size)
                if np.isfinite(truth).all():
                    return Room(view, tracer, truth)


def blurred(room: Room, *, reduced_by: str = "area") -> Blurred:
    """Reduce the depth four times, by "area" or taking every fourth pixel ("stride"), and enlarge it bicubically."""
    size = room.view.size
    x = torch.from_numpy(room.truth)[None, None]
    if reduced_by == "area":
        x = F.interpolate(x, size=(size[0] // _FACTOR, size[1] // _FACTOR), mode="area")
    else:
        x = x[..., _FACTOR // 2 :: _FACTOR, _FACTOR // 2 :: _FACTOR]
    depth = F.interpolate(x, size=size, mode="bicubic", align_corners=False)[0, 0].numpy().clip(room.truth.min() / 2)
    camera = Camera.of(room.view.camera, size)
    return Blurred(camera, depth, room.truth, _far_from_all(room, depth), _near_seen(room, depth, camera))


def _far_from_all(room: Room, depth: np.ndarray) -> np.ndarray:
    """Return where no ray of length ``RADIUS`` from the point meets a surface, of many into all directions."""
    rays = room.view.rays()
    points = room.view.position + rays * depth.reshape(-1, 1)
    along_ray = np.abs(depth - room.truth).ravel() * np.linalg.norm(rays, axis=1)
    rows = np.flatnonzero(along_ray > RADIUS)
    for direction in _spread_directions():
        ways = np.broadcast_to(direction * RADIUS, (len(rows), 3)).astype(np.float32)
        near = room.tracer.blocked(points[rows].astype(np.float32), ways, np.ones(len(rows), np.float32))
        rows = rows[~near]
    far = np.zeros(depth.size, bool)
    far[rows] = True
    return far.reshape(depth.shape)


def _near_seen(room: Room, depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Return where the point lies within ``RADIUS`` of a true point of a pixel around."""
    rays = camera.rays()
    points, truth = rays * depth[..., None], rays * room.truth[..., None]
    height, width = depth.shape
    near = np.linalg.norm(points - truth, axis=-1) <= RADIUS
    row, column = np.nonzero(~near)
    for down in range(-12, 13, 2):
        for right in range(-12, 13, 2):
            y, x = np.clip(row + down, 0, height - 1), np.clip(column + right, 0, width - 1)
            found = np.linalg.norm(points[row, column] - truth[y, x], axis=-1) <= RADIUS
            near[row[found], column[found]] = True
            row, column = row[~found], column[~found]
    return near


def _spread_directions() -> np.ndarray:
    """Return unit vectors, evenly spread over the sphere (a spiral of Fibonacci)."""
    number = np.arange(_DIRECTIONS) + 0.5
    polar, around = np.arccos(1 - 2 * number / _DIRECTIONS), np.pi * (1 + 5**0.5) * number
    return np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1)
