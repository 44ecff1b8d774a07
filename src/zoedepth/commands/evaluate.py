"""``zoedepth evaluate --model MODEL --data NAME=CSV ... --out DIR``."""

import json
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from zoedepth.commands.data import named_paths, named_sources
from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import Protocol, find_protocol

if TYPE_CHECKING:
    from rich.console import Console

    from zoedepth.evaluation.evaluation_set import EvaluationSet
    from zoedepth.evaluation.predictions import PredictionSource
    from zoedepth.evaluation.summary import Summary
    from zoedepth.evaluation.tables import ReportTable


def evaluate(
    *,
    data: tuple[str, ...],
    model: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = (),
    predictions: tuple[str, ...] = (),
    trivial: tuple[Path, ...] = (),
    protocol: tuple[str, ...] = (),
    crop: Literal["none", "eigen", "eigen-scaled", "garg"] | None = None,
    min_depth: float | None = None,
    max_depth: float | None = None,
    flip: bool = True,
    pad: bool = False,
    resize: Literal["keep-aspect", "squeeze"] | None = None,
    mean: Literal["images", "pixels"] | None = None,
    align: Literal["none", "median", "disparity"] | None = None,
    compat: tuple[str, ...] = (),
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    pictures: bool = True,
    with_paper: bool = False,
    device: str = "auto",
    json_: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Score models, and other people's depth maps, on photos with known depth.

    A published data set in its official folder is scored under the paper's protocol. For other data the domain decides:
    indoor takes NYU's protocol (Eigen crop, 10 m), outdoor KITTI's (KB crop, then Garg crop, 80 m), any other domain
    has no crop. Every result carries the name and the hash of its protocol. Under torchrun the processes share the
    images. To go on with an interrupted run that has --out, type the same command again.

    Args:
        data: SOURCE or NAME=SOURCE: lists, folders, shards, hf:OWNER/NAME (docs/your-data.md), or the official folder
            of a published data set under its name: nyu=DIR.
        model: a name of `zoedepth models`, a file or folder of weights, a Hugging Face id, or LABEL=any of them; give
            the option again for more models. With nothing to score it is zoed-lite.
        predictions: NAME=FOLDER with somebody's depth maps (.png, .npy, .npz), found by the photos' names.
        trivial: lists of training data; adds two guesses that never look at the photo: the best constant, and the mean
            depth map.
        protocol: name of a protocol for all data, or DATA=PROTOCOL; see zoedepth.evaluation.protocols.PROTOCOLS.
        crop: part of the true depth that is scored.
        min_depth: nearest depth that is scored, metres.
        max_depth: farthest depth that is scored, metres; predictions are clipped to it.
        flip: average with the prediction for the mirror image.
        pad: reflect the photo's borders outwards before the model.
        resize: keep the photo's proportions, or squeeze it to the trained size (the paper).
        mean: average the metrics over images (the paper), or take them over all pixels.
        align: give the prediction something of the truth first. median: a factor. disparity: scale and shift of its
            inverse.
        compat: behaviours of the original code to take over: batch-vote, 10m.
        out: folder for scores (JSONL), tables (Markdown, LaTeX, JSON), pictures and plots.
        pictures: make the pictures and plots, too.
        with_paper: print the paper's numbers on these data sets below ours.
        device: cpu, cuda, mps, or auto for the best there is.
        json_: print one JSON object for each model and data set, and nothing else.
    """
    from rich.console import Console

    from zoedepth.evaluation.evaluate import evaluate as score_all
    from zoedepth.evaluation.evaluation_set import open_evaluation_set
    from zoedepth.evaluation.report import require_matplotlib

    console = Console(stderr=True, highlight=False)
    pictures = pictures and out is not None
    if pictures:
        require_matplotlib()  # said before models are fetched
    changes = {
        "crop": crop, "min_depth": min_depth, "max_depth": max_depth,
        # All protocols average and none pads: only the other way is a change.
        "flip_average": None if flip else False, "pad": pad or None,
        "resize": resize, "mean": mean, "alignment": align,
    }  # fmt: skip
    changes = {name: value for name, value in changes.items() if value is not None}
    given = named_sources(data)
    chosen = _protocols(protocol, list(given))
    sets = {
        name: open_evaluation_set(source, name=name, protocol=chosen[name], changes=changes)
        for name, source in given.items()
    }
    found = score_all(
        _sources(model, predictions, trivial, sets, compat=compat, device=device),
        sets,
        folder=out,
        pictures=pictures,
        track=lambda indices, description: _track(console, indices, description),
        on_failure=lambda message: console.print(f"failed: {message}", soft_wrap=True, markup=False),
    )
    if found.processes.rank:
        return 0  # the first says how it went: torchrun ends all at the first that fails, and it has yet to report
    if json_:
        for summary in found.summaries:
            print(json.dumps(_record(summary)))
    else:
        _print_tables(found.tables(with_paper=with_paper))
    if out is not None:
        found.write_report(out, command=shlex.join(["zoedepth", *sys.argv[1:]]), with_paper=with_paper)
        console.print(f"Report: {out / 'report.md'}, .tex, .json", soft_wrap=True)
    return 0 if found.complete else 1


def _protocols(wanted: Sequence[str], names: Sequence[str]) -> dict[str, Protocol | None]:
    """Return, for each data set, the protocol given for it, else the one given for all, else None."""
    given = {data: find_protocol(value) for data, _, value in (entry.rpartition("=") for entry in wanted)}
    if unknown := sorted(given.keys() - {*names, ""}):
        raise InputError(f"--protocol is given for {unknown}, but the data is {sorted(names)}: use one of these names")
    return {name: given.get(name) or given.get("") for name in names}


def _sources(
    models: Sequence[str],
    predictions: Sequence[str],
    trivial: Sequence[Path],
    sets: "Mapping[str, EvaluationSet]",
    *,
    compat: Sequence[str],
    device: str,
) -> "dict[str, PredictionSource]":
    """Open everything that is to be scored, by its label."""
    from zoedepth.commands.progress import download_progress
    from zoedepth.evaluation.predictions import TRIVIAL, FolderSource, ModelSource, trivial_sources

    if not (models or predictions or trivial):
        models = ("zoed-lite",)
    names = [(label, value if equals else label) for label, equals, value in (each.partition("=") for each in models)]
    folders = named_paths(tuple(predictions))
    labels = [*(label for label, _ in names), *folders, *(TRIVIAL if trivial else ())]
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(f"two sources are called {label!r}: name them, LABEL=SOURCE")
    found: dict[str, PredictionSource] = {}
    for label, name in names:
        with download_progress() as progress:
            found[label] = ModelSource.load(name, compat=compat, device=device, progress=progress)
    for label, folder in folders.items():
        found[label] = FolderSource(folder)
    if trivial:
        by_domain = {domain: protocol for each in sets.values() for domain, protocol in each.protocols.items()}
        found |= trivial_sources(trivial, by_domain)
    return found


def _track(console: "Console", indices: list[int], description: str) -> Iterable[int]:
    from rich.progress import track

    return track(indices, description=description, console=console, disable=not console.is_terminal)


def _record(summary: "Summary") -> dict:
    """Return the short form for --json; everything is in report.json."""
    metrics = {} if summary.metrics is None else asdict(summary.metrics)
    return {
        "source": summary.source,
        "data": summary.data,
        "protocols": summary.protocols,
        **metrics,
        "images": summary.n_scored,
        "without_truth": summary.n_images - summary.n_scored,
        "failed": summary.n_failed,
        "router": summary.router,
        "alignment": summary.alignment,
    }


def _print_tables(tables: "Sequence[ReportTable]") -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(file=sys.stdout, width=None if sys.stdout.isatty() else 150)
    for table in tables:
        shown = Table(*table.header, title=Text(table.title), title_justify="left")
        for i, row in enumerate(table.rows):
            shown.add_row(*(Text(cell, "bold" if (i, j) in table.best else "") for j, cell in enumerate(row)))
        console.print(shown)
        if table.note:
            console.print(Text(table.note))
