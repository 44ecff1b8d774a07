"""Points in space: where the surfaces are that a camera sees at the pixels of a depth map."""

import numpy as np
from jaxtyping import Bool, Float, Float32

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera


def unproject(depth: Float[np.ndarray, "height width"], camera: Camera) -> Float32[np.ndarray, "height width 3"]:
    """Return the point that each pixel sees, in OpenCV's axes: x to the right, y down, z forward, in metres.

    Args:
        depth: metres along the optical axis. Where it is not a finite number above 0, the point is NaN.
        camera: the camera at the size of the depth map.

    Raises:
        InputError: the camera is that of another size.
    """
    check_size(depth, camera)
    known = known_depth(depth)
    z = depth.astype(np.float32)
    if not known.all():
        z = np.where(known, z, np.float32(np.nan))
    columns = ((np.arange(camera.size[1]) - camera.cx) / camera.fx).astype(np.float32)
    rows = ((np.arange(camera.size[0]) - camera.cy) / camera.fy).astype(np.float32)
    points = np.empty((*depth.shape, 3), np.float32)
    np.multiply(z, columns[None], out=points[..., 0])
    np.multiply(z, rows[:, None], out=points[..., 1])
    points[..., 2] = z
    return points


def known_depth(depth: Float[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    """Return True where there is a depth: a finite number above 0."""
    with np.errstate(invalid="ignore"):
        return (depth > 0) & (depth < np.inf)


def check_size(depth: np.ndarray, camera: Camera) -> None:
    """Refuse a camera that is not of the size of the depth map.

    Raises:
        InputError: it is not, or the depth is no (height, width) array.
    """
    if depth.shape != tuple(camera.size):
        raise InputError(
            f"the depth has shape {depth.shape} (height, width) and its camera is of a photo of {tuple(camera.size)}: "
            "give the camera at the size of the depth (Camera.resized)"
        )
