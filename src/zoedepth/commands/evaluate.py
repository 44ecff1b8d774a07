"""``zoedepth evaluate --model MODEL --data NAME=CSV ... --out DIR``."""

import hashlib
import json
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from zoedepth.commands.data import named_paths, named_sources
from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import PROTOCOLS, Protocol, find_protocol, protocol_of

if TYPE_CHECKING:
    from rich.console import Console

    from zoedepth.data.sample import DepthDataset
    from zoedepth.evaluation.evaluate import Processes
    from zoedepth.evaluation.predictions import Source
    from zoedepth.evaluation.scoring import Score
    from zoedepth.evaluation.summary import Summary, Table


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

    A published data set in its official folder has the paper's protocol. That of other data follows from its domain:
    indoor is NYU's (Eigen crop, 10 m), outdoor KITTI's (KB crop, then Garg crop, 80 m), any other has no crop. Every
    result carries the name and the hash of its protocol. Under torchrun the processes share the images. An interrupted
    run with --out goes on when the command is typed again.

    Args:
        data: SOURCE or NAME=SOURCE: lists, folders, shards, hf:OWNER/NAME (docs/your-data.md), or the official folder
            of a published data set under its name: nyu=DIR.
        model: a name of `zoedepth models`, a file or folder of weights, a Hugging Face id, or LABEL=any of them; give
            the option again for more models. None, and nothing else to score: zoed-lite.
        predictions: NAME=FOLDER with somebody's depth maps (.png, .npy, .npz), found by the photos' names.
        trivial: CSV files of training data; adds what can be said without looking at a photo: the best constant, and
            the mean depth map.
        protocol: name of a protocol for all data, or DATA=PROTOCOL; see zoedepth.evaluation.protocols.PROTOCOLS.
        crop: part of the true depth that is scored.
        min_depth: nearest depth that is scored, metres.
        max_depth: cap, metres.
        flip: average with the prediction for the mirror image.
        pad: reflect the photo's borders outwards before the model.
        resize: keep the photo's proportions, or squeeze it to the trained size (the paper).
        mean: of metrics over images (the paper), or over all pixels.
        align: median or disparity: give the prediction a factor, or scale and shift of its inverse, from the truth.
        compat: behaviours of the original code to take over: batch-vote, 10m.
        out: folder for scores (JSONL), tables (Markdown, LaTeX, JSON), pictures and plots.
        pictures: also the pictures and plots.
        with_paper: print what the paper published on these data sets beside it.
        device: cpu, cuda, mps, or auto for the best there is.
        json_: print one JSON object for each model and data set, and nothing else.
    """
    from rich.console import Console
    from rich.table import Table as RichTable
    from rich.text import Text

    from zoedepth.evaluation.evaluate import Processes
    from zoedepth.evaluation.evaluate import evaluate as score_all
    from zoedepth.evaluation.report import require_matplotlib, tables
    from zoedepth.evaluation.summary import summarise

    console = Console(stderr=True, highlight=False)
    changes = {
        "crop": crop, "min_depth": min_depth, "max_depth": max_depth,
        # All protocols average and none pads: only the other way is a change.
        "flip_average": None if flip else False, "pad": pad or None,
        "resize": resize, "mean": mean, "alignment": align,
    }  # fmt: skip
    changes = {name: value for name, value in changes.items() if value is not None}
    if out is not None and pictures:
        require_matplotlib()
    processes = _join(Processes.from_environment(), out)
    given = named_sources(data)
    sets = {name: _open(name, source, use_masks=_uses_masks(name, protocol)) for name, source in given.items()}
    protocols = _protocols(sets, protocol, changes)
    sources = _sources(model, predictions, trivial, protocols, compat=compat, device=device)
    summaries: list[Summary] = []
    pictured: dict[str, list[tuple[str, Path]]] = {}
    failed = False
    for name, dataset in sets.items():
        for label, (source, about) in sources.items():
            folder = None if out is None else out / _slug(label) / _slug(name)
            results = score_all(
                source,
                dataset,
                protocols[name],
                folder=folder,
                about={"source": label, **about, "data": given[name], "list": _content(given[name])},
                processes=processes,
                track=lambda indices, label=label, name=name: _track(console, indices, f"{label} on {name}"),
            )
            for failure in results.failures:
                console.print(f"failed: {name}, {failure}", soft_wrap=True, markup=False)
            scores = _meet(results.scores, folder, processes)
            n_failed = len(dataset) - len(scores)
            summary = summarise(label, name, list(scores.values()), protocols[name], n_failed=n_failed)
            failed = failed or n_failed > 0 or summary.metrics is None
            if processes.rank:
                continue
            summaries.append(summary)
            if scores and summary.metrics is None:
                problem = f"failed: {name}: no image has a known pixel under its protocol"
                console.print(problem, soft_wrap=True, markup=False)
            if out is not None and folder is not None and pictures:
                pictured.setdefault(name, []).extend(_examples(source, dataset, scores, protocols[name], label, folder))
    if processes.rank:
        return 0  # the first says how it went: torchrun ends all at the first that fails, and it has yet to report
    if json_:
        for summary in summaries:
            print(json.dumps(_record(summary)))
    published = _published(sets, protocols) if with_paper else {}
    found = tables(summaries, published)
    if out is not None:
        _write_report(out, summaries, found, pictured, pictures=pictures)
    if not json_:
        wide = Console(file=sys.stdout, width=None if sys.stdout.isatty() else 150)
        for table in found:
            shown = RichTable(*table.header, title=Text(table.title), title_justify="left")
            for i, row in enumerate(table.rows):
                shown.add_row(*(Text(cell, "bold" if (i, j) in table.best else "") for j, cell in enumerate(row)))
            wide.print(shown)
            if table.note:
                wide.print(Text(table.note))
    if out is not None:
        console.print(f"Report: {out / 'report.md'}, .tex, .json", soft_wrap=True)
    return 1 if failed else 0


def _uses_masks(name: str, wanted: Sequence[str]) -> bool:
    """Whether the protocol of a data set goes by the set's own masks."""
    given = {data: find_protocol(value) for data, _, value in (entry.rpartition("=") for entry in wanted)}
    chosen = given.get(name) or given.get("")
    return chosen is None or chosen.use_mask


