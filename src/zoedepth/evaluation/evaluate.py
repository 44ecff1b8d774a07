"""Evaluate: score every source of predictions on every data set, and report it. ``zoedepth evaluate`` calls this."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from zoedepth.errors import InputError
from zoedepth.evaluation.dataset_scores import Processes, read_scores, score_dataset
from zoedepth.evaluation.evaluation_set import EvaluationSet
from zoedepth.evaluation.paper_numbers import method_rows
from zoedepth.evaluation.predictions import PredictionSource
from zoedepth.evaluation.report import error_by_depth, examples, require_matplotlib, write_picture, write_report
from zoedepth.evaluation.scoring import Score
from zoedepth.evaluation.summary import Summary, summarise
from zoedepth.evaluation.tables import ReportTable, report_tables


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

    def tables(self, *, with_paper: bool = False) -> list[ReportTable]:
        """Set the numbers in tables: for each data set the metrics, further measures, and REL by true depth.

        Args:
            with_paper: below the metrics, add the rows that the paper has on a data set of this name.
        """
        names = {summary.data for summary in self.summaries}
        return report_tables(self.summaries, {name: method_rows(name) for name in names} if with_paper else {})

    def write_report(self, folder: Path, *, command: str = "", with_paper: bool = False) -> None:
        """Write ``report.md``, ``report.tex`` and ``report.json``, each whole or not at all.

        If several processes share the work, only the first writes.

        Args:
            folder: the one that was given to ``evaluate``, so that the pictures are found in it.
            command: how the evaluation was started; the report quotes it.
            with_paper: see ``tables``.
        """
        if self.processes.rank == 0:
            tables = self.tables(with_paper=with_paper)
            write_report(folder, self.summaries, tables, command=command, pictures=self.pictures)


def evaluate(
    sources: Mapping[str, PredictionSource],
    data: Mapping[str, EvaluationSet],
    *,
    folder: Path | None = None,
    pictures: bool = False,
    track: Callable[[list[int], str], Iterable[int]] | None = None,
    on_failure: Callable[[str], None] | None = None,
) -> Evaluation:
    """Score every source on every data set.

    With a folder, each score is written as soon as it is there, and the same call goes on where it was interrupted.
    Under ``torchrun`` the processes share the images and meet in the folder; the numbers are the same to the last bit.

    Args:
        sources: label → what predicts: models, folders of depth maps, or your own class with ``predict``.
        data: name → photos with depth and their protocols.
        folder: where the scores are kept, and the pictures; None keeps none.
        pictures: make pictures of the best, the median and the worst image, and plots of the error by depth.
        track: receives the numbers of the images to score and a description, and yields the numbers, to show progress.
        on_failure: receives a message for each image that fails and each data set that has no pixel to score. The
            others are scored nevertheless.

    Raises:
        InputError: the folder holds the scores of something else; or pictures or several processes without a folder.
        MissingExtraError: pictures without matplotlib.
    """
    processes = _meet_others(folder)
    if pictures and folder is None:
        raise InputError("pictures need a folder to be written to: give one, or pictures=False")
    if pictures:
        require_matplotlib()
    summaries: list[Summary] = []
    failures: list[str] = []
    shown: dict[str, list[tuple[str, Path]]] = {}

    def fail(message: str) -> None:
        failures.append(message)
        if on_failure is not None:
            on_failure(message)

    for name, each in data.items():
        for label, source in sources.items():
            place = None if folder is None else folder / folder_name(label) / folder_name(name)
            found = score_dataset(
                source,
                each.dataset,
                each.protocols,
                folder=place,
                about={"source": label, **getattr(source, "about", {}), **each.about},
                processes=processes,
                track=partial(_track, track, f"{label} on {name}"),
            )
            for failure in found.failures:
                fail(f"{name}, {failure}")
            scores = _scores_of_all(found.scores, place, processes)
            n_failed = len(each.dataset) - len(scores)
            summary = summarise(label, name, list(scores.values()), each.protocols, n_failed=n_failed)
            summaries.append(summary)
            if processes.rank == 0 and scores and summary.metrics is None:
                fail(f"{name}: no image has a known pixel under its protocol")
            if processes.rank == 0 and pictures and place is not None:
                sheet = examples(source, each.dataset, scores, each.protocols)
                if sheet is not None:
                    write_picture(place / "examples.png", sheet)
                    caption = f"{label}: best, median and worst image by REL"
                    shown.setdefault(name, []).append((caption, place / "examples.png"))
    if processes.rank == 0 and pictures and folder is not None:
        for name in dict.fromkeys(summary.data for summary in summaries):
            path = folder / f"{folder_name(name)}-error-by-depth.png"
            error_by_depth([summary for summary in summaries if summary.data == name], path)
            shown.setdefault(name, []).insert(0, (f"{name}: REL by true depth", path))
    return Evaluation(summaries, failures, shown, processes)


def folder_name(text: str) -> str:
    """Turn a label or the name of a data set into the name of its folder: letters, digits, "-", "_" and "."."""
    return "".join(c if c.isalnum() or c in "-_." else "-" for c in text).strip("-.") or "model"


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
            distributed.init_process_group("gloo")
    return processes


def _scores_of_all(scores: dict[int, Score], folder: Path | None, processes: Processes) -> dict[int, Score]:
    """Wait for the other processes, then return the scores of all, in the order of the data set."""
    if processes.count == 1 or folder is None:
        return scores
    import torch.distributed as distributed

    distributed.barrier()
    return read_scores(folder)
