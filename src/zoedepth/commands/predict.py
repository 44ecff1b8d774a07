"""``zoedepth predict``: depth maps of photos, folders and globs, as files."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from zoedepth.batch import Found, Request, cpu_count, find_photos, predict_all, share_cores
from zoedepth.errors import InputError
from zoedepth.outputs import OUTPUTS, Options

if TYPE_CHECKING:
    from zoedepth.predict import Predictor

EXIT_FAILED, EXIT_NOTHING_TO_DO, EXIT_INTERRUPTED = 1, 2, 130

_SAVE = tyro.conf.arg(
    metavar=f"[{{{','.join(OUTPUTS)}}} ...]",
    help="kinds of files to write beside the sidecar; without it, depth (or relative) and preview. "
    + "; ".join(f"{name}: NAME{output.ending}, {output.summary}" for name, output in OUTPUTS.items()),
)


def predict(
    sources: tyro.conf.Positional[tuple[str, ...]],
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    model: str = "zoed-lite",
    save: Annotated[tuple[str, ...], _SAVE] = (),
    preview: bool = True,
    flip: bool = True,
    pad: Literal["model", "yes", "no"] = "model",
    domain: str | None = None,
    relative: bool = False,
    compat: tuple[str, ...] = (),
    png_scale: float | None = None,
    vmin: float | None = None,
    vmax: float | None = None,
    colormap: str = "magma_r",
    device: str = "auto",
    precision: Literal["float32", "bfloat16"] = "float32",
    workers: int = 0,
) -> int:
    """Predict depth in metres: for each photo a 16-bit PNG, a colour preview and a JSON sidecar.

    The tree of a folder is kept. A photo that cannot be read is reported and skipped. Exit codes: 0 all done, 1 some
    failed, 2 nothing to do, 130 interrupted.

    Args:
        sources: photos, folders (searched with their subfolders) and globs ("photos/**/*.jpg").
        out: folder to write to: NAME_depth.png, NAME_preview.jpg and NAME.json of each photo.
        model: a name of `zoedepth models`, a file or folder of weights, a Hugging Face id, or a file of
            `zoedepth export`.
        save: names in ``outputs.OUTPUTS``; their summaries are the help.
        preview: write the colour preview, the photo beside its depth with a bar in metres.
        flip: average with the prediction for the mirrored photo; half as fast, smoother.
        pad: reflect the borders outwards before the network, against artefacts at the border. "model" does as the model
            was made for (the released ones: yes; zoed-lite: no).
        domain: scene type whose head to use, e.g. indoor. None leaves it to the model's router, photo by photo.
        relative: write relative depth instead (inverse depth without a unit): NAME_relative.png, the nearest is 65535.
            Models without a metric head (MiDaS) give nothing else. Models with one were not trained to keep it right.
        compat: behaviours of the original code to take over: batch-vote, 10m, squeeze.
        png_scale: levels per metre of the PNG. None: 1000 (millimetres), or 256 for a depth map beyond 65.535 m.
        vmin: depth of the first colour in metres. None takes it from each photo. Set vmin and vmax to compare previews.
        vmax: depth of the last colour in metres. None takes it from each photo.
        colormap: magma, turbo, gray or Spectral, reversed with _r at the end.
        device: cpu, cuda, mps, or auto for the best there is.
        precision: bfloat16 is faster on hardware made for it.
        workers: photos computed at the same time, each from file to files. 0: as many as there are cores. Each needs
            memory of its own: give 1 for large models where there is little.
    """
    console = Console(stderr=True, highlight=False)
    # A wrong option is the caller's one mistake, not that of a thousand photos: found now.
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out} is a file: give a folder")
    if workers < 0:
        raise InputError(f"--workers must be 0 or more, got {workers}")
    options = Options(png_scale=png_scale, vmin=vmin, vmax=vmax, colormap=colormap)

    def request(*, relative: bool) -> Request:
        names = save or ("relative" if relative else "depth", "preview")
        names = tuple(name for name in dict.fromkeys(names) if preview or name != "preview")
        return Request(model, names, options, domain=domain, relative=relative)

    wanted = request(relative=relative)
    found = find_photos(sources, out)
    if not found.photos:
        for failure in found.failures:
            console.print(f"[red]{escape(failure)}[/]", soft_wrap=True)
        searched = ", ".join(sources) or "no source given"
        console.print(f"No photos to predict ({escape(searched)}; {found.n_ignored} other files).", soft_wrap=True)
        return EXIT_NOTHING_TO_DO

    from zoedepth.commands.progress import download_progress
    from zoedepth.predict import Predictor
    from zoedepth.weights.load import load_model

    workers = min(workers or cpu_count(), len(found.photos))
    with share_cores(workers):
        with download_progress() as progress:
            network = load_model(model, compat=compat, precision=precision, streams=workers, progress=progress)
        if not network.config.domains:
            wanted = request(relative=True)
        padded = None if pad == "model" else pad == "yes"
        predictor = Predictor(network, flip_average=flip, pad=padded, device=device, precision=precision)
        if domain is not None:
            predictor.domain_index(domain)
        return _run(found, predictor, wanted, workers=workers, console=console)


def _run(found: Found, predictor: "Predictor", wanted: Request, *, workers: int, console: Console) -> int:
    """Predict all photos under a progress bar, and tell how it went."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    n_photos, n_written, failures, notes = len(found.photos), 0, list(found.failures), Counter[str]()
    interrupted = False
    try:
        with Progress(*columns, console=console, transient=True) as progress:
            outcomes = predict_all(found.photos, predictor, wanted, workers=workers)
            for outcome in progress.track(outcomes, total=n_photos, description="depth"):
                if outcome.failure is None:
                    n_written += 1
                    notes.update(outcome.notes)
                else:
                    failures.append(outcome.failure)
    except KeyboardInterrupt:
        interrupted = True

    for failure in failures:
        console.print(f"[red]failed[/] {escape(failure)}", soft_wrap=True)
    for note, n_noted in notes.items():
        console.print(f"[yellow]{n_noted}[/] {escape(note)}", soft_wrap=True)
    state = "Interrupted: " if interrupted else ""
    console.print(
        f"{state}{n_written} of {n_photos} photos written, {len(failures)} failed, {found.n_ignored} other files",
        soft_wrap=True,
    )
    return EXIT_INTERRUPTED if interrupted else EXIT_FAILED if failures else 0
