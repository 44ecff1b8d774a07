"""The pinhole camera of a photo, from whatever is known of it, and what becomes of it when the photo is changed."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32

from zoedepth.errors import InputError

CameraSource = Literal["given", "exif", "assumed"]
"""given: the user or the data set says it. exif: the photo's own notes say it. assumed: nobody says it."""

_MAX_PIXELS = 1e7  # focal lengths and principal points beyond are nonsense


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


@dataclass(frozen=True)
class Camera:
    """The pinhole camera of one photo at one size, and where it is known from.

    Pixels are counted as OpenCV does: the centre of the top left pixel is at (0, 0). Axes are OpenCV's, too: x to the
    right, y down, z forward.

    Raises:
        InputError: a size below 1, a focal length that is not above 0, or a number that is not finite.
    """

    size: tuple[int, int]
    """(height, width) of the photo, pixels."""
    fx: float
    """Horizontal focal length, pixels."""
    fy: float
    """Vertical focal length, pixels."""
    cx: float
    """Column of the principal point, pixels from the centre of the leftmost column."""
    cy: float
    """Row of the principal point, pixels from the centre of the top row."""
    source: CameraSource = "given"
    """The one who says it: see ``CameraSource``."""

    def __post_init__(self) -> None:
        height, width = self.size
        if height < 1 or width < 1:
            raise InputError(f"the photo of a camera must have at least 1 x 1 pixels, got {width} x {height}")
        for name, value in (("fx", self.fx), ("fy", self.fy)):
            if not 0 < value < _MAX_PIXELS:  # also where it is not a number
                raise InputError(
                    f"the focal length {name} must be above 0 and finite, in pixels; it is {value}. Millimetres do not "
                    "tell it without the size of the sensor"
                )
        for name, value in (("cx", self.cx), ("cy", self.cy)):
            if not -_MAX_PIXELS < value < _MAX_PIXELS:
                raise InputError(f"the principal point {name} must be a finite number of pixels; it is {value}")

    @classmethod
    def of(cls, intrinsics: Intrinsics, size: tuple[int, int], *, source: CameraSource = "given") -> "Camera":
        """Make the camera of a photo of ``size`` (height, width) from its intrinsics."""
        return cls(size, intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy, source)

    @classmethod
    def from_matrix(
        cls, matrix: Float[np.ndarray, "3 3"], size: tuple[int, int], *, source: CameraSource = "given"
    ) -> "Camera":
        """Make a camera from its matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], in pixels.

        Raises:
            InputError: it is no such matrix.
        """
        values = np.asarray(matrix, dtype=np.float64)
        if values.shape != (3, 3):
            raise InputError(f"a camera matrix has 3 x 3 numbers, got an array of shape {values.shape}")
        (fx, skew, cx), (zero, fy, cy), last = values.tolist()
        if skew != 0 or zero != 0 or last != [0, 0, 1]:
            by_columns = skew == zero == cx == cy == 0 and last[2] == 1
            advice = ". It is written by columns: transpose it" if by_columns else ""
            raise InputError(
                f"a camera matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], in pixels; it is {values.tolist()}"
                f"{advice}"
            )
        return cls(size, fx, fy, cx, cy, source)

    @classmethod
    def from_focal(cls, focal_px: float, size: tuple[int, int], *, source: CameraSource = "given") -> "Camera":
        """Make the camera with square pixels that looks through the middle of the photo.

        Args:
            focal_px: focal length in pixels of this photo.
            size: (height, width) of the photo.
            source: the one who says it.
        """
        return cls(size, focal_px, focal_px, (size[1] - 1) / 2, (size[0] - 1) / 2, source)

    @classmethod
    def from_fov(
        cls,
        size: tuple[int, int],
        *,
        horizontal: float | None = None,
        vertical: float | None = None,
        diagonal: float | None = None,
        source: CameraSource = "given",
    ) -> "Camera":
        """Make the camera with square pixels that looks through the middle of the photo, from one field of view.

        Args:
            size: (height, width) of the photo.
            horizontal: degrees from the left to the right border.
            vertical: degrees from the top to the bottom border.
            diagonal: degrees from corner to corner.
            source: the one who says it.

        Raises:
            InputError: none or several of the three are given, or it is not between 0 and 180 degrees, or so close to 0
                that no camera has it.
        """
        sides = {
            "horizontal": (horizontal, size[1]),
            "vertical": (vertical, size[0]),
            "diagonal": (diagonal, math.hypot(*size)),
        }
        given = {name: (degrees, side) for name, (degrees, side) in sides.items() if degrees is not None}
        if len(given) != 1:
            raise InputError(
                f"give one of the horizontal, vertical and diagonal fields of view, got {list(given) or 'none'}"
            )
        (name, (degrees, side)) = next(iter(given.items()))
        if not 0 < degrees < 180:
            raise InputError(f"the {name} field of view must be between 0 and 180 degrees; it is {degrees}")
        half = math.tan(math.radians(degrees) / 2)  # of the side, in focal lengths; 0 for the smallest numbers
        if side / 2 >= _MAX_PIXELS * half:
            raise InputError(f"the {name} field of view must be in degrees; it is {degrees}, which no camera has")
        return cls.from_focal(side / 2 / half, size, source=source)

    @property
    def intrinsics(self) -> Intrinsics:
        """The focal lengths and the principal point alone."""
        return Intrinsics(self.fx, self.fy, self.cx, self.cy)

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """[[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels, float64."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    @property
    def focal_px(self) -> float:
        """One number for both focal lengths, pixels: their geometric mean."""
        return self.fx if self.fx == self.fy else math.sqrt(self.fx * self.fy)

    @property
    def fov_x(self) -> float:
        """Degrees from the left to the right border of the photo."""
        return _angle(self.cx + 0.5, self.fx) + _angle(self.size[1] - self.cx - 0.5, self.fx)

    @property
    def fov_y(self) -> float:
        """Degrees from the top to the bottom border of the photo."""
        return _angle(self.cy + 0.5, self.fy) + _angle(self.size[0] - self.cy - 0.5, self.fy)

    def cropped(self, top: int, left: int, size: tuple[int, int]) -> "Camera":
        """Return the camera of a window of the photo: its first row and column, and its (height, width)."""
        return Camera.of(self.intrinsics.cropped(top, left), size, source=self.source)

    def padded(self, top: int, left: int, size: tuple[int, int]) -> "Camera":
        """Return the camera of a larger picture, of ``size``, in which the photo begins at this row and column."""
        return self.cropped(-top, -left, size)

    def resized(self, size: tuple[int, int]) -> "Camera":
        """Return the camera of the photo resized to ``size`` (height, width)."""
        if size == self.size:
            return self  # the same numbers, to the last bit
        scaled = self.intrinsics.scaled(size[0] / self.size[0], size[1] / self.size[1])
        return Camera.of(scaled, size, source=self.source)

    def mirrored(self) -> "Camera":
        """Return the camera of the photo mirrored left and right."""
        return replace(self, cx=self.size[1] - 1 - self.cx)

    def rotated(self, quarter_turns: int) -> "Camera":
        """Return the camera of the photo turned counterclockwise by this many quarters, as ``np.rot90`` does."""
        camera = self
        for _ in range(quarter_turns % 4):
            height, width = camera.size
            camera = replace(
                camera,
                size=(width, height),
                fx=camera.fy,
                fy=camera.fx,
                cx=camera.cy,
                cy=width - 1 - camera.cx,
            )
        return camera

    def upright(self, orientation: int) -> "Camera":
        """Return the camera of the photo after it is turned by its EXIF orientation, 1 to 8 (EXIF 2.3, tag 0x0112).

        Raises:
            InputError: another number.
        """
        if orientation not in _UPRIGHT:
            raise InputError(f"an EXIF orientation is a number from 1 to 8, got {orientation}")
        mirrored, quarter_turns = _UPRIGHT[orientation]
        return (self.mirrored() if mirrored else self).rotated(quarter_turns)

    def rays(self) -> Float32[np.ndarray, "height width 3"]:
        """Return the point at depth 1 that each pixel sees, in OpenCV's axes."""
        return self.intrinsics.rays(self.size)

    def ray(self, x: float, y: float) -> Float[np.ndarray, " 3"]:
        """Return the point at depth 1 that the pixel at column x and row y sees; fractions of pixels are allowed."""
        return np.array([(x - self.cx) / self.fx, (y - self.cy) / self.fy, 1.0])

    def project(self, points: Float[np.ndarray, "*places 3"]) -> Float[np.ndarray, "*places 2"]:
        """Return column and row, in pixels, of points in OpenCV's axes in front of the camera (z > 0)."""
        x, y, z = np.moveaxis(np.asarray(points), -1, 0)
        return np.stack([x / z * self.fx + self.cx, y / z * self.fy + self.cy], axis=-1)


# EXIF orientation -> (mirror left and right first, then turn counterclockwise by so many quarters).
_UPRIGHT = {
    1: (False, 0),
    2: (True, 0),
    3: (False, 2),
    4: (True, 2),
    5: (True, 1),
    6: (False, 3),
    7: (True, 3),
    8: (False, 1),
}


def depth_of_distance(
    distance: Float32[np.ndarray, "height width"], camera: Intrinsics
) -> Float32[np.ndarray, "height width"]:
    """Return the depth along the optical axis (z), given how far each pixel sees along its ray, both in metres."""
    return (distance / np.linalg.norm(camera.rays(distance.shape), axis=-1)).astype(np.float32)


def _angle(side: float, focal: float) -> float:
    return math.degrees(math.atan2(side, focal))
