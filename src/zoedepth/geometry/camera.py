"""The pinhole camera of a photo."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32


@dataclass(frozen=True)
class Intrinsics:
    """Focal lengths and principal point of a pinhole camera, in pixels.

    The centre of the top left pixel is at (0, 0), as in OpenCV: the principal point of a camera that looks through the
    middle of a photo W pixels wide is ``cx = (W - 1) / 2``.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    def cropped(self, top: float, left: float) -> "Intrinsics":
        """Return the camera of the window of the photo that starts at this row and column."""
        return Intrinsics(self.fx, self.fy, self.cx - left, self.cy - top)

    def scaled(self, vertical: float, horizontal: float) -> "Intrinsics":
        """Return the camera of the photo resized by these factors."""
        # Resizing scales the positions of pixel borders, which lie half a pixel from the centres.
        cx, cy = (self.cx + 0.5) * horizontal - 0.5, (self.cy + 0.5) * vertical - 0.5
        return Intrinsics(self.fx * horizontal, self.fy * vertical, cx, cy)

    def mirrored(self, width: int) -> "Intrinsics":
        """Return the camera of the photo, ``width`` pixels wide, after it is mirrored left and right."""
        return Intrinsics(self.fx, self.fy, width - 1 - self.cx, self.cy)

    def rays(self, size: tuple[int, int]) -> Float32[np.ndarray, "height width 3"]:
        """Return the point at depth 1 that each pixel of a photo of ``size`` (height, width) sees: x right, y down."""
        y, x = np.mgrid[: size[0], : size[1]].astype(np.float32)
        return np.stack([(x - self.cx) / self.fx, (y - self.cy) / self.fy, np.ones_like(x)], axis=-1)


def depth_of_distance(
    distance: Float32[np.ndarray, "height width"], camera: Intrinsics
) -> Float32[np.ndarray, "height width"]:
    """Return the depth along the optical axis (z), given how far each pixel sees along its ray, both in metres."""
    return (distance / np.linalg.norm(camera.rays(distance.shape), axis=-1)).astype(np.float32)
