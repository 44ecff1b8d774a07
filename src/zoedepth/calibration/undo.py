"""Files that were written with a calibration, put back to the metres of the model."""

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from zoedepth.calibration.calibration import Calibration
from zoedepth.config import from_dict
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.images import PNG_MAX, DepthArray, ImageArray, read_image
from zoedepth.outputs import OUTPUTS, Maps, Options
from zoedepth.outputs import sidecar as sidecars
from zoedepth.outputs.ownership import is_own_file
from zoedepth.stored import read_depth, read_npz

_EXACT = ("npz", "npy", "tiff", "pfm", "exr", "depth")
"""Outputs that hold metres, the most exact first: a PNG has millimetres."""
_WITHOUT_PHOTO = {"npz", "npy", "tiff", "pfm", "depth", "color"}
_AGAIN = "Or predict the photo again without --calibration"


def is_calibrated(sidecar: Path) -> bool:
    """Return True if a file is the sidecar of a photo whose depth was calibrated."""
    values = sidecars.read_sidecar(sidecar)
    return values is not None and isinstance(values.get("calibration"), dict)


def undo_files(sidecar: Path) -> list[Path]:
    """Write the files of a photo again, with depth as it was before its calibration: all of them, or none.

    Depth is taken from the most exact of the files, so that a PNG alone loses half a millimetre (see the calibration's
    scale). What is drawn or meshed is made anew with the default options.

    Args:
        sidecar: JSON beside the files, which tells the calibration.

    Returns:
        The files that were replaced, the sidecar last.

    Raises:
        InputError: there is no such sidecar, no file holds the depth, a file is gone or is not from this package, files
            of earlier commands are there, the depth was put back already, or one of the files shows the photo, which is
            gone or another by now.
    """
    values = sidecars.read_sidecar(sidecar)
    if values is None or not isinstance(values.get("calibration"), dict):
        raise InputError(f"{sidecar} is no sidecar of a calibrated photo: give the .json beside its depth, or a folder")
    calibration = Calibration.from_json(values["calibration"], where=f"{sidecar}: calibration")
    files = {name: sidecar.parent / file for name, file in values["files"].items()}
    for name, file in files.items():
        if name not in OUTPUTS or Path(values["files"][name]).name != values["files"][name] or not is_own_file(file):
            raise InputError(f"{file} is gone, or not from zoedepth: put it back. {_AGAIN}")
    earlier = sorted(sidecars.listed(values) - set(values["files"].values()))
    if there := [name for name in earlier if (sidecar.parent / name).exists()]:
        raise InputError(
            f"{sidecar.parent / there[0]} is of an earlier command, and nobody can tell whether with this calibration: "
            f"remove it. {_AGAIN}"
        )
    maps = _maps_before(values, files, calibration)
    scale = values.get("png_scale")
    depth = maps.depth if maps.depth is not None else np.zeros(0)  # these maps have one
    farthest = depth[np.isfinite(depth)].max(initial=0)
    fits = scale is not None and farthest * scale <= PNG_MAX
    options = Options(png_scale=scale if fits else None)  # what is farther than before may not be clipped
    told_end = values.get("max_depth")
    end = calibration.undo(np.array([[told_end]], np.float32)).item() if isinstance(told_end, int | float) else None
    shown = maps.up_to(end)
    with TemporaryDirectory(prefix=".", dir=sidecar.parent) as drafts:
        written = {name: OUTPUTS[name].write(Path(drafts, file.name), shown, options) for name, file in files.items()}
        facts = {key: value for output in written.values() for key, value in output.facts.items()}
        told = sidecars.describe(maps, origin={}, facts=facts, files=values["files"])
        kept = {key: value for key, value in values.items() if key != "calibration"}
        ends = {} if end is None else {"max_depth": end}
        sidecars.write_sidecar(Path(drafts, sidecar.name), {**kept, **told, **ends})
        replaced = [*files.values(), sidecar]
        for file in replaced:
            Path(drafts, file.name).replace(file)
    return replaced


def _maps_before(values: Mapping[str, Any], files: Mapping[str, Path], calibration: Calibration) -> Maps:
    exact = [name for name in _EXACT if name in files]
    if not exact:
        raise InputError(f"none of the files of {values['source']} holds its depth in metres. {_AGAIN}")
    calibrated = read_depth(files[exact[0]])
    _check_calibrated(calibrated, values, files[exact[0]])
    depth = calibration.undo(calibrated)
    camera = values.get("camera")
    return Maps(
        depth=depth,
        std=_std_before(files["npz"], depth, calibration) if "npz" in files else None,
        image=_photo(Path(values["source"]), depth.shape) if set(files) - _WITHOUT_PHOTO else None,
        camera=from_dict(Camera, camera, where="camera") if isinstance(camera, dict) else None,
        depth_range=_range_before(values.get("depth_range"), calibration),
    )


def _check_calibrated(depth: DepthArray, values: Mapping[str, Any], file: Path) -> None:
    """Refuse depth that is not the one that the sidecar tells: a command that was killed has put it back already."""
    told, scale, found = values.get("depth"), values.get("png_scale"), float(np.median(depth))
    median = told.get("median") if isinstance(told, dict) else None
    if not isinstance(median, int | float):
        return
    rounding = 1e-4 + (0.5 / scale if isinstance(scale, int | float) else 0)
    if abs(found - median) > rounding + 1e-3 * median:
        raise InputError(
            f"{file} has a median depth of {found:.4g} m, and its sidecar says {median:.4g} m: it has been put back "
            f"already, or changed. {_AGAIN}"
        )


def _range_before(told: object, calibration: Calibration) -> tuple[float, float]:
    """Return the range of the model's depth; older sidecars tell none, and all depth counts as valid there."""
    if not (isinstance(told, list) and len(told) == 2 and all(isinstance(end, int | float | None) for end in told)):
        return 0.0, np.inf
    near, far = (np.inf if end is None else float(end) for end in told)
    near, far = calibration.undo(np.array([[near, far]], np.float32))[0].tolist()
    return near, far


def _std_before(file: Path, depth: DepthArray, calibration: Calibration) -> DepthArray | None:
    try:
        std = read_npz(file, name="std").astype(np.float32)
    except InputError:  # the model has none
        return None
    slope = calibration.apply_to_std(np.ones_like(depth), depth)
    return np.divide(std, slope, out=np.zeros_like(depth), where=slope > 0)


def _photo(path: Path, size: tuple[int, ...]) -> ImageArray:
    try:
        image = read_image(path)
    except InputError as error:
        raise InputError(f"{error}. Its other files show the photo. {_AGAIN}") from error
    if image.shape[:2] != size:
        raise InputError(f"{path} is of another size than its depth: is it another photo by now? {_AGAIN}")
    return image
