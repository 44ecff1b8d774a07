"""The points of a photo with their colours and normals, as clouds store them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, UInt8

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.normals import estimate_normals
from zoedepth.geometry.panorama import panorama_normals, panorama_points
from zoedepth.geometry.points import unproject
from zoedepth.outputs.output import Maps, needed

AXES = "metres; x to the right, y down, z forward (as OpenCV has them), seen from the camera at the origin"
"""The unit and the axes of every cloud, for the header of its file."""


class Cloud(NamedTuple):
    """Points in space, in metres and OpenCV's axes: x to the right, y down, z forward."""

    points: Float32[np.ndarray, "points 3"]
    colors: UInt8[np.ndarray, "points 3"] | None = None
    """RGB of each point."""
    normals: Float32[np.ndarray, "points 3"] | None = None
    """Unit vectors towards the camera's side of the surface."""


def cloud_of(maps: Maps) -> Cloud:
    """Return the point of each valid pixel, row by row, with its normal, and its colour where there is a photo.

    Raises:
        InputError: there is no depth or no camera, or no pixel is valid.
    """
    depth, taken = needed(maps, "depth"), needed(maps, "valid")
    camera = None if maps.panorama else needed(maps, "camera")
    if not taken.any():
        raise InputError("no pixel has a depth that makes a point: look at the depth as a preview")
    colors = None if maps.image is None else maps.image[taken]
    used = np.where(taken, depth, np.float32(np.nan))
    if camera is None:
        return Cloud(panorama_points(depth)[taken], colors, panorama_normals(used)[taken])
    return Cloud(unproject(depth, camera)[taken], colors, estimate_normals(used, camera)[taken])


def describe_camera(camera: Camera) -> str:
    """Return the line about the camera for the header of a cloud."""
    height, width = camera.size
    numbers = " ".join(f"{name} {getattr(camera, name):.10g}" for name in ("fx", "fy", "cx", "cy"))
    return f"camera of the photo of {width} x {height} pixels, {camera.source}: {numbers}"


def records(cloud: Cloud, fields: dict[str, str]) -> np.ndarray:
    """Return the points as a table with a row each, of named columns: places, then normals where there are any.

    Args:
        cloud: the points.
        fields: further columns, which the caller fills: name → type of NumPy.
    """
    names = ["x", "y", "z"] + (["nx", "ny", "nz"] if cloud.normals is not None else [])
    table = np.empty(len(cloud.points), [*((name, "<f4") for name in names), *fields.items()])
    for axis, name in enumerate("xyz"):
        table[name] = cloud.points[:, axis]
        if cloud.normals is not None:
            table[f"n{name}"] = cloud.normals[:, axis]
    return table