def _open(name: str, source: str, *, use_masks: bool) -> "DepthDataset":
    from zoedepth.opening import open_dataset

    dataset = open_dataset(source, name=name, split="test", allow_missing=True, use_masks=use_masks)
    if "disparity" in dataset.kinds:
        raise InputError(f"{source} has disparity, in which there are no metres to score")
    return dataset


def _content(source: str) -> str | None:
    """What tells one list of photos from another of the same name; None where there is no list."""
    path = Path(source)
    found = path / "test.csv" if path.is_dir() else path
    return _fingerprint(found) if found.is_file() else None


def _protocols(
    sets: "Mapping[str, DepthDataset]", wanted: Sequence[str], changes: Mapping[str, Any]
) -> dict[str, dict[str, Protocol]]:
    """Data set → domain → protocol. The one given for a data set goes before the one for all, and that before the
    paper's for a published set in its official folder."""
    from zoedepth.datasets.published import PublishedDataset

    given = {data: find_protocol(value) for data, _, value in (entry.rpartition("=") for entry in wanted)}
    if unknown := sorted(given.keys() - sets.keys() - {""}):
        raise InputError(f"--protocol is given for {unknown}; the data is {sorted(sets)}")
    found = {}
    for name, dataset in sets.items():
        chosen = given.get(name) or given.get("")
        chosen = chosen or (PROTOCOLS.get(name) if isinstance(dataset, PublishedDataset) else None)
        used = {domain: chosen or protocol_of(domain) for domain in dataset.domains}
        found[name] = {domain: replace(protocol, **changes) for domain, protocol in used.items()}
    return found


