"""Panoramas of rendered rooms and streets: everything around the camera, with its exact distance."""

import math

import numpy as np
from jaxtyping import Float32, UInt8

from zoedepth.geometry.camera import Camera
from zoedepth.geometry.panorama import View, directions, turn
from zoedepth.synthetic.photo import photograph
from zoedepth.synthetic.render import View as Eye
from zoedepth.synthetic.render import render
from zoedepth.synthetic.room import build_room
from zoedepth.synthetic.street import build_street
from zoedepth.synthetic.trace import Tracer

_FACES = [(0, around) for around in (0, 90, 180, 270)] + [(90, 0), (-90, 0)]  # degrees above the horizon, and around
_FACE_FOV = 92.0  # degrees: a little more than a face takes, so that colours can be interpolated at its border


def make_panorama(
    domain: str, height: int, rng: np.random.Generator
) -> tuple[UInt8[np.ndarray, "height width 3"], Float32[np.ndarray, "height width"]]:
    """Draw a scene from ``rng`` and take a level panorama in it.

    Args:
        domain: "indoor" or "outdoor".
        height: rows of the panorama; it is twice as wide.
        rng: draws everything.

    Returns:
        (the photo, its distances in metres, 0 where there is none).

    Raises:
        MissingExtraError: embreex is not installed.
    """
    place = {"indoor": build_room, "outdoor": build_street}[domain](rng)
    pose = place.draw_pose(rng)._replace(pitch=0.0, roll=0.0)
    arrays = place.scene.arrays(pose.position)
    tracer = Tracer(arrays)
    level = pose.view((2, 2)).rotation
    camera = Camera.from_fov((height, height), horizontal=_FACE_FOV)
    rays = directions((2 * height, 4 * height)).reshape(-1, 3)  # four for each pixel, against jagged edges
    light = np.empty_like(rays)
    faces = [View(camera, turn(math.radians(above), math.radians(around))) for above, around in _FACES]
    nearest = np.stack([rays @ face.rotation[:, 2].astype(np.float32) for face in faces]).argmax(0)
    for number, face in enumerate(faces):
        eye = Eye(pose.view((2, 2)).position, level @ face.rotation.astype(np.float32), camera.intrinsics, camera.size)
        picture = render(place.scene, arrays, tracer, eye, rng).color
        rows = np.flatnonzero(nearest == number)
        column, row = np.rint(camera.project(rays[rows] @ face.rotation)).astype(int).T
        light[rows] = picture[row, column]
    light = light.reshape(height, 2, 2 * height, 2, 3).mean(axis=(1, 3))
    rays = directions((height, 2 * height)).reshape(-1, 3)
    hits = tracer.hits(pose.view((2, 2)).position, rays @ level.T)
    seen = hits.triangle >= 0
    known = np.array([material.known for material in arrays.materials])
    seen[seen] = known[arrays.owner[hits.triangle[seen]]]
    distance = np.where(seen, hits.distance, 0).astype(np.float32)
    return photograph(light, rng), distance.reshape(height, 2 * height)
