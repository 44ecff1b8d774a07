"""The camera of photos as the command line says it, for all commands that predict photos."""

from collections.abc import Callable, Iterable
from pathlib import Path

from zoedepth.claims import BinaryFile
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.geometry.camera_files import read_cameras
from zoedepth.geometry.choice import CameraChoice
from zoedepth.geometry.lens import Lens, camera_of
from zoedepth.images import read_image

Photo = Path | BinaryFile | Callable[[], Path | BinaryFile]
"""A photo, or a function that opens it when it is needed."""


def chosen_camera(
    photos: Iterable[Photo],
    *,
    camera: str | None,
    fov_x: float | None,
    fov_y: float | None,
    fov_diagonal: float | None,
    focal_px: float | None,
    intrinsics: tuple[float, float, float, float] | None,
) -> CameraChoice:
    """Return the camera that the options say.

    What is in pixels and has no size of its own is of photos of the size of the first that can be read.

    Args:
        photos: the photos, in their order: files, open files, or functions that return one; those that are needed are
            read.
        camera: --camera: "exif", "none" or a file; None is "exif".
        fov_x: --fov-x, degrees.
        fov_y: --fov-y, degrees.
        fov_diagonal: --fov-diagonal, degrees.
        focal_px: --focal-px, pixels.
        intrinsics: --intrinsics, fx, fy, cx and cy in pixels.

    Raises:
        InputError: several of them are given, one has a value that no camera has, or the file cannot be read.
    """
    given = camera_options(camera, fov_x, fov_y, fov_diagonal, focal_px, intrinsics)
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise InputError(f"{' and '.join(names)} each say the camera: give one of them")
    if camera == "none":
        return "none"
    if camera not in (None, "exif"):
        if not Path(camera).is_file():
            raise InputError(f"--camera must be exif, none or a file of a camera; there is no file {camera!r}")
        return read_cameras(Path(camera), _size_of_first(photos))
    if intrinsics is not None:
        return camera_of(Intrinsics(*intrinsics), _size_of_first(photos))
    if focal_px is not None:
        return camera_of(Lens(focal_px=focal_px), _size_of_first(photos))
    if names and camera is None:
        return Lens(fov_x=fov_x, fov_y=fov_y, fov_diagonal=fov_diagonal)
    return "exif"


def camera_options(
    camera: str | None,
    fov_x: float | None,
    fov_y: float | None,
    fov_diagonal: float | None,
    focal_px: float | None,
    intrinsics: tuple[float, float, float, float] | None,
) -> dict[str, object]:
    """Return option → its value, of those that say the camera; None for those that are not given."""
    return {
        "--camera": camera,
        "--fov-x": fov_x,
        "--fov-y": fov_y,
        "--fov-diagonal": fov_diagonal,
        "--focal-px": focal_px,
        "--intrinsics": intrinsics,
    }


def _size_of_first(photos: Iterable[Photo]) -> tuple[int, int]:
    """Return the (height, width) of the first photo that can be read."""
    failures = []
    for photo in photos:
        try:
            height, width, _ = read_image(photo() if callable(photo) else photo, photo=False).shape
        except InputError as error:
            failures.append(error)
        else:
            return height, width
    raise failures[0]
