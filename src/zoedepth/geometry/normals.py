"""Normals: which way the surfaces face that a camera sees."""

import numpy as np
from jaxtyping import Bool, Float, Float32

from zoedepth.geometry.camera import Camera
from zoedepth.geometry.jumps import inverse_depth, jumps
from zoedepth.geometry.points import check_size


def estimate_normals(depth: Float[np.ndarray, "height width"], camera: Camera) -> Float32[np.ndarray, "height width 3"]:
    """Return the unit normal of the surface at each pixel, in OpenCV's axes; it faces the camera.

    The inverse depth of a plane is a linear function of the pixel's place, and its slopes are the plane's normal. The
    slopes are taken between neighbours on the same surface: not across jumps. A pixel without such a neighbour faces
    the camera.

    Args:
        depth: metres along the optical axis. Where it is not a finite number above 0, the normal is NaN.
        camera: the camera at the size of the depth map.

    Raises:
        InputError: the camera is that of another size.
    """
    check_size(depth, camera)
    inverse = inverse_depth(depth)
    across, along = jumps(depth, camera)
    slope_x = slope(inverse, ~across) * np.float32(camera.fx)
    slope_y = slope(inverse.T, ~along.T).T * np.float32(camera.fy)
    columns = ((np.arange(camera.size[1]) - camera.cx) / camera.fx).astype(np.float32)
    rows = ((np.arange(camera.size[0]) - camera.cy) / camera.fy).astype(np.float32)
    normals = np.empty((*depth.shape, 3), np.float32)
    np.negative(slope_x, out=normals[..., 0])
    np.negative(slope_y, out=normals[..., 1])
    slope_x *= columns[None]
    slope_y *= rows[:, None]
    slope_x += slope_y
    np.subtract(slope_x, inverse, out=normals[..., 2])
    length = np.sqrt(np.einsum("hwc,hwc->hw", normals, normals))
    normals /= length[..., None]
    return normals


def slope(
    values: Float32[np.ndarray, "rows columns"], same: Bool[np.ndarray, "rows gaps"]
) -> Float32[np.ndarray, "rows columns"]:
    """Return the slope of each row, from the neighbours that are on the same surface; 0 without one."""
    steps = np.diff(values, axis=1)
    steps[~same] = 0
    total = np.zeros_like(values)
    total[:, 1:] += steps
    total[:, :-1] += steps
    count = np.ones(values.shape, np.float32)
    count[:, 1:-1] += same[:, 1:] & same[:, :-1]
    total /= count
    return total
