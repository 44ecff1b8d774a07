"""The lens, all that is known of a camera before the size of the photo is; and the camera of a photo from either."""

from dataclasses import dataclass, fields

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera, Intrinsics


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

    def camera(self, size: tuple[int, int]) -> Camera:
        """Return the camera of a photo of ``size`` (height, width), said to be given."""
        if self.focal_px is not None:
            return Camera.from_focal(self.focal_px, size)
        return Camera.from_fov(size, horizontal=self.fov_x, vertical=self.fov_y, diagonal=self.fov_diagonal)


KnownCamera = Camera | Intrinsics | Lens
"""All that somebody may know of a camera: the whole of it, for photos of one size; or less, for photos of any."""


def camera_of(known: KnownCamera, size: tuple[int, int]) -> Camera:
    """Return the camera of a photo of ``size`` (height, width).

    Args:
        known: a ``Camera`` of this size is returned as it is, and one of another size is resized where the proportions
            are the same, to a pixel; one that looks through the middle may be turned, too. ``Intrinsics`` are in pixels
            of the photo, and are not changed. A ``Lens`` looks through the middle of the photo.
        size: (height, width) of the photo.

    Raises:
        InputError: the camera is that of a photo of other proportions.
    """
    if isinstance(known, Lens):
        return known.camera(size)
    if isinstance(known, Intrinsics):
        return Camera.of(known, size)
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


def _same_proportions(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return True where one size is the other one resized, with its sides rounded to pixels."""
    (height, width), (large_height, large_width) = sorted((one, other))
    return abs(height - large_height * width / large_width) < 1 or abs(width - large_width * height / large_height) < 1
