"""Whom to ask for the camera of a photo: the caller, the photo's notes, or nobody."""

from collections.abc import Sequence
from typing import Literal, TypeAlias, cast

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera, Intrinsics
from zoedepth.geometry.lens import Cameras, KnownCamera, Lens, camera_of

CameraChoice: TypeAlias = KnownCamera | Literal["exif", "none"]
"""The camera of a photo: all that somebody knows of it; or "exif", as the photo's own notes tell it; or "none"."""

CameraChoices: TypeAlias = CameraChoice | Sequence[CameraChoice | None] | None
"""One for all photos, or a list with one for each. None leaves it to whoever has a default."""


def check_choice(camera: CameraChoice) -> None:
    """Refuse what is no choice of a camera.

    Raises:
        InputError: it is none.
    """
    if not (
        isinstance(camera, Camera | Cameras | Intrinsics | Lens)
        or (isinstance(camera, str) and camera in ("exif", "none"))
    ):
        raise InputError(
            f"camera must be a Camera, Intrinsics, a Lens, 'exif' or 'none', got {camera!r}. Camera.from_matrix makes "
            "one of a 3 x 3 matrix"
        )


def choice_for_each(cameras: CameraChoices, n_photos: int) -> Sequence[CameraChoice | None]:
    """Return a list with the camera of each photo, given one for all or such a list.

    Raises:
        InputError: the list has another length.
    """
    if isinstance(cameras, str) or not isinstance(cameras, Sequence):
        one = cast("CameraChoice | None", cameras)  # a word is a sequence, too, for type checkers
        return [one for _ in range(n_photos)]
    if len(cameras) != n_photos:
        raise InputError(
            f"there are {n_photos} photos and {len(cameras)} cameras: give a list with one camera for each"
        )
    return cameras


def known_without_notes(choice: CameraChoice, size: tuple[int, int]) -> Camera | None:
    """Return the camera of a photo of ``size`` (height, width) that has no notes; None where nobody knows it.

    Raises:
        InputError: ``choice`` is none, or the camera of a photo of other proportions.
    """
    check_choice(choice)
    return None if isinstance(choice, str) else camera_of(choice, size)
