"""Score one source on one data set: a line of JSON for each image, resumable, alone or among processes."""

import os
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import TypeVar

from zoedepth.batch import in_turn
from zoedepth.data.sample import Sample, Samples
from zoedepth.errors import InputError
from zoedepth.evaluation.identity import Stamps
from zoedepth.evaluation.predictions import PredictionSource, predict, prepare
from zoedepth.evaluation.protocols import Protocol
from zoedepth.evaluation.score_files import ScoreFiles
from zoedepth.evaluation.scoring import Score, score
from zoedepth.threads import share_cores


@dataclass(frozen=True)
class Processes:
    """This process among those that share the work, numbered as ``torchrun`` does."""

    rank: int = 0
    count: int = 1

    @classmethod
    def from_environment(cls) -> "Processes":
        """Read the variables that ``torchrun`` sets; without them this process is alone."""
        return cls(int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1")))


@dataclass
class DatasetScores:
    """The scores of one source on one data set."""

    scores: dict[int, Score] = field(default_factory=dict)
    """Number of the image in the data set → its score, in the order of the data set. Images that failed have none."""
    failures: list[str] = field(default_factory=list)
    """One message for each image that could not be read or predicted."""
    n_stale: int = 0
    """Number of kept scores that no longer held, because something they depended on has changed."""


def score_files(
    source: PredictionSource,
    data: Samples,
    protocols: Mapping[str, Protocol],
    folder: Path,
    *,
    about: Mapping[str, object] | None = None,
    state: Mapping[str, object] | None = None,
) -> ScoreFiles:
    """Open the files of scores in a folder.

    Args:
        source: see ``score_dataset``, as for the others.
        data: photos with depth.
        protocols: domain → protocol.
        folder: where the scores are kept.
        about: facts that say which question the scores answer. A folder with other facts is refused.
        state: facts that may change under the same names, such as a hash of settings. Scores made in another state are
            made anew.

    Raises:
        InputError: the folder holds the scores of something else.
    """
    labels = {domain: protocol.label for domain, protocol in sorted(protocols.items())}
    return ScoreFiles(folder, {"about": dict(about or {}), "protocols": labels}, Stamps(source, data, state or {}))


def score_dataset(
    source: PredictionSource,
    data: Samples,
    protocols: Mapping[str, Protocol],
    *,
    files: ScoreFiles | None = None,
    processes: Processes | None = None,
    workers: int = 1,
    track: Callable[[list[int]], Iterable[int]] = iter,
) -> DatasetScores:
    """Score image by image, except those whose score is kept and still holds.

    Args:
        source: predicts each photo.
        data: photos with depth.
        protocols: domain → protocol, for every domain that occurs.
        files: where the scores are kept, a line of JSON each, written one by one; None keeps none.
        processes: if there are several, this one scores its share; the result then has all that was written so far.
        workers: images that are scored at the same time, each by a thread with its share of the cores. The source must
            allow it.
        track: receives the numbers of the images to score and yields them, to show progress.

    Raises:
        InputError: the scores cannot be written.
    """
    processes = processes or Processes()
    done: dict[int, Score] = {}
    if files is not None:
        done = files.read()
        files.open(processes.rank, processes.count)
    failures = []

    one_reader = Lock()  # archives have one position each

    def scored(index: int) -> tuple[int, str | None, Score | InputError]:
        before = None if files is None else files.stamps.of_data(index)  # before anything is read
        try:
            with one_reader:
                sample = data[index]
            return index, before, _score_one(source, sample, protocols)
        except InputError as error:
            return index, before, error

    indices = [index for index in range(processes.rank, len(data), processes.count) if index not in done]
    try:
        with closing(_in_order(scored, indices, workers=workers)) as results:
            for _, (index, before, found) in zip(track(indices), results, strict=True):
                if isinstance(found, InputError):
                    failures.append(f"image {index}: {found}")
                    continue
                done[index] = found
                if files is not None and before is not None:
                    files.add(index, found, before)
    finally:
        if files is not None:
            files.close()
    return DatasetScores(dict(sorted(done.items())), failures, 0 if files is None else files.n_stale)


T = TypeVar("T")


def _in_order(function: Callable[[int], T], indices: list[int], *, workers: int) -> Generator[T, None, None]:
    """Yield the results of a function in order, with so many calls at the same time; at Ctrl-C those in hand, too."""
    if workers < 2:
        yield from map(function, indices)
        return
    with share_cores(workers):
        yield from in_turn(function, indices, workers=workers, ahead=2 * workers)


def _score_one(source: PredictionSource, sample: Sample, protocols: Mapping[str, Protocol]) -> Score:
    if sample.domain not in protocols:
        raise InputError(
            f"no protocol is given for the domain {sample.domain!r} of {sample.name}: add one to {sorted(protocols)}"
        )
    if sample.kind != "depth":
        raise InputError(f"{sample.name} has disparity, which cannot be scored in metres: give depth")
    protocol = protocols[sample.domain]
    shown = prepare(sample, protocol)
    known = shown.mask if protocol.use_mask else shown.target > 0
    if not known.any():
        return Score(sample.name, sample.domain, None, None)
    prediction, shown = predict(source, sample, protocol)
    return score(prediction, shown, protocol)
