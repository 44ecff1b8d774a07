"""``zoedepth predict``: depth maps of photos, folders and globs, as files."""

import signal
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.markup import escape

from zoedepth.errors import InputError
from zoedepth.folders import check_writable
from zoedepth.outputs import OUTPUTS, Options, output_names
from zoedepth.stored import to_json

if TYPE_CHECKING:
    from zoedepth.batch import Found, Outcome, Request
    from zoedepth.predict import Predictor

EXIT_FAILED, EXIT_NOTHING_TO_DO, EXIT_INTERRUPTED, EXIT_TERMINATED = 1, 2, 130, 143

_IN_JSON = {
    "size": "input_size",
    "depth": "depth",
    "domain": "domain",
    "projection": "projection",
    "camera": "camera",
    "focal_correction": "focal_correction",
    "calibration": "calibration",
    "seconds": "seconds",
}
"""Name in a line of --json → name in the sidecar."""

_NO_METRES = "relative depth has no metres: leave out the camera, and --focal-correction yes"

_NO_CAMERA = "a panorama looks everywhere and has no camera: leave out the camera, or --panorama"

_SAVE = tyro.conf.arg(
    metavar=f"[{{{','.join(OUTPUTS)}}} ...]",
    help="kinds of files to write beside the sidecar, also by suffix and with commas (png,exr,glb); without it, depth "
    "(or relative) and preview. "
    + "; ".join(f"{name}: NAME{output.ending}, {output.summary}" for name, output in OUTPUTS.items()),
)


