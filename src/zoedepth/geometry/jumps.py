"""Jumps of depth: where a camera sees past the border of a thing to what is behind it."""

import numpy as np
from jaxtyping import Bool, Float, Float32

from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import check_size, known_depth

MIN_RATIO = 1.02
"""The ratio of two neighbouring depths below which there is no jump, however flat the surface is seen."""
MAX_SLOPE = 12.0
"""Change in depth over distance across the line of sight, beyond which two neighbours are not of one surface."""


def inverse_depth(depth: Float[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Return 1 / depth, and NaN where there is no depth."""
    known = known_depth(depth)
    return np.divide(1, depth, out=np.full(depth.shape, np.nan, np.float32), where=known, casting="same_kind")


def jumps(
    depth: Float[np.ndarray, "height width"], camera: Camera
) -> tuple[Bool[np.ndarray, "height gaps_across"], Bool[np.ndarray, "gaps_along width"]]:
    """Return where two neighbouring pixels do not see one surface: (those in a row, those in a column).

    That is so where their depths differ by more than ``MIN_RATIO``, the surface between them would be seen flatter than
    ``MAX_SLOPE``, and it is no plane that goes on at either side; or where one has no depth.

    Raises:
        InputError: the camera is that of another size.
    """
    check_size(depth, camera)
    inverse = inverse_depth(depth)
    return _gaps(inverse, camera.fx), _gaps(inverse.T, camera.fy).T


def flying_pixels(depth: Float[np.ndarray, "height width"], camera: Camera) -> Bool[np.ndarray, "height width"]:
    """Return True at pixels that hang in the air between a near surface and a far one, as networks leave at borders.

    Raises:
        InputError: the camera is that of another size.
    """
    across, along = jumps(depth, camera)
    near = np.zeros(depth.shape, bool)
    near[:, 1:] |= across
    near[:, :-1] |= across
    near[1:] |= along
    near[:-1] |= along
    return near & known_depth(depth)


def _gaps(inverse: Float32[np.ndarray, "rows columns"], focal: float) -> Bool[np.ndarray, "rows gaps"]:
    before, after = inverse[:, :-1], inverse[:, 1:]
    step = np.abs(after - before)
    low = np.minimum(before, after)
    with np.errstate(invalid="ignore"):
        flat = (step * focal < MAX_SLOPE * low) | (step < (MIN_RATIO - 1) * low)
    return ~flat
