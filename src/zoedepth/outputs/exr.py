"""Metres as the channel Z of an OpenEXR file, with the photo as R, G and B."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float16

from zoedepth.errors import MissingExtraError
from zoedepth.geometry.camera import Camera
from zoedepth.images import OWN_MARK, ImageArray, atomic_path, check_expansion
from zoedepth.outputs.output import Maps, Options, Output, Written, check_map, known_or_zero, needed


def write_exr(
    path: str | Path,
    depth: np.ndarray,
    *,
    image: ImageArray | None = None,
    camera: Camera | None = None,
    panorama: bool = False,
) -> None:
    """Write metres as the float32 channel ``Z`` of an OpenEXR file, losslessly compressed.

    Args:
        path: where to write; missing folders are made.
        depth: (height, width), metres along the optical axis, or of a panorama along the ray. Depth that is not a
            finite number above 0 becomes 0.
        image: the photo, RGB, for the channels ``R``, ``G`` and ``B``: in linear light, as programs expect of OpenEXR,
            so that they show it as it was.
        camera: the camera, for the header. ``intrinsics`` is its 3 x 3 matrix in pixels, and ``cameraSource`` says who
            knows it; the standard's own ``screenWindowWidth`` and ``screenWindowCenter`` say the same of the plane at
            1 m.
        panorama: True for a photo of everything around. The header says so by the standard's own ``envmap``.

    Raises:
        InputError: depth is not two-dimensional.
        MissingExtraError: OpenEXR is not installed.
    """
    depth = known_or_zero(check_map(depth))
    try:
        import OpenEXR
    except ImportError as error:
        raise MissingExtraError("exr", "writing an .exr") from error
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "comments": f"{OWN_MARK}: Z is depth along the {'ray' if panorama else 'optical axis'} in metres, 0 = no depth",
    }
    if panorama:
        header["envmap"] = OpenEXR.ENVMAP_LATLONG
    if camera is not None:
        header |= _camera_attributes(camera)
    channels: dict[str, np.ndarray] = {"Z": depth}
    if image is not None:
        channels["RGB"] = _linear_light()[image]
    with atomic_path(path) as temporary:
        OpenEXR.File(header, channels).write(str(temporary))
        try:
            check_expansion(4 * depth.size * (1 if image is None else 4), temporary.stat().st_size)
        except (
            ValueError
        ):  # nothing but flat areas: readers, ours too, would take it for a file made to fill the memory
            header["compression"] = OpenEXR.NO_COMPRESSION
            OpenEXR.File(header, channels).write(str(temporary))


def _camera_attributes(camera: Camera) -> dict[str, object]:
    """Return what the header says of the camera.

    In the axes of OpenEXR's camera x points to the left and y up ("Technical Introduction", openexr.com). Its screen
    window has square pixels, of the horizontal focal length; where the vertical one differs, ``intrinsics`` has both.
    """
    height, width = camera.size
    right, down = ((width - 1) / 2 - camera.cx) / camera.fx, ((height - 1) / 2 - camera.cy) / camera.fy
    return {
        "intrinsics": camera.matrix,
        "cameraSource": camera.source,
        "screenWindowWidth": float(width / camera.fx),
        "screenWindowCenter": np.array([-right, -down], np.float32),
    }


@cache
def _linear_light() -> Float16[np.ndarray, "256"]:
    """Return the light of each of the 256 levels of a screen, by the curve of sRGB (IEC 61966-2-1)."""
    level = np.arange(256) / 255
    return np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4).astype(np.float16)


def _write(path: Path, maps: Maps, options: Options) -> Written:
    write_exr(path, needed(maps, "depth"), image=maps.image, camera=maps.camera, panorama=maps.panorama)
    return Written()


EXR = Output("_depth.exr", "metres as the channel Z of an OpenEXR, with the photo", _write, suffixes=(".exr",))
