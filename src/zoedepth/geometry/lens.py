"""The lens, all that is known of a camera before the size of the photo is; and the camera of a photo from either."""

import math
from dataclasses import dataclass, field, fields

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera, Intrinsics

_FOV = (1.0, 160.0)  # degrees along the longer side: beyond, a number is in another unit
_SAID_FOV = (2.8, _FOV[1])  # degrees that somebody says: all that lenses see is less than 2.8 in radians
_MOST_NAMED = 6


@dataclass(frozen=True)
class Lens:
    """A lens that looks through the middle of every photo: one field of view, or the focal length in pixels.

    A field of view holds whatever size the photo has. ``fov_x`` and ``fov_y`` belong to the sides of the photo as it is
    seen, so that upright and lying photos of one camera differ in them; their ``fov_diagonal`` is the same.

    Raises:
        InputError: none or several of them are given, or one that no lens has.
    """

    fov_x: float | None = None
    """Degrees from the left to the right border."""
    fov_y: float | None = None
    """Degrees from the top to the bottom border."""
    fov_diagonal: float | None = None
    """Degrees from corner to corner."""
    focal_px: float | None = None
    """Focal length in pixels of each photo."""

    def __post_init__(self) -> None:
        given = [field.name for field in fields(self) if getattr(self, field.name) is not None]
        if len(given) != 1:
            names = ", ".join(field.name for field in fields(self))
            raise InputError(f"a lens needs one of {names}, got {', '.join(given) or 'none'}")
        self.camera((1, 1))  # says what is wrong with the number
        degrees = getattr(self, given[0])
        if given[0] != "focal_px" and not _SAID_FOV[0] <= degrees <= _SAID_FOV[1]:
            raise InputError(
                f"{given[0]} is {degrees:g} degrees, and it must be {_SAID_FOV[0]:g} to {_SAID_FOV[1]:g}: radians "
                "times 57.3 are degrees. Of a longer lens say the focal length in pixels"
            )

    def camera(self, size: tuple[int, int]) -> Camera:
        """Return the camera of a photo of ``size`` (height, width), said to be given."""
        if self.focal_px is not None:
            return Camera.from_focal(self.focal_px, size)
        return Camera.from_fov(size, horizontal=self.fov_x, vertical=self.fov_y, diagonal=self.fov_diagonal)


@dataclass(frozen=True)
class Cameras:
    """Several cameras, of which the size of a photo chooses: those of a file of COLMAP, for example."""

    cameras: tuple[Camera, ...]
    objections: tuple[tuple[tuple[int, int], str], ...] = field(default=(), repr=False)
    """Cameras that cannot be used: the size of their photos, and the reason, a sentence for people that names the
    file."""

    def chosen(self, size: tuple[int, int]) -> Camera:
        """Return the camera that took a photo of ``size`` (height, width).

        Raises:
            InputError: there is none for photos of this size, or several, or one that cannot be used.
        """
        if objections := [reason for of, reason in self.objections if of == size]:
            raise InputError(objections[0])
        fitting = {camera for camera in self.cameras if camera.size == size}
        if len(fitting) != 1:
            sizes = ", ".join(sorted({f"{camera.size[1]} x {camera.size[0]}" for camera in self.cameras})[:_MOST_NAMED])
            raise InputError(
                f"of {len(self.cameras)} cameras, for photos of {sizes}, {len(fitting) or 'none'} is for one of "
                f"{size[1]} x {size[0]}: leave only its line in a copy of the file"
            )
        return fitting.pop()


KnownCamera = Camera | Cameras | Intrinsics | Lens
"""All that somebody may know of a camera: the whole of it, for photos of one size; or less, for photos of any."""


def camera_of(known: KnownCamera, size: tuple[int, int]) -> Camera:
    """Return the camera of a photo of ``size`` (height, width).

    Args:
        known: a ``Camera`` of this size is returned as it is, and one of another size is resized where the proportions
            are the same, to a pixel; one that looks through the middle may be turned, too. ``Intrinsics`` are in pixels
            of the photo, and are not changed. A ``Lens`` looks through the middle of the photo. Of ``Cameras`` the size
            of the photo chooses.
        size: (height, width) of the photo.

    Raises:
        InputError: the camera is that of a photo of other proportions, or would see less than 1 or more than 160
            degrees of it; or intrinsics do not look through the middle half of the photo.
    """
    if isinstance(known, Lens):
        return _checked(known.camera(size))
    if isinstance(known, Intrinsics):
        camera = _checked(Camera.of(known, size))
        if off := off_middle(camera):
            raise InputError(
                f"the intrinsics: {off}. Are they of photos of another size, or was this one cropped? Scale them to "
                "the size of this photo, or give the whole camera with the size of its photos: as a file (--camera), "
                "or, from Python, a Camera"
            )
        return camera
    if isinstance(known, Cameras):
        return known.chosen(size)
    if known.size == size:
        return known
    if _same_proportions(known.size, size):
        return known.resized(size)
    height, width = known.size
    turned = known.rotated(1)
    if _same_proportions(turned.size, size) and turned == known.rotated(3):  # whichever way it was turned
        return turned.resized(size)
    claim = f"the camera is of photos of {width} x {height} pixels, and the photo has {size[1]} x {size[0]}"
    if _same_proportions(turned.size, size):
        raise InputError(f"{claim}: one of them is turned. Turn the camera with Camera.rotated, or the photo")
    raise InputError(
        f"{claim}, of other proportions, so it was cropped: give the camera of the cropped photo (Camera.cropped)"
    )


def off_middle(camera: Camera) -> str:
    """Return in words that a camera looks far from the middle of its photo; nothing where it does not.

    Outside of the middle half, numbers are most likely those of a photo of another size, or of one that was cropped.
    """
    height, width = camera.size
    if all(side / 4 <= value + 0.5 <= side * 3 / 4 for value, side in ((camera.cx, width), (camera.cy, height))):
        return ""
    return (
        f"the principal point, ({camera.cx:g}, {camera.cy:g}), is far from the middle of a photo of {width} x {height} "
        "pixels"
    )


def _checked(camera: Camera) -> Camera:
    """Refuse a focal length in another unit than pixels."""
    height, width = camera.size
    side, focal = (width, camera.fx) if width >= height else (height, camera.fy)
    fov = math.degrees(2 * math.atan2(side / 2, focal))
    if not _FOV[0] <= fov <= _FOV[1]:
        raise InputError(
            f"the camera would see {fov:.3g} degrees along the {side} pixels of the photo, which no lens does: is its "
            f"focal length, {focal:.4g}, in pixels, and not in millimetres or in parts of the width?"
        )
    return camera


def _same_proportions(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return True where one size is the other one resized, with its sides rounded to pixels."""
    (height, width), (large_height, large_width) = sorted((one, other))
    return abs(height - large_height * width / large_width) < 1 or abs(width - large_width * height / large_height) < 1
