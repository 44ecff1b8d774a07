"""``zoedepth evaluate --model MODEL --data NAME=CSV ... --out DIR``."""

import os
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import tyro

from zoedepth.commands.data import named_paths, named_sources
from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import Protocol, find_protocol

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from zoedepth.evaluation.evaluation_set import EvaluationSet
    from zoedepth.evaluation.predictions import CameraUse, FolderSource, Kind, PredictionSource
    from zoedepth.evaluation.summary import Summary
    from zoedepth.evaluation.tables import ReportTable


def evaluate(
    *,
    data: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=SOURCE...")],
    model: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = (),
    predictions: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=FOLDER...")] = (),
    predictions_scale: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=SCALE...")] = (),
    predictions_kind: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=KIND...")] = (),
    root: Path | None = None,
    trivial: tuple[Path, ...] = (),
    protocol: Annotated[tuple[str, ...], tyro.conf.arg(metavar="DATA=PROTOCOL...")] = (),
    crop: Literal["none", "eigen", "eigen-scaled", "garg"] | None = None,
    min_depth: float | None = None,
    max_depth: float | None = None,
    flip: bool = True,
    pad: Literal["protocol", "yes", "no"] = "protocol",
    resize: Literal["keep-aspect", "squeeze"] | None = None,
    mean: Literal["images", "pixels"] | None = None,
    align: Literal["none", "median", "disparity"] | None = None,
    camera: Literal["none", "data"] = "none",
    compat: tuple[str, ...] = (),
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    pictures: bool = True,
    compare: int = 0,
    mri: str | None = None,
    with_paper: Literal["best", "all"] | None = None,
    device: str = "auto",
    fast: bool = False,
    json_: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Score models, and other people's depth maps, on photos with known depth.

    A published data set in its official folder is scored under the paper's protocol. For other data the domain decides:
    indoor takes NYU's protocol (Eigen crop, 10 m), outdoor KITTI's (KB crop, then Garg crop, 80 m), any other domain
    has no crop. Every result carries the name and the hash of its protocol. Under torchrun the processes share the
    images. To go on with an interrupted run that has --out, type the same command again; what has changed since, such
    as weights or depth, is scored anew.

    Args:
        data: SOURCE or NAME=SOURCE: lists, folders, shards, hf:OWNER/NAME (docs/your-data.md), or the official folder
            of a published data set under its name: nyu=DIR.
        model: a name of `zoedepth models`, a file or folder of weights, a Hugging Face id, or LABEL=any of them; give
            the option again for more models. With nothing to score it is zoed-lite.
        predictions: NAME=FOLDER with somebody's depth maps (.png, .npy, .npz ...), found by the photos' names.
        predictions_scale: stored value of one metre in these maps, 1000 for millimetres or 256 for KITTI's, or
            NAME=SCALE for one folder. It is needed for whole numbers that do not say it.
        predictions_kind: depth, disparity, or NAME=KIND for one folder. disparity is inverse depth up to an unknown
            scale and shift, as of MiDaS; it is scored with --align disparity.
        root: the folder that the paths of the lists in --data are relative to; without it that of each list.
        trivial: lists of training data; adds two guesses that never look at the photo: the best constant, and the mean
            depth map.
        protocol: name of a protocol for all data, or DATA=PROTOCOL; see zoedepth.evaluation.protocols.PROTOCOLS.
        crop: part of the true depth that is scored.
        min_depth: nearest depth that is scored, metres.
        max_depth: farthest depth that is scored, metres; predictions are clipped to it.
        flip: average with the prediction for the mirror image.
        pad: reflect the photo's borders outwards before the model; no published protocol does.
        resize: keep the photo's proportions, or squeeze it to the trained size (the paper).
        mean: average the metrics over images (the paper), or take them over all pixels.
        align: give the prediction something of the truth first. median: a factor. disparity: scale and shift of its
            inverse.
        camera: data tells models the cameras that the data names (fx, fy, cx, cy), and corrects depth by the focal
            length. none tells them nothing.
        compat: behaviours of the original code to take over: batch-vote, 10m, squeeze; 80m for KITTI's
            checkpoints of baselines.
        out: folder for scores (JSONL), tables (Markdown, HTML, LaTeX, JSON), pictures and plots.
        pictures: make the pictures and plots, too.
        compare: number of photos of each data set to show with all models side by side, as the paper's figures do:
            photo, truth, depths, squared errors. Needs --out.
        mri: label of a model or folder; adds the mean relative improvements over it (mRI_theta on each data set, mRI_D
            over all), as in the paper's tables.
        with_paper: add the paper's numbers on these data sets, sorted by REL. best: its best, and those of the models
            that are scored. all: all of them.
        device: cpu, cuda, mps, or auto for the best there is.
        fast: compute with what is fastest on this machine, see `zoedepth benchmark`. Depth is within 1 % of that in
            float32, so take it to compare what differs more, and not for numbers that are to stand beside others'.
        json_: print one JSON object for each model and data set, and nothing else.
    """
    from rich.console import Console

    from zoedepth.evaluation.dataset_scores import Processes
    from zoedepth.evaluation.evaluate import evaluate as score_all
    from zoedepth.evaluation.evaluation_set import open_evaluation_set
    from zoedepth.evaluation.out_folder import check_folder
    from zoedepth.evaluation.report import require_matplotlib
    from zoedepth.stored import to_json

    console = Console(stderr=True, highlight=False)

    def note(message: str) -> None:
        if Processes.from_environment().rank == 0:  # the others would say the same
            console.print(f"note: {message}", soft_wrap=True, markup=False)

    pictures = pictures and out is not None
    if compare and out is None:
        raise InputError("--compare makes pictures: give --out, the folder for them")
    if pictures:
        require_matplotlib()  # said before models are fetched
    if out is not None:
        check_folder(out)
    folders = _folders(predictions, predictions_scale, predictions_kind)
    align = _alignment(align, folders, alone=not (model or trivial))
    changes = {
        "crop": crop, "min_depth": min_depth, "max_depth": max_depth,
        # All protocols average: only the other way is a change.
        "flip_average": None if flip else False, "pad": {"protocol": None, "yes": True, "no": False}[pad],
        "resize": resize, "mean": mean, "alignment": align,
    }  # fmt: skip
    changes = {name: value for name, value in changes.items() if value is not None}
    given = named_sources(data)
    chosen = _protocols(protocol, list(given))
    sets = {
        name: open_evaluation_set(source, name=name, protocol=chosen[name], changes=changes, root=root)
        for name, source in given.items()
    }
    sources = _sources(model, folders, trivial, sets, camera=camera, compat=compat, device=device, fast=fast, root=root,
                       tell=note)  # fmt: skip
    if mri is not None and mri not in sources:
        raise InputError(f"--mri is {mri!r}, which is not scored: give one of {', '.join(sources)}")
    found = score_all(
        sources,
        sets,
        folder=out,
        pictures=pictures,
        compare=compare,
        track=lambda indices, description: _track(console, indices, description),
        on_failure=lambda message: console.print(f"failed: {message}", soft_wrap=True, markup=False),
        on_note=note,
    )
    if found.processes.rank:
        return 0  # the first says how it went: torchrun ends all at the first that fails, and it has yet to report
    if json_:
        for summary in found.summaries:
            print(to_json(_record(summary)))
    else:
        for table in found.tables(with_paper=with_paper, reference=mri):
            print_table(table)
    if out is not None:
        command = shlex.join(["zoedepth", *sys.argv[1:]])
        found.write_report(out, command=command, with_paper=with_paper, reference=mri)
        console.print(f"Report: {out / 'report.md'}, .html, .tex, .json", soft_wrap=True)
    return 0 if found.complete else 1


def _protocols(wanted: Sequence[str], names: Sequence[str]) -> dict[str, Protocol | None]:
    """Return, for each data set, the protocol given for it, else the one given for all, else None."""
    return _by_name("--protocol", wanted, names, find_protocol)


Value = TypeVar("Value")


def _by_name(
    option: str, wanted: Sequence[str], names: Sequence[str], read: Callable[[str], Value]
) -> dict[str, Value | None]:
    """Return, for each name, its value in an option of VALUE or NAME=VALUE; else the one for all, else None."""
    given: dict[str, Value] = {}
    for name, _, value in (entry.rpartition("=") for entry in wanted):
        if name in given:
            raise InputError(f"{option} says twice what holds for {name or 'all'}: leave one of them out")
        given[name] = read(value)
    if unknown := sorted(given.keys() - {*names, ""}):
        raise InputError(f"{option} is given for {unknown}, but the names are {sorted(names)}: use one of these")
    if wanted and not names:
        raise InputError(f"{option} is given without --predictions: add them")
    return {name: given.get(name, given.get("")) for name in names}


def _scale(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(
            f"--predictions-scale must be a number, such as 1000 for millimetres, or NAME=NUMBER; it is {text!r}"
        ) from None


def _kind(text: str) -> "Kind":
    if text not in ("depth", "disparity"):
        raise InputError(f"--predictions-kind must be depth or disparity, or NAME=KIND; it is {text!r}")
    return text


def _folders(predictions: Sequence[str], scales: Sequence[str], kinds: Sequence[str]) -> "dict[str, FolderSource]":
    """Open the folders of depth maps, by their labels."""
    from zoedepth.evaluation.predictions import FolderSource

    found = named_paths(tuple(predictions))
    scale = _by_name("--predictions-scale", scales, list(found), _scale)
    kind = _by_name("--predictions-kind", kinds, list(found), _kind)
    return {label: FolderSource(folder, scale=scale[label], kind=kind[label]) for label, folder in found.items()}


def _alignment(
    align: Literal["none", "median", "disparity"] | None, folders: "Mapping[str, FolderSource]", *, alone: bool
) -> Literal["none", "median", "disparity"] | None:
    """Return the alignment: that of disparity follows from its kind where nothing else is scored."""
    relative = [label for label, source in folders.items() if source.kind == "disparity"]
    if align is not None or not relative:
        return align
    if not alone or len(relative) < len(folders):
        raise InputError(f"{relative[0]} has no metres: add --align disparity, which then holds for all that is scored")
    return "disparity"


def _sources(
    models: Sequence[str],
    folders: "Mapping[str, FolderSource]",
    trivial: Sequence[Path],
    sets: "Mapping[str, EvaluationSet]",
    *,
    camera: "CameraUse",
    compat: Sequence[str],
    device: str,
    fast: bool,
    root: Path | None,
    tell: Callable[[str], None],
) -> "dict[str, PredictionSource]":
    """Open everything that is to be scored, by its label."""
    from zoedepth.commands.progress import download_progress
    from zoedepth.evaluation.predictions import TRIVIAL, ModelSource, trivial_sources

    if not (models or folders or trivial):
        models = ("zoed-lite",)
    if camera == "data" and not models:
        raise InputError("--camera data is for models, and none is scored: add --model, or leave it out")
    if fast and not models:
        raise InputError("--fast is for models, and none is scored: add --model, or leave it out")
    names = [
        (label, value) if equals and not os.path.exists(each) else (each, each)  # a path may have a = in it
        for each in models
        for label, equals, value in (each.partition("="),)
    ]
    labels = [*(label for label, _ in names), *folders, *(TRIVIAL if trivial else ())]
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(f"two sources are called {label!r}: name them, LABEL=SOURCE")
    found: dict[str, PredictionSource] = {}
    for label, name in names:
        with download_progress() as progress:
            found[label] = ModelSource.load(
                name, compat=compat, device=device, camera=camera, fast=fast, progress=progress, tell=tell
            )
    found |= folders
    if trivial:
        by_domain: dict[str, Protocol] = {}
        for name, each in sets.items():
            for domain, chosen in each.protocols.items():
                if by_domain.setdefault(domain, chosen) != chosen:
                    raise InputError(
                        f"--trivial is fitted under the protocol of a domain, and {name} has another one for {domain} "
                        "than a data set before it: score them one after the other"
                    )
        found |= trivial_sources(trivial, by_domain, root=root)
    return found


def _track(console: "Console", indices: list[int], description: str) -> Iterable[int]:
    from zoedepth.commands.progress import track

    return track(indices, description, console=console)


def _record(summary: "Summary") -> dict:
    """Return the short form for --json; everything is in report.json."""
    from zoedepth.evaluation.uncertainty import UncertaintyScores

    metrics = {} if summary.metrics is None else asdict(summary.metrics)
    uncertainty = {field.name: summary.uncertainty.get(field.name) for field in fields(UncertaintyScores)}
    return {
        "source": summary.source,
        "data": summary.data,
        "protocols": summary.protocols,
        **metrics,
        "boundary_f1": summary.boundary_f1,
        **uncertainty,
        "images": summary.n_scored,
        "without_truth": summary.n_images - summary.n_scored,
        "failed": summary.n_failed,
        "router": summary.router,
        "alignment": summary.alignment,
        "holes": summary.holes,
        "camera": summary.camera,
        "fast": summary.fast,
    }


def print_table(table: "ReportTable") -> None:
    """Print a table and its note; a block for each row where it is too wide: no name and no number is cut."""
    from rich.console import Console

    console = Console(file=sys.stdout, width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else 150)
    _print_table(console, table)
    if table.note:
        console.print(table.note, markup=False, highlight=False)


def _print_table(console: "Console", table: "ReportTable") -> None:
    from rich.measure import Measurement
    from rich.table import Table
    from rich.text import Text

    shown = Table(title=Text(table.title), title_justify="left")
    for heading in table.header:
        shown.add_column(heading, no_wrap=True)
    rows = [[Text(cell, "bold" if (i, j) in table.best else "") for j, cell in enumerate(row)]
            for i, row in enumerate(table.rows)]  # fmt: skip
    for row in rows:
        shown.add_row(*row)
    unbounded = console.options.update_width(10_000)
    if Measurement.get(console, unbounded, shown).maximum <= console.width:
        console.print(shown)
        return
    console.print(Text(table.title, "italic"))
    for row in rows:
        console.print(row[0], soft_wrap=True)
        pairs = [Text(f"{heading} ").append_text(cell).append("  ")
                 for heading, cell in zip(table.header[1:], row[1:], strict=True) if cell.plain]  # fmt: skip
        for line in _lines(pairs, console.width - 2):
            line.rstrip()
            console.print(Text("  ").append_text(line))


def _lines(words: "Sequence[Text]", width: int) -> "Iterator[Text]":
    """Set words in lines of this width, without breaking any."""
    from rich.text import Text

    line = Text()
    for word in words:
        if line and len(line) + len(word.plain.rstrip()) > width:
            yield line
            line = Text()
        line.append_text(word)
    yield line
