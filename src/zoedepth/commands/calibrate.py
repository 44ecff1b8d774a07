"""``zoedepth calibrate``: put the metres of a photo, and of its camera, right by some readings; or take that back."""

import math
import os
import shlex
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Table

from zoedepth.commands.options import words_of
from zoedepth.errors import InputError
from zoedepth.folders import check_writable
from zoedepth.lock import only_one
from zoedepth.stored import read_stored, readable, to_json, to_metres

if TYPE_CHECKING:
    from zoedepth.calibration import Calibration, Distance, Point, Reading
    from zoedepth.images import DepthArray

EXIT_FAILED = 1
_WAIT_S = 60.0  # for another command that adds to the same file, which takes milliseconds

_ENOUGH = 3  # photos, to tell the scale of a camera
_SHOWN = 20  # readings, at most
_UNITS = {"centimetres": 100.0, "millimetres": 1000.0, "feet": 3.2808, "inches": 39.37}
_NEAR = 0.2  # relative difference up to which a factor is taken for that of a unit
_FAR_OFF = 3.0  # factor from which on the user is asked whether the readings are in metres


def calibrate(
    photo: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="PHOTO")],
    *,
    at: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X,Y=METRES")] = (),
    between: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X,Y,X,Y=METRES")] = (),
    depth: Path | None = None,
    depth_scale: float | None = None,
    along_ray: bool = False,
    form: Literal["scale", "scale-shift"] = "scale",
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    add: bool = False,
    undo: bool = False,
    model: str = "zoed-lite",
    flip: bool = True,
    pad: Literal["model", "yes", "no"] = "model",
    domain: str | None = None,
    camera: Annotated[str | None, tyro.conf.arg(metavar="exif|none|FILE")] = None,
    fov_x: float | None = None,
    fov_y: float | None = None,
    fov_diagonal: float | None = None,
    focal_px: float | None = None,
    intrinsics: Annotated[tuple[float, float, float, float] | None, tyro.conf.arg(metavar="FX FY CX CY")] = None,
    focal_correction: Literal["model", "yes", "no"] = "model",
    compat: tuple[str, ...] = (),
    device: str = "auto",
    precision: Literal["float32", "bfloat16", "float16"] = "float32",
    json_: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Put the metres of a photo right by what was measured in it, and keep that for all photos of its camera.

    Give --at or --between again for every reading; three are much better than one. Without a reading, places are
    proposed that are good to measure. Each reading is printed beside the depth before and after, and those that do not
    fit are named and left out. `zoedepth predict --calibration FILE` applies what --out has kept.

    Args:
        photo: the photo. With --undo: a folder that `zoedepth predict --calibration` wrote, or the .json of one photo.
        at: column and row of a pixel, and the metres measured there: 320,240=2.35. The top left pixel is 0,0.
        between: two pixels, and the metres between the things that they see: 10,20,300,20=1.2. It needs a known camera:
            as wrong as its field of view is, as wrong is the scale.
        depth: a sparse depth map, e.g. of a lidar; 0 where nothing was measured. It has the photo's size, or is smaller
            by one factor both ways.
        depth_scale: stored value of one metre in it, 1000 for millimetres or 256 for KITTI's, where it does not say so.
        along_ray: readings of --at and --depth are from the lens to the thing, as a tape measure or a laser gives them,
            and not along the optical axis. In the middle of a photo it is the same. It needs a known camera, too.
        form: scale-shift also fits a power of the depth, where readings that are left out say that this predicts them
            better.
        out: file to keep the calibration in.
        add: keep the readings of other photos that --out has, and take all of them together. Three readings in each of
            five photos tell more of a camera than fifteen in one.
        undo: take the calibration out of files that were written with one.
        model: a name of `zoedepth models`, a file or folder of weights, a Hugging Face id, or a file of
            `zoedepth export`.
        flip: see `zoedepth predict`, as for the options that follow: give those that you will predict with.
        pad: see `zoedepth predict`.
        domain: scene type whose head to use, e.g. indoor; without it the model's router decides.
        camera: exif, the default, reads the camera from the photo's notes. none assumes it. FILE is a camera.
        fov_x: field of view, degrees from the left to the right border.
        fov_y: field of view, degrees from the top to the bottom border.
        fov_diagonal: field of view, degrees from corner to corner.
        focal_px: focal length in pixels.
        intrinsics: focal lengths and principal point in pixels.
        focal_correction: multiply depth by the photo's focal length over that of the training photos, before it is
            calibrated. "model" does so where the model was trained in one canonical camera, and where the camera is
            given by an option.
        compat: behaviours of the original code to take over: batch-vote, 10m, squeeze; 80m for KITTI's
            checkpoints of baselines.
        device: cpu, cuda, mps, or auto for the best there is; zoed-lite runs on the CPU where no driver of an
            accelerator is found.
        precision: bfloat16 is faster on hardware made for it; float16 is for GPUs.
        json_: print one JSON object, the calibration, and nothing else.
    """
    if undo:
        if at or between or depth or out or add:
            raise InputError(
                "--undo takes a calibration out of files: leave out --at, --between, --depth, --out and --add"
            )
        return _undo(photo)
    readings = [*(_point(text) for text in at), *(_distance(text) for text in between)]
    if depth is not None and readings:
        raise InputError("give readings (--at, --between) or a sparse depth map (--depth), not both")
    if depth is None and depth_scale is not None:
        raise InputError("--depth-scale is for --depth: leave it out")
    if depth_scale is not None and not depth_scale >= 1:
        raise InputError(
            f"--depth-scale is the stored value of one metre, got {depth_scale:g}: 1000 for millimetres, also where a "
            "sensor says 0.001 metres a unit"
        )
    if add and out is None:
        raise InputError("--add adds to the readings that a file has: name it by --out")
    sparse = None if depth is None else _read_sparse(depth, photo, scale=depth_scale)

    from zoedepth.calibration import check_replaceable, places_to_measure, read_calibration, write_calibration
    from zoedepth.commands.cameras import camera_options, chosen_camera
    from zoedepth.commands.progress import download_progress
    from zoedepth.predict import Predictor
    from zoedepth.weights.load import load_for_prediction, pinned, weights_of

    earlier = None
    if out is not None:
        check_replaceable(out)
        check_writable(out.parent, option="--out")
        earlier = read_calibration(out) if add else None
    known_camera = chosen_camera(
        [photo],
        camera=camera,
        fov_x=fov_x,
        fov_y=fov_y,
        fov_diagonal=fov_diagonal,
        focal_px=focal_px,
        intrinsics=intrinsics,
    )
    place = pinned(model)
    with download_progress() as progress:
        network = load_for_prediction(place, device=device, compat=compat, precision=precision, progress=progress)
    if not network.config.domains:
        raise InputError(f"{model} gives relative depth, which has no metres to calibrate: choose a model of metres")
    predictor = Predictor(
        network,
        flip_average=flip,
        pad=None if pad == "model" else pad == "yes",
        device=device,
        precision=precision,
        camera=known_camera,
        focal_correction=None if focal_correction == "model" else focal_correction == "yes",
    )
    weights = weights_of(place, compat=compat, pad=predictor.pad)
    result = predictor(photo, domain=domain)
    if not readings and sparse is None:
        places = places_to_measure(result.depth, result.valid)
        proposed = ", ".join(f"{x},{y} ({result.depth[y, x]:.2f} m by the model)" for x, y in places)
        raise InputError(f"give what was measured: --at X,Y=METRES. Good places in this photo are {proposed}")
    name = readable(os.path.abspath(photo))
    with ExitStack() as stack:
        if out is not None and earlier is not None:
            # Another command may have added readings while this one predicted.
            work, advice = f"adds readings to {out}", "type this again when it is done"
            stack.enter_context(only_one(out, work=work, advice=advice, wait_s=_WAIT_S))
            earlier = read_calibration(out)
            if reasons := result.mismatches(earlier, network=model, weights=weights):
                raise InputError(
                    f"the readings in {out} cannot be taken together with those of {photo}: {'; '.join(reasons)}"
                )
        if earlier is not None and any(reading.photo == name for reading in earlier.readings):
            Console(stderr=True, highlight=False).print(
                f"note: the readings of {photo} that {out} had are replaced", soft_wrap=True, markup=False
            )
        found = result.find_calibration(
            readings if sparse is None else sparse, along_ray=along_ray, form=form, photo=name, earlier=earlier
        )
        found = replace(found, network=model, weights=weights)
        if out is not None:
            write_calibration(out, found)
    if json_:
        print(to_json(found.to_json()))
        console = Console(stderr=True, highlight=False)
        for doubt in _doubts(found):
            console.print(doubt, soft_wrap=True, markup=False)
    else:
        same = {
            "--model": None if model == "zoed-lite" else model,
            "--no-flip": not flip,
            "--pad": None if pad == "model" else pad,
            "--domain": domain,
            **camera_options(camera, fov_x, fov_y, fov_diagonal, focal_px, intrinsics),
            "--focal-correction": None if focal_correction == "model" else focal_correction,
            "--compat": compat,
            "--precision": None if precision == "float32" else precision,
        }
        _show(found, photo, form=form, out=out, same=words_of(same))
    return 0


def _read_sparse(path: Path, photo: Path, *, scale: float | None) -> "DepthArray":
    """Read a sparse depth map, metres, and put its values where they lie in the photo; 0 where nothing was measured."""
    from zoedepth.data.fit import check_lies_alike, spread
    from zoedepth.images import read_image_with_orientation

    image, orientation = read_image_with_orientation(photo)
    size, stored = image.shape[:2], read_stored(path)
    check_lies_alike(size, stored, names=(photo, path), orientation=orientation)
    return spread(to_metres(stored, path, scale=scale), size)


def _point(text: str) -> "Point":
    x, y, metres = _numbers(text, 2, "--at X,Y=METRES, as in --at 320,240=2.35")
    return x, y, metres


def _distance(text: str) -> "Distance":
    x, y, other_x, other_y, metres = _numbers(text, 4, "--between X,Y,X,Y=METRES, as in --between 10,20,300,20=1.2")
    return (x, y), (other_x, other_y), metres


def _numbers(text: str, n_pixels: int, usage: str) -> list[float]:
    pixels, equals, metres = text.partition("=")
    try:
        numbers = [float(word) for word in [*pixels.split(","), metres]]
    except ValueError:
        numbers = []
    if not equals or len(numbers) != n_pixels + 1:
        raise InputError(f"{text!r} is no reading: give {usage}")
    return numbers


def _show(found: "Calibration", photo: Path, *, form: str, out: Path | None, same: list[str]) -> None:
    """Print the readings, how they changed, and how far the calibrated depth can be believed.

    ``same`` are the options that other photos have to be predicted with, too.
    """
    console = Console(highlight=False)
    shown = sorted(found.readings, key=lambda reading: -abs(math.log(reading.after / reading.metres)))[:_SHOWN]
    shown = [reading for reading in found.readings if reading in shown]
    among = "" if found.n_photos == 1 else f" in {found.n_photos} photos"
    table = Table(title=f"{photo.name}: {_readings(found.n_readings)}{among}", title_justify="left")
    for heading in ("at", "measured", "before", "after", "residual", ""):
        table.add_column(heading, justify="left" if heading in ("at", "") else "right")
    for reading in shown:
        metres = (f"{value:.2f} m" for value in (reading.metres, reading.before, reading.after))
        place = reading.place if found.n_photos == 1 else f"{Path(reading.photo).name} {reading.place}"
        table.add_row(place, *metres, f"{reading.residual:+.1%}", _remark(reading))
    console.print(table)
    for line in _told(found, n_shown=len(shown), form=form, out=out, same=same):
        console.print(line, soft_wrap=True, markup=False)


def _told(found: "Calibration", *, n_shown: int, form: str, out: Path | None, same: list[str]) -> Iterator[str]:
    """Yield what there is to say about a calibration, a line each."""
    if n_shown < found.n_readings:
        yield f"These are the {n_shown} worst of {found.n_readings}; {len(found.outliers)} do not fit the others."
    if found.power == 1:
        yield f"Scale: {found.scale:.3f}"
        if form == "scale-shift":
            yield "No power: of readings that are left out, it does not predict more than the scale does."
    else:
        yield f"Calibrated depth: {found.scale:.3f} * depth ** {found.power:.3f}"
    yield f"The readings are off by {found.error_before:.1%} before, and {found.error_after:.1%} after (median)."
    if found.n_photos == 1:
        yield (
            f"Expected error, in four of five cases: {found.expected_error:.0%} at a pixel of this photo, "
            f"{found.scale_error:.0%} of the scale."
        )
    yield f"In other photos of this camera, in four of five cases: {found.error_elsewhere:.0%} at a pixel."
    yield from _doubts(found)
    if out is not None:
        if found.n_photos < _ENOUGH:
            more = shlex.join(["--out", str(out), "--add", *same])
            yield f"For other photos, add readings of some: zoedepth calibrate ANOTHER --at X,Y=METRES {more}"
        kept = shlex.join(["--calibration", str(out), *same])
        yield f"Kept in {out}. To use it: zoedepth predict PHOTOS --out FOLDER {kept}"


def _doubts(found: "Calibration") -> Iterator[str]:
    """Yield what speaks against using a calibration, a line each."""
    factor = found.scale * found.middle ** (found.power - 1)
    if abs(math.log(factor)) <= math.log1p(found.scale_error):
        yield "The metres as they are do not contradict the readings: there may be no need of a calibration."
    if not 1 / _FAR_OFF < factor < _FAR_OFF:
        yield f"All depths change by a factor of {factor:.2f}: are the readings in metres?"


def _remark(reading: "Reading") -> str:
    """Return what is worth saying about a reading, or nothing."""
    remarks = []
    if reading.outlier:
        factor = reading.metres / reading.after
        unit = next((name for name, size in _UNITS.items() if abs(math.log(factor / size)) < _NEAR), None)
        remarks.append("left out: does not fit the others" + (f"; in {unit} it would" if unit else ""))
    if reading.at_jump:
        remarks.append("near and far meet here: measure on a surface")
    return "; ".join(remarks)


def _undo(place: Path) -> int:
    """Take the calibration out of files, and tell how it went."""
    from zoedepth.calibration import is_calibrated, undo_files
    from zoedepth.folders import list_files
    from zoedepth.outputs.sidecar import ENDING

    if place.is_dir():
        sidecars = [path for path in list_files(place).files if path.suffix.lower() == ENDING and is_calibrated(path)]
        if not sidecars:
            raise InputError(f"{place} has no files that were written with a calibration: nothing to undo")
    else:
        sidecars = [place]
    console, failed = Console(stderr=True, highlight=False), 0
    for sidecar in sidecars:
        try:
            files = undo_files(sidecar)
        except (InputError, OSError) as error:  # such as a file that another program holds open
            if len(sidecars) == 1:
                raise
            failed += 1
            console.print(f"failed {sidecar}: {error}", soft_wrap=True, markup=False)
        else:
            print(*(file for file in files), sep="\n")
    console.print(f"{len(sidecars) - failed} of {len(sidecars)} photos put back", soft_wrap=True)
    return EXIT_FAILED if failed else 0


def _readings(number: int) -> str:
    return "1 reading" if number == 1 else f"{number} readings"
