"""Evaluate: score every source of predictions on every data set, and report it. ``zoedepth evaluate`` calls this."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Literal

from zoedepth.checking import doubt_depth
from zoedepth.data.pairs import PairDataset
from zoedepth.datasets.published import PublishedDataset
from zoedepth.errors import InputError
from zoedepth.evaluation.comparison import compared
from zoedepth.evaluation.dataset_scores import Processes, score_dataset, score_files
from zoedepth.evaluation.evaluation_set import EvaluationSet
from zoedepth.evaluation.out_folder import REPORTS, check_folder
from zoedepth.evaluation.paper_numbers import method_rows
from zoedepth.evaluation.plausible import check_predictions
from zoedepth.evaluation.predictions import FolderSource, ModelSource, PredictionSource
from zoedepth.evaluation.report import error_by_depth, examples, require_matplotlib, write_picture, write_report
from zoedepth.evaluation.score_files import ScoreFiles
from zoedepth.evaluation.scoring import Score
from zoedepth.evaluation.summary import Summary, summarise
from zoedepth.evaluation.tables import ReportTable, mri_table, report_tables

_N_DOUBTED = 16  # photos that are looked at for one with a prediction


@dataclass(frozen=True)
class Evaluation:
    """The result of an evaluation, the same in all processes that shared the work, except for ``failures``."""

    summaries: list[Summary]
    """One for each source on each data set: set by set, sources in their order."""
    failures: list[str]
    """One message for each problem that this process met, as ``on_failure`` got them."""
    pictures: dict[str, list[tuple[str, Path]]]
    """Data set → (caption, file) of the pictures that were made."""
    processes: Processes
    """This process among those that shared the work."""

    @property
    def complete(self) -> bool:
        """True where no image failed and every data set had a pixel to score."""
        return all(not summary.n_failed and summary.metrics is not None for summary in self.summaries)

    def tables(
        self, *, with_paper: Literal["best", "all"] | None = None, reference: str | None = None
    ) -> list[ReportTable]:
        """Set the numbers in tables: for each data set the metrics, further measures, and REL by true depth.

        Args:
            with_paper: add rows that the paper has on a data set of this name, and sort all by REL. best: its best
                row, and those of the models that are scored here. all: every row.
            reference: label of a source; adds a table of the mean relative improvements over it, mRI.

        Raises:
            InputError: no source has that label.
        """
        names = {summary.data for summary in self.summaries}
        paper = {name: method_rows(name) for name in names} if with_paper else {}
        found = report_tables(self.summaries, paper, best_only=with_paper == "best")
        return found if reference is None else [*found, mri_table(self.summaries, reference)]

    def write_report(
        self,
        folder: Path,
        *,
        command: str = "",
        with_paper: Literal["best", "all"] | None = None,
        reference: str | None = None,
    ) -> None:
        """Write ``report.md``, ``report.html``, ``report.tex`` and ``report.json``, each whole or not at all.

        If several processes share the work, only the first writes.

        Args:
            folder: the one that was given to ``evaluate``, so that the pictures are found in it.
            command: how the evaluation was started; the report quotes it.
            with_paper: see ``tables``.
            reference: see ``tables``.
        """
        if self.processes.rank == 0:
            tables = self.tables(with_paper=with_paper, reference=reference)
            write_report(folder, self.summaries, tables, command=command, pictures=self.pictures)


def evaluate(
    sources: Mapping[str, PredictionSource],
    data: Mapping[str, EvaluationSet],
    *,
    folder: Path | None = None,
    pictures: bool = False,
    compare: int = 0,
    track: Callable[[list[int], str], Iterable[int]] | None = None,
    on_failure: Callable[[str], None] | None = None,
    on_note: Callable[[str], None] | None = None,
) -> Evaluation:
    """Score every source on every data set.

    With a folder, each score is written as soon as it is there, and the same call goes on where it was interrupted.
    Scores that depend on something that has changed since (weights, photos, depth, settings) are made anew. Under
    ``torchrun`` the processes share the images and meet in the folder; the numbers are the same to the last bit.

    Args:
        sources: label → what predicts: models, folders of depth maps, or your own class with ``predict``.
        data: name → photos with depth and their protocols.
        folder: where the scores are kept, and the pictures; None keeps none.
        pictures: make pictures of the best, the median and the worst image, and plots of the error by depth.
        compare: number of photos of each data set, spread evenly over it, that are shown with all sources side by side.
        track: receives the numbers of the images to score and a description, and yields the numbers, to show progress.
        on_failure: receives a message for each image that fails and each data set that has no pixel to score. The
            others are scored nevertheless.
        on_note: receives a sentence about what is odd, and about scores that are made anew.

    Raises:
        InputError: the folder cannot be written to, or holds something else; the depth maps of a ``FolderSource`` are
            not what they are taken for; or pictures, a comparison or several processes without a folder.
        MissingExtraError: pictures without matplotlib.
    """
    processes = _meet_others(folder)
    if (pictures or compare) and folder is None:
        raise InputError("pictures need a folder to be written to: give one, or pictures=False and compare=0")
    if compare < 0:
        raise InputError(f"compare is {compare}: give the number of photos to show, or 0")
    if pictures:
        require_matplotlib()
    if folder is not None and processes.rank == 0:
        plots = [_plot_name(name) for name in data] if pictures else []
        sheets = [_sheet_name(name) for name in data] if compare else []
        check_folder(folder, [*REPORTS, *plots, *sheets])
    kept = _open_scores(sources, data, folder)
    summaries: list[Summary] = []
    failures: list[str] = []
    shown: dict[str, list[tuple[str, Path]]] = {}

    def fail(message: str) -> None:
        failures.append(message)
        if on_failure is not None:
            on_failure(message)

    def note(message: str) -> None:
        if on_note is not None and processes.rank == 0:
            on_note(message)

    for name, each in data.items() if processes.rank == 0 else ():
        for odd in doubt_depth(each.dataset).named:
            note(f"{name}: {odd}")
    for source in sources.values():
        if not isinstance(source, FolderSource):
            continue
        _check_own_maps(source, data)
        for each in data.values():
            if odd := _doubt(source, each):
                note(odd)
    for name, each in data.items():
        shared = set(range(len(each.dataset)))  # photos that all sources have a score of
        for label, source in sources.items():
            files = kept.get((label, name))
            found = score_dataset(
                source,
                each.dataset,
                each.protocols,
                files=files,
                processes=processes,
                workers=source.workers if isinstance(source, ModelSource) and processes.count == 1 else 1,
                track=partial(_track, track, f"{label} on {name}"),
            )
            if found.n_stale:
                note(
                    f"{label} on {name}: {found.n_stale} images are scored anew, because weights, photos, depth or "
                    "settings have changed since"
                )
            for failure in found.failures:
                fail(f"{name}, {failure}")
            scores = _scores_of_all(found.scores, files, processes)
            shared &= {index for index, score in scores.items() if score.sums is not None}
            n_failed = len(each.dataset) - len(scores)
            about = getattr(source, "about", {})
            summary = summarise(
                label,
                name,
                list(scores.values()),
                each.protocols,
                n_failed=n_failed,
                camera=str(about.get("camera", "none")),
                fast=str(about.get("fast", "")),
            )
            summaries.append(summary)
            if processes.rank == 0 and scores and summary.metrics is None:
                fail(f"{name}: no image has a known pixel under its protocol")
            if processes.rank == 0 and pictures and files is not None:
                sheet = examples(source, each.dataset, scores, each.protocols)
                if sheet is not None:
                    write_picture(files.folder / "examples.png", sheet)
                    caption = f"{label}: best, median and worst image by REL"
                    shown.setdefault(name, []).append((caption, files.folder / "examples.png"))
        if processes.rank == 0 and compare and folder is not None and shared:
            path = folder / _sheet_name(name)
            chosen = _spread_evenly(sorted(shared), compare)
            write_picture(path, compared(sources, each.dataset, chosen, each.protocols))
            caption = "Depth and squared error (blue: none, red: most), side by side; grey: unknown or not scored"
            shown.setdefault(name, []).append((caption, path))
    if processes.rank == 0 and pictures and folder is not None:
        for name in dict.fromkeys(summary.data for summary in summaries):
            path = folder / _plot_name(name)
            error_by_depth([summary for summary in summaries if summary.data == name], path)
            shown.setdefault(name, []).insert(0, (f"{name}: REL by true depth", path))
    return Evaluation(summaries, failures, shown, processes)


def folder_name(text: str) -> str:
    """Turn a label or the name of a data set into the name of its folder: letters, digits, "-", "_" and "."."""
    return "".join(c if c.isalnum() or c in "-_." else "-" for c in text).strip("-.") or "model"


def _plot_name(data: str) -> str:
    return f"{folder_name(data)}-error-by-depth.png"


def _sheet_name(data: str) -> str:
    return f"{folder_name(data)}-compared.png"


def _spread_evenly(indices: list[int], n: int) -> list[int]:
    """Return at most n of the numbers, spread evenly."""
    n = min(n, len(indices))
    return [indices[(2 * i + 1) * len(indices) // (2 * n)] for i in range(n)]


def _track(
    track: Callable[[list[int], str], Iterable[int]] | None, description: str, indices: list[int]
) -> Iterable[int]:
    return indices if track is None else track(indices, description)


def _meet_others(folder: Path | None) -> Processes:
    """Connect to the other processes of torchrun, if there are any."""
    processes = Processes.from_environment()
    if processes.count > 1:
        if folder is None:
            raise InputError("several processes need a folder (--out), where each leaves its scores for the others")
        import torch.distributed as distributed

        if not distributed.is_initialized():
            # Whoever has a slower machine may need hours more for its share than the others, who wait.
            distributed.init_process_group("gloo", timeout=timedelta(days=30))
    return processes


def _open_scores(
    sources: Mapping[str, PredictionSource], data: Mapping[str, EvaluationSet], folder: Path | None
) -> dict[tuple[str, str], ScoreFiles]:
    """Open all files of scores, by source and data set, so that one that is refused is refused before the work."""
    if folder is None:
        return {}
    for names in (sources, data):
        places = [folder_name(name).casefold() for name in names]
        if twice := [name for name, place in zip(names, places, strict=True) if places.count(place) > 1]:
            raise InputError(f"{twice} would share a folder of scores: give one of them another name, NAME=...")
    return {
        (label, name): score_files(
            source,
            each.dataset,
            each.protocols,
            folder / folder_name(label) / folder_name(name),
            about={"source": label, **getattr(source, "about", {}), **each.about},
            state=each.state,
        )
        for name, each in data.items()
        for label, source in sources.items()
    }


def _check_own_maps(source: FolderSource, data: Mapping[str, EvaluationSet]) -> None:
    """Refuse a folder of depth maps in which photos of two data sets would have one map, or where nobody can tell.

    Two photos of one data set are refused one by one, when they are read.
    """
    owners: dict[Path, tuple[str, Path]] = {}  # the first photo of each map
    for name, each in data.items():
        if not isinstance(each.dataset, PairDataset | PublishedDataset):
            if len(data) > 1:
                raise InputError(
                    f"nobody can tell the depth maps of {name} from those of other data sets in {source.folder}, "
                    "because its photos are no files: score it by itself"
                )
            continue
        for index, pair in enumerate(each.dataset.pairs):
            path = source.find(each.dataset.name_of(index))
            if path is None:
                continue
            other, photo = owners.setdefault(path, (name, pair.image))
            if other != name and photo.resolve() != pair.image.resolve():
                raise InputError(
                    f"{path} would be the depth of two photos, {photo} of {other} and {pair.image} of {name}: give "
                    "each data set a folder of predictions, and score them one after the other"
                )


def _doubt(source: FolderSource, data: EvaluationSet) -> str | None:
    """Look at the first photo that has a prediction and known depth, and ask whether the prediction can be right."""
    for index in range(min(len(data.dataset), _N_DOUBTED)):
        try:
            sample = data.dataset[index]
        except InputError:
            continue  # it will fail, and say why
        if sample.domain in data.protocols and sample.mask.any() and source.find(sample.name):
            return check_predictions(source, sample, data.protocols[sample.domain])
    return None


def _scores_of_all(scores: dict[int, Score], files: ScoreFiles | None, processes: Processes) -> dict[int, Score]:
    """Wait for the other processes, then return the scores of all, in the order of the data set."""
    if processes.count == 1 or files is None:
        return scores
    import torch.distributed as distributed

    distributed.barrier()
    return files.read()