def _sources(
    models: Sequence[str],
    predictions: Sequence[str],
    trivial: Sequence[Path],
    protocols: Mapping[str, dict[str, Protocol]],
    *,
    compat: Sequence[str],
    device: str,
) -> "dict[str, tuple[Source, dict[str, object]]]":
    """Label → source, and what its scores depend on."""
    from zoedepth.evaluation.predictions import ConstantSource, FolderSource, MeanMapSource, ModelSource
    from zoedepth.opening import open_dataset
    from zoedepth.predict import Predictor
    from zoedepth.weights.load import find, load_model

    found: dict[str, tuple[Source, dict[str, object]]] = {}

    def add(label: str, source: "Source", about: dict[str, object]) -> None:
        if label in found:
            raise InputError(f"two sources are called {label!r}: name them, LABEL=SOURCE")
        found[label] = (source, about)

    if not (models or predictions or trivial):
        models = ("zoed-lite",)
    for entry in models:
        label, equals, value = entry.partition("=")
        value = value if equals else label
        network = load_model(value, compat=compat)
        network = Predictor(network, device=device).model
        add(label, ModelSource(network), {"weights": _fingerprint(find(value)), "compat": list(compat)})
    for label, folder in named_paths(tuple(predictions)).items():
        add(label, FolderSource(folder), {"folder": str(folder)})
    if trivial:
        by_domain = {domain: protocol for used in protocols.values() for domain, protocol in used.items()}
        training = [open_dataset(path, split="train") for path in trivial]
        names = {str(path): _content(str(path)) for path in trivial}
        for label, kind in (("best constant", ConstantSource), ("mean depth map", MeanMapSource)):
            samples = (sample for dataset in training for sample in _samples(dataset, by_domain))
            add(label, kind(samples, by_domain), {"training": names})
    return found


def _samples(dataset: "DepthDataset", protocols: Mapping[str, Protocol]) -> Iterator:
    """Training samples of the domains that are evaluated."""
    if not set(dataset.domains) & protocols.keys():
        return
    for index in range(len(dataset)):
        sample = dataset[index]
        if sample.kind == "depth" and sample.domain in protocols:
            yield sample


def _fingerprint(path: Path) -> str:
    """What tells one file of weights, or list, from another."""
    file = path / "model.safetensors" if path.is_dir() else path
    digest = hashlib.sha256()
    with file.open("rb") as opened:
        while chunk := opened.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()[:16]


def _track(console: "Console", indices: list[int], description: str) -> Iterator[int]:
    from rich.progress import track

    return iter(track(indices, description=description, console=console, disable=not console.is_terminal))


def _join(processes: "Processes", out: Path | None) -> "Processes":
    """Meet the other processes of torchrun, if there are any."""
    if processes.count > 1:
        if out is None:
            raise InputError("several processes need --out, where they leave their scores")
        import torch.distributed as distributed

        if not distributed.is_initialized():
            distributed.init_process_group("gloo")
    return processes


def _meet(scores: "dict[int, Score]", folder: Path | None, processes: "Processes") -> "dict[int, Score]":
    """The scores of all processes, in the order of the data set."""
    if processes.count == 1 or folder is None:
        return scores
    import torch.distributed as distributed

    from zoedepth.evaluation.evaluate import read_scores

    distributed.barrier()
    return read_scores(folder)


def _examples(
    source: "Source",
    dataset: "DepthDataset",
    scores: "dict[int, Score]",
    protocols: Mapping[str, Protocol],
    label: str,
    folder: Path,
) -> list[tuple[str, Path]]:
    from zoedepth.evaluation.report import examples, write_picture

    picture = examples(source, dataset, scores, protocols)
    if picture is None:
        return []
    write_picture(folder / "examples.png", picture)
    return [(f"{label}: best, median and worst image by REL", folder / "examples.png")]


def _write_report(
    out: Path,
    summaries: "list[Summary]",
    found: "list[Table]",
    pictured: dict[str, list[tuple[str, Path]]],
    *,
    pictures: bool,
) -> None:
    from zoedepth.evaluation.report import error_by_depth, write_report

    if pictures:
        for name in dict.fromkeys(summary.data for summary in summaries):
            path = out / f"{_slug(name)}-error-by-depth.png"
            error_by_depth([summary for summary in summaries if summary.data == name], path)
            pictured.setdefault(name, []).insert(0, (f"{name}: REL by true depth", path))
    command = shlex.join(["zoedepth", *sys.argv[1:]])
    write_report(out, summaries, found, command=command, pictures=pictured)


def _record(summary: "Summary") -> dict:
    """The short form for --json; the whole is in report.json."""
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


def _published(sets: Mapping[str, object], protocols: Mapping[str, dict[str, Protocol]]) -> dict:
    from zoedepth.evaluation.published import method_rows

    return {name: method_rows(name) for name in sets}


def _slug(text: str) -> str:
    """A name that is a folder's, whatever was typed."""
    return "".join(c if c.isalnum() or c in "-_." else "-" for c in text).strip("-.") or "model"