def predict(
    sources: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="PHOTOS...")],
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    model: str = "zoed-lite",
    save: Annotated[tuple[str, ...], _SAVE] = (),
    preview: bool = True,
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
    calibration: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    panorama: bool = False,
    relative: bool = False,
    compat: tuple[str, ...] = (),
    png_scale: float | None = None,
    vmin: float | None = None,
    vmax: float | None = None,
    colormap: str = "magma_r",
    max_triangles: int = 500_000,
    device: str = "auto",
    precision: Literal["float32", "bfloat16"] = "float32",
    workers: int | None = None,
    json_: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Predict depth in metres: for each photo a 16-bit PNG, a colour preview and a JSON sidecar.

    The tree of a folder is kept. A photo that cannot be read is reported and skipped, and so is one whose files would
    replace something that is not from zoedepth. Exit codes: 0 all done, 1 some failed, 2 nothing to do, 130 interrupted
    by Ctrl-C, 143 ended by SIGTERM.

    Args:
        sources: photos, folders (searched with their subfolders) and globs ("photos/**/*.jpg"); - is a photo from
            standard input, for --out -.
        out: folder to write to: NAME_depth.png, NAME_preview.jpg and NAME.json of each photo. - writes one file of one
            photo to standard output: the depth, or the one kind of --save.
        model: a name of `zoedepth models`, a file or folder of weights, a Hugging Face id, or a file of
            `zoedepth export`.
        save: names in ``outputs.OUTPUTS``, or suffixes; the summaries of the outputs are the help.
        preview: write the colour preview, the photo beside its depth with a bar in metres.
        flip: average with the prediction for the mirrored photo; half as fast, smoother.
        pad: reflect the borders outwards before the network, against artefacts at the border. "model" does as the model
            was made for (the released ones: yes; zoed-lite: no).
        domain: scene type whose head to use, e.g. indoor; without it the model's router decides, photo by photo.
        camera: exif, the default, reads the camera from each photo's notes. none assumes that of the model's training
            photos, as it is wherever nobody says it. FILE is a camera for all photos: OpenCV's or ROS's YAML, COLMAP's
            cameras.txt, a 3x3 matrix (.npy, .txt, .json), a sidecar. Photos resized from its size are fine; others of
            another size fail.
        fov_x: field of view of all photos, degrees from the left to the right border.
        fov_y: field of view of all photos, degrees from the top to the bottom border.
        fov_diagonal: field of view of all photos, degrees from corner to corner.
        focal_px: focal length in pixels of photos of the size of the first.
        intrinsics: focal lengths and principal point in pixels of photos of the size of the first; the centre of the
            top left pixel is at (0, 0).
        focal_correction: multiply depth by the photo's focal length over that of the training photos. "model" does so
            where the model was trained in one canonical camera, and where the camera is given by an option.
        calibration: file of `zoedepth calibrate`; photos of another camera, model or scene type fail.
        panorama: the photos are panoramas of 360 x 180 degrees, twice as wide as high. One that says so in its XMP is
            found to be one without this. Depth is the distance along each pixel's ray then.
        relative: write relative depth instead (inverse depth without a unit): NAME_relative.png, the nearest is 65535.
            Models without a metric head (MiDaS) give nothing else. Models with one were not trained to keep it right.
        compat: behaviours of the original code to take over: batch-vote, 10m, squeeze.
        png_scale: levels per metre of the PNG; without it 1000 (millimetres), or 256 for a depth map beyond 65.535 m.
        vmin: depth of the first colour in metres; without it, from each photo. Give vmin and vmax to compare previews.
        vmax: depth of the last colour in metres; without it, from each photo.
        colormap: magma, turbo, gray or Spectral, reversed with _r at the end.
        max_triangles: triangles of a mesh (--save glb), at most; 0 keeps all, one or two for each pixel.
        device: cpu, cuda, mps, or auto for the best there is.
        precision: bfloat16 is faster on hardware made for it.
        workers: photos computed at the same time, each from file to files; without it as many as there are cores. Each
            needs memory of its own: give 1 for large models where there is little.
        json_: print one JSON object a line for each photo: photo, files, size (height, width), depth (min, median and
            max in metres), domain, projection, camera, focal_correction, calibration, seconds and error.
    """
    from zoedepth.batch import Request, blocked, cpu_count, find_photos, share_cores
    from zoedepth.calibration import read_calibration
    from zoedepth.commands.cameras import chosen_camera
    from zoedepth.commands.streams import STREAM, standard_streams

    console = Console(stderr=True, highlight=False)
    # A wrong option is the caller's one mistake, not that of a thousand photos: found now.
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out} is a file: give a folder")
    if workers is not None and workers < 0:
        raise InputError(f"--workers must be 1 or more, got {workers}")
    options = Options(png_scale=png_scale, vmin=vmin, vmax=vmax, colormap=colormap, max_triangles=max_triangles or None)

    streamed = str(out) == STREAM
    corrections = None if calibration is None else read_calibration(calibration)

    def request(*, relative: bool) -> Request:
        kind = "relative" if relative else "depth"
        names = output_names(save or ((kind,) if streamed else (kind, "preview")), map=kind)
        names = tuple(name for name in names if preview or name != "preview")
        return Request(
            model, names, options, domain=domain, relative=relative, calibration=corrections, panorama=panorama
        )

    wanted = request(relative=relative)
    with standard_streams(sources, out, kinds=wanted.names, json_=json_) as (sources, out):
        found = find_photos(sources, out)
        if json_:
            for path, reason in found.unreadable.items():
                _print_json(path, error=reason)
        if not found.photos:
            for failure in found.failures:
                console.print(f"[red]{escape(failure)}[/]", soft_wrap=True)
            _tell_left_out(found, console)
            searched = ", ".join(sources) or "no source given"
            console.print(f"No photos to predict ({escape(searched)}; {found.n_ignored} other files).", soft_wrap=True)
            return EXIT_NOTHING_TO_DO
        known_camera = chosen_camera(
            [photo.path for photo in found.photos],
            camera=camera,
            fov_x=fov_x,
            fov_y=fov_y,
            fov_diagonal=fov_diagonal,
            focal_px=focal_px,
            intrinsics=intrinsics,
        )
        about_metres = known_camera != "exif" or focal_correction == "yes"
        if relative and about_metres:
            raise InputError(_NO_METRES)
        if panorama and known_camera != "exif":
            raise InputError(_NO_CAMERA)
        check_writable(out, option="--out")
        if (reason := blocked(found.photos[0], wanted)) and all(blocked(photo, wanted) for photo in found.photos):
            raise InputError(
                reason if len(found.photos) == 1 else f"{reason}. So it is with all {len(found.photos)} photos"
            )

        from zoedepth.commands.progress import download_progress
        from zoedepth.predict import Predictor
        from zoedepth.weights.load import load_model

        workers = min(workers or cpu_count(), len(found.photos))  # 0 once stood for all cores
        with share_cores(workers):
            with download_progress() as progress:
                network = load_model(model, compat=compat, precision=precision, streams=workers, progress=progress)
            if not network.config.domains:
                wanted = request(relative=True)
                if about_metres:
                    raise InputError(_NO_METRES)
            padded = None if pad == "model" else pad == "yes"
            predictor = Predictor(
                network,
                flip_average=flip,
                pad=padded,
                device=device,
                precision=precision,
                camera=known_camera,
                focal_correction=None if focal_correction == "model" else focal_correction == "yes",
            )
            if domain is not None:
                predictor.domain_index(domain)
            return _run(found, predictor, wanted, workers=workers, console=console, json_=json_)


def _run(
    found: "Found", predictor: "Predictor", wanted: "Request", *, workers: int, console: Console, json_: bool
) -> int:
    """Predict all photos under a progress bar, and tell how it went."""
    from zoedepth.batch import predict_all
    from zoedepth.commands.progress import track

    n_written, failures, notes = 0, list(found.failures), Counter[str]()
    code, state = 0, ""
    try:
        with _terminated_as_interrupted():
            outcomes = predict_all(found.photos, predictor, wanted, workers=workers)
            for outcome in track(outcomes, "depth", total=len(found.photos), console=console):
                if outcome.failure is None:
                    n_written += 1
                    notes.update(outcome.notes)
                else:
                    failures.append(outcome.failure)
                if json_:
                    _print_outcome(outcome)
    except _Terminated:
        code, state = EXIT_TERMINATED, "Terminated: "
    except KeyboardInterrupt:
        code, state = EXIT_INTERRUPTED, "Interrupted: "
    except InputError as error:
        code, state = EXIT_FAILED, "Stopped: "
        failures.append(f"all that follow: {error}")

    for failure in failures:
        console.print(f"[red]failed[/] {escape(failure)}", soft_wrap=True)
    for note, n_noted in notes.items():
        console.print(f"[yellow]{n_noted}[/] {escape(note)}", soft_wrap=True)
    _tell_left_out(found, console)
    console.print(
        f"{state}{n_written} of {len(found.photos)} photos written, {len(failures)} failed, "
        f"{found.n_ignored} other files",
        soft_wrap=True,
    )
    return code or (EXIT_FAILED if failures else 0)


def _tell_left_out(found: "Found", console: Console) -> None:
    for reason, number in found.left_out.items():
        console.print(f"left out ({number}): {escape(reason)}", soft_wrap=True)


def _print_outcome(outcome: "Outcome") -> None:
    photo, sidecar = outcome.photo, outcome.sidecar
    if outcome.failure is not None:
        return _print_json(str(photo.path), error=outcome.failure.removeprefix(f"{photo.path}: "))
    return _print_json(str(photo.path), files={kind: str(file) for kind, file in outcome.files.items()}, about=sidecar)


def _print_json(
    photo: str, *, files: Mapping[str, str] | None = None, about: Mapping[str, object] | None = None, error: str = ""
) -> None:
    """Print a line of --json. Each has the same names."""
    values = {name: (about or {}).get(key) for name, key in _IN_JSON.items()}
    print(to_json({"photo": photo, "files": files or {}, **values, "error": error or None}), flush=True)


class _Terminated(KeyboardInterrupt):
    """SIGTERM came."""


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Let SIGTERM, with which systems and schedulers end a program, do what Ctrl-C does."""

    def end(*_: object) -> None:
        raise _Terminated

    if threading.current_thread() is not threading.main_thread():  # others get no signals
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
