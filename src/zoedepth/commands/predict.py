"""``zoedepth predict``: depth maps of photos, folders and globs, as files."""

import os
import signal
import threading
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.markup import escape

from zoedepth.errors import InputError, InputWarning, Terminated
from zoedepth.folders import check_writable
from zoedepth.outputs import OUTPUTS, Options, output_names
from zoedepth.stored import to_json

if TYPE_CHECKING:
    from zoedepth.batch import Request
    from zoedepth.forward.answer import Precision
    from zoedepth.jobs.destinations import Destination
    from zoedepth.jobs.inputs import Sources
    from zoedepth.jobs.place import JobPlace
    from zoedepth.jobs.run import Tally
    from zoedepth.jobs.work import Done, Input
    from zoedepth.model.interface import DepthModel
    from zoedepth.photos import Found
    from zoedepth.weights.exported import ExportedModel

EXIT_FAILED, EXIT_NOTHING_TO_DO, EXIT_INTERRUPTED, EXIT_TERMINATED = 1, 2, 130, 143

_MOST_FAILURES = 1000  # that are told; the manifest has all
_PATIENCE = 9.0  # seconds that photos in hand have after SIGTERM

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
    out: Annotated[str, tyro.conf.arg(aliases=["-o"], metavar="PATH")],
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
    tiles: Annotated[str | None, tyro.conf.arg(metavar="auto|RxC")] = None,
    relative: bool = False,
    compat: tuple[str, ...] = (),
    png_scale: float | None = None,
    vmin: float | None = None,
    vmax: float | None = None,
    colormap: str = "magma_r",
    max_triangles: int = 500_000,
    max_depth: float | None = None,
    device: str = "auto",
    precision: Literal["float32", "bfloat16", "float16"] = "float32",
    fast: bool = False,
    workers: int | None = None,
    overwrite: bool = False,
    shard: Annotated[str | None, tyro.conf.arg(metavar="I/N")] = None,
    column: str | None = None,
    engine: Literal["process", "ray"] = "process",
    address: str | None = None,
    json_: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Predict depth in metres: for each photo a 16-bit PNG, a colour preview and a JSON sidecar.

    The tree of a folder is kept. A photo that cannot be read is reported and skipped, and so is one whose files would
    replace something that is not from zoedepth. Killed or interrupted, type the same again: what is missing, failed or
    changed is done. Exit codes: 0 all done, 1 some failed, 2 nothing to do or a wrong option, 130 interrupted by
    Ctrl-C, 143 ended by SIGTERM.

    Args:
        sources: photos, folders (searched with their subfolders), globs ("photos/**/*.jpg"), lists of paths (.txt,
            .csv, .parquet), archives (.zip, .tar), and addresses of all of these (s3://, gs://, https://); - is a photo
            from standard input, for --out -.
        out: folder to write to, or a prefix of a store (s3://): NAME_depth.png, NAME_preview.jpg and NAME.json of each
            photo, and zoedepth-manifest.jsonl, which says what is done. - writes one file of one photo to standard
            output: the depth, or the one kind of --save.
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
        tiles: see large photos in tiles, too, for detail beyond the network's size; metres stay those of the whole.
            auto takes as many tiles as a photo is worth, 4x6 is 4 rows of 6. It takes longer by their number.
        relative: write relative depth instead (inverse depth without a unit): NAME_relative.png, the nearest is 65535.
            Models without a metric head (MiDaS) give nothing else. Models with one were not trained to keep it right.
        compat: behaviours of the original code to take over: batch-vote, 10m, squeeze; 80m for KITTI's
            checkpoints of baselines.
        png_scale: levels per metre of the PNG; without it 1000 (millimetres), or 256 for a depth map beyond 65.535 m.
        vmin: depth of the first colour in metres; without it, from each photo. Give vmin and vmax to compare previews.
        vmax: depth of the last colour in metres; without it, from each photo.
        colormap: magma, turbo, gray or Spectral, reversed with _r at the end.
        max_triangles: triangles of a mesh (--save glb), at most; 0 keeps all, one or two for each pixel.
        max_depth: metres beyond which a pixel makes no point and no surface (--save ply, pcd, glb, usdz, html), as for
            the sky. Maps of depth keep theirs.
        device: cpu, cuda, mps, or auto for the best there is; zoed-lite runs on the CPU where no driver of an
            accelerator is found.
        precision: bfloat16 is faster on hardware made for it; float16 is for GPUs.
        fast: compute with the runtime that `zoedepth benchmark` found fastest here; where it was not run, choose by
            what docs/performance.md measured. The depth is within 1 %. The first time exports the model to the user's
            cache.
        workers: photos computed at the same time, each from file to files; without it as many as there are cores. Each
            needs memory of its own: give 1 for large models where there is little.
        overwrite: predict those photos again, too, that are done.
        shard: do the I-th of N parts of the photos, e.g. 0/4; the other N - 1 commands do the others, on this machine
            or on others that see the same --out.
        column: column of a .csv or .parquet list that has the photos; without it image, photo, path, file, url or such.
        engine: process, this one, or ray: the machines of a cluster, or the cores of this one. Their results come in no
            order.
        address: the Ray cluster (HOST:PORT, or auto for the one this machine is in); without it RAY_ADDRESS, or a Ray
            on this machine for this command.
        json_: print one JSON object a line for each photo: photo, files, size (height, width), depth (min, median and
            max in metres), domain, projection, camera, focal_correction, calibration, seconds and error.
    """
    from zoedepth.batch import Request
    from zoedepth.calibration import read_calibration
    from zoedepth.commands.cameras import chosen_camera
    from zoedepth.commands.streams import STREAM, standard_streams
    from zoedepth.jobs.inputs import N_FIRST, Sources, begin
    from zoedepth.jobs.origins import is_address
    from zoedepth.jobs.place import job_place
    from zoedepth.jobs.shard import JobShard
    from zoedepth.threads import cpu_count, share_cores
    from zoedepth.tiles import read_tiles

    console = Console(stderr=True, highlight=False)
    # Otherwise Python would remember each warning, with its photo's name, for as long as it runs.
    warnings.simplefilter("always", InputWarning, append=True)
    # A wrong option is the caller's one mistake, not that of a thousand photos: found now.
    stored = is_address(out)
    if not out:
        raise InputError("--out is empty: give a folder, or . for this one")
    if not stored and Path(out).exists() and not Path(out).is_dir():
        raise InputError(f"--out {out} is a file: give a folder")
    if workers is not None and workers < 0:
        raise InputError(f"--workers must be 1 or more, got {workers}")
    if address is not None and engine != "ray":
        raise InputError("--address is that of a Ray cluster: give --engine ray, too, or leave it out")
    if fast and precision != "float32":
        raise InputError("--fast chooses the precision: leave --precision out")
    if fast and engine == "ray":
        raise InputError("--fast chooses for this machine, and --engine ray computes on others: leave one of them out")
    if engine == "ray" and out == STREAM:
        raise InputError("--out - is for one photo: leave --engine out")
    options = Options(
        png_scale=png_scale,
        vmin=vmin,
        vmax=vmax,
        colormap=colormap,
        max_triangles=max_triangles or None,
        max_depth=max_depth,
    )

    streamed = out == STREAM
    part = JobShard() if shard is None else JobShard.parse(shard)
    corrections = None if calibration is None else read_calibration(calibration)

    def request(*, relative: bool) -> Request:
        kind = "relative" if relative else "depth"
        names = output_names(save or ((kind,) if streamed else (kind, "preview")), map=kind)
        names = tuple(name for name in names if preview or name != "preview")
        if not names:
            raise InputError(
                "--save names nothing to write, or the preview alone, which --no-preview leaves out: name a kind of "
                "file, or leave one of the options out"
            )
        return Request(
            model,
            names,
            options,
            domain=domain,
            relative=relative,
            calibration=corrections,
            panorama=panorama,
            tiles=None if tiles is None else read_tiles(tiles),
        )

    wanted = request(relative=relative)
    with standard_streams(sources, Path(out), kinds=wanted.names, json_=json_) as (sources, folder):
        listing = Sources(tuple(sources), column, part, out if stored else "")
        inputs = listing.inputs()
        first, all_known = begin(inputs, N_FIRST)
        if json_:
            for path, reason in listing.found.unreadable.items():
                _print_json(path, error=reason)
        told = set(listing.found.unreadable)
        if not first:
            for failure in listing.found.failures:
                console.print(f"[red]{escape(failure)}[/]", soft_wrap=True)
            _tell_left_out(listing.found, console)
            searched = ", ".join(sources) or "no source given"
            n_ignored = listing.found.n_ignored
            # Other shards may have them all.
            if part.count > 1 and listing.firsts and not listing.found.unreadable:
                console.print(f"No photos in shard {part} ({escape(searched)}): nothing to do", soft_wrap=True)
                return 0
            console.print(f"No photos to predict ({escape(searched)}; {n_ignored} other files).", soft_wrap=True)
            return EXIT_NOTHING_TO_DO
        # All shards of a job take the size of one photo, whichever of them has it.
        sized = first if part.count == 1 else listing.firsts
        known_camera = chosen_camera(
            [photo.opened for photo in sized],
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
        if panorama and not isinstance(known_camera, str):
            raise InputError(_NO_CAMERA)
        place = job_place(out if stored else folder, part, kept=not streamed)
        if not stored:
            check_writable(folder, option="--out")
        if all_known:
            _refuse_files_of_others(first, place.destination, wanted)

        from zoedepth.jobs.run import Tally, run_job, writing
        from zoedepth.jobs.settings import job_settings, network_fingerprint
        from zoedepth.predict import Predictor
        from zoedepth.weights.load import pinned, weights_of

        n_workers = min(workers or cpu_count(), len(first))  # 0 once stood for all cores
        with share_cores(n_workers):
            weights_at = pinned(model)
            network, numbers, device = _load(
                weights_at,
                fast=fast,
                relative=relative,
                compat=compat,
                device=device,
                precision=precision,
                streams=n_workers,
                console=console,
            )
            if not network.config.domains:
                wanted = request(relative=True)
                if about_metres:
                    raise InputError(_NO_METRES)
            padded = None if pad == "model" else pad == "yes"
            predictor = Predictor(
                network,
                flip_average=flip,
                pad=padded,
                device="cpu" if engine == "ray" else device,  # the actors have the GPUs
                precision=numbers,
                camera=known_camera,
                focal_correction=None if focal_correction == "model" else focal_correction == "yes",
            )
            if domain is not None:
                predictor.domain_index(domain)
            if corrections is not None:
                wanted = replace(wanted, weights=weights_of(weights_at, compat=compat, pad=predictor.pad))
            settings = job_settings(wanted, predictor, weights=network_fingerprint(network))
            tally = Tally(total=len(first) if all_known else None)
            with place.opened() as manifest:
                with writing(manifest):
                    manifest.begin(settings, named=listing.named, overwrite=overwrite)
                listing.known = manifest.knows
                tell_done = json_ or len(first) == 1
                if engine == "ray":
                    from zoedepth.jobs.ray_engine import run_on_ray

                    results = run_on_ray(
                        chain(first, inputs),
                        predictor,
                        wanted,
                        model=model,
                        device=device,
                        manifest=manifest,
                        destination=place.destination,
                        workers=workers or None,
                        address=address,
                        tally=tally,
                        overwrite=overwrite,
                        tell_done=tell_done,
                    )
                else:
                    results = run_job(
                        chain(first, inputs),
                        predictor,
                        wanted,
                        manifest=manifest,
                        destination=place.destination,
                        workers=n_workers,
                        tally=tally,
                        overwrite=overwrite,
                        tell_done=tell_done,
                    )
                report = _Report(
                    listing, place, tally, console, told, json_=json_, streamed=streamed, overwrite=overwrite
                )
                return report.of(results)


def _load(
    model: str | Path,
    *,
    fast: bool,
    relative: bool,
    compat: tuple[str, ...],
    device: str,
    precision: Literal["float32", "bfloat16", "float16"],
    streams: int,
    console: Console,
) -> "tuple[DepthModel | ExportedModel, Precision, str]":
    """Load the model under a bar. Return it with the precision and the device for ``Predictor``."""
    from zoedepth.commands.progress import download_progress

    with download_progress() as progress:
        if fast:
            from zoedepth.runtimes.fast import load_fast

            tell = partial(console.print, soft_wrap=True, markup=False)
            chosen = load_fast(
                model,
                compat=compat,
                device=device,
                streams=streams,
                metres=not relative,
                progress=progress,
                tell=tell,
            )
            tell(f"Fast: {chosen.runtime} ({chosen.why})")
            return chosen.model, chosen.precision, chosen.device
        from zoedepth.weights.load import load_for_prediction, load_model

        # The graphs in the package hold no relative depth.
        load = load_model if relative else partial(load_for_prediction, device=device)
        network = load(model, compat=compat, precision=precision, streams=streams, progress=progress)
        return network, precision, device


def _refuse_files_of_others(first: "Sequence[Input]", destination: "Destination", wanted: "Request") -> None:
    """Refuse a few photos none of which can be written, before a model is loaded."""
    photos = [replace(destination.photo(each.path, each.target), origin=each.origin) for each in first]
    if (reason := destination.blocked(photos[0], wanted)) and all(
        destination.blocked(photo, wanted) for photo in photos
    ):
        raise InputError(reason if len(photos) == 1 else f"{reason}. So it is with all {len(photos)} photos")


class _Report:
    """Tells how a job goes, and how it went."""

    def __init__(
        self,
        listing: "Sources",
        place: "JobPlace",
        tally: "Tally",
        console: Console,
        told: set[str],
        *,
        json_: bool,
        streamed: bool,
        overwrite: bool,
    ) -> None:
        self.listing, self.place, self.tally, self.console = listing, place, tally, console
        self.told, self.json, self.streamed = told, json_, streamed
        again = "the same command without --overwrite" if overwrite else "the same command again"
        self.how_to_go_on = f"To go on, type {again}: what is done is not done twice."
        self.failures: list[str] = []
        self.notes = Counter[str]()
        self.last: Done | None = None
        self.counting = False

    def of(self, results: "Iterator[Done]") -> int:
        """Go through the results under a progress bar, and return the exit code."""
        from zoedepth.commands.progress import show_tally

        code, state, error = 0, "", ""
        try:
            with _terminated_as_interrupted(self._give_up), show_tally(self.tally, "depth", self.console):
                for done in results:
                    self._take(done)
        except Terminated:
            code, state = EXIT_TERMINATED, "Terminated: "
        except KeyboardInterrupt:
            code, state = EXIT_INTERRUPTED, "Interrupted: "
        except InputError as end:
            code, state, error = EXIT_FAILED, "Stopped: ", str(end)
        n_failed = self._tell(error)
        if self.tally.done and not self.streamed:
            self.console.print(f"Files are in {escape(self.place.destination.name)}", soft_wrap=True)
        self.console.print(f"{state}{self._sum(n_failed)}", soft_wrap=True)
        if state and not self.streamed:
            self.console.print(self.how_to_go_on)
        return code or (EXIT_FAILED if n_failed else 0)

    def _take(self, done: "Done") -> None:
        from zoedepth.jobs.run import count_in_background

        self.last = done
        if self.tally.total is None and not self.counting and not done.before:  # a finished job needs no number
            self.counting = True
            count_in_background(self.tally, self.listing.count)
        self.notes.update(done.notes)
        error = done.entry.error
        if error is not None and len(self.failures) < _MOST_FAILURES:
            self.failures.append(f"{done.name}: {error}")
        if self.json:
            files = {kind: self.place.destination.where(file) for kind, (file, _) in done.entry.outputs.items()}
            about = done.sidecar or self.place.destination.sidecar(done.entry.outputs) if files else {}
            _print_json(done.name, files=files, about=about, error=error or "")

    def _tell(self, error: str) -> int:
        """Tell what failed, and what is worth knowing; returns the number of failures."""
        found, tally = self.listing.found, self.tally
        if self.json:
            for path, reason in found.unreadable.items():
                if path not in self.told:
                    _print_json(path, error=reason)
        ends = [f"all that follow: {error}"] if error else []
        for failure in (*found.failures, *self.failures, *ends):
            self.console.print(f"[red]failed[/] {escape(failure)}", soft_wrap=True)
        if tally.failed > len(self.failures):
            self.console.print(f"and {tally.failed - len(self.failures):,} others, which the manifest lists")
        for note, n_noted in self.notes.items():
            self.console.print(f"[yellow]{n_noted}[/] {escape(note)}", soft_wrap=True)
        _tell_left_out(found, self.console)
        if self.last is not None and self.last.before and tally.seen == 1:
            files = ", ".join(self.place.destination.where(file) for file, _ in self.last.entry.outputs.values())
            again = f"{escape(self.last.name)} is done already: {escape(files)}. To do it again: --overwrite"
            self.console.print(again, soft_wrap=True)
        elif tally.before and tally.before == tally.seen:
            self.console.print(f"All {tally.before:,} photos are done already. To do them again: --overwrite")
        return len(found.unreadable) + tally.failed + len(ends)

    def _sum(self, n_failed: int) -> str:
        tally = self.tally
        of_total = "" if tally.total is None else f" of {tally.total}"
        before = f", {tally.before} done before" if tally.before else ""
        n_ignored = self.listing.found.n_ignored
        return f"{tally.done}{of_total} photos written, {n_failed} failed{before}, {n_ignored} other files"

    def _give_up(self) -> None:
        """End the process at once: the photos in hand take too long for whoever has sent SIGTERM."""
        self.console.print(
            f"Terminated: {self._sum(self.tally.failed)}. The photos in hand took longer than {_PATIENCE:g} s, and "
            f"were left. {self.how_to_go_on}",
            soft_wrap=True,
        )
        os._exit(EXIT_TERMINATED)


def _tell_left_out(found: "Found", console: Console) -> None:
    for reason, number in found.left_out.items():
        console.print(f"left out ({number}): {escape(reason)}", soft_wrap=True)


def _print_json(
    photo: str, *, files: Mapping[str, str] | None = None, about: Mapping[str, object] | None = None, error: str = ""
) -> None:
    """Print a line of --json. Each has the same names."""
    values = {name: (about or {}).get(key) for name, key in _IN_JSON.items()}
    print(to_json({"photo": photo, "files": files or {}, **values, "error": error or None}), flush=True)


@contextmanager
def _terminated_as_interrupted(give_up: Callable[[], None]) -> Iterator[None]:
    """Let SIGTERM, with which systems and schedulers end a program, do what Ctrl-C does.

    They kill what does not end soon. So ``give_up`` is called ``_PATIENCE`` seconds after the signal, if the block has
    not ended then.
    """
    timers: list[threading.Timer] = []

    def end(*_: object) -> None:
        if not timers:
            timers.append(threading.Timer(_PATIENCE, give_up))
            timers[0].daemon = True
            timers[0].start()
        raise Terminated

    if threading.current_thread() is not threading.main_thread():  # others get no signals
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        for timer in timers:
            timer.cancel()
        signal.signal(signal.SIGTERM, before)
