"""Score a source of predictions on a data set: one line of JSON an image, resumable, alone or among processes."""

import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

import numpy as np

from zoedepth.data.augment import kitti_crop
from zoedepth.data.sample import Sample, Samples
from zoedepth.errors import InputError
from zoedepth.evaluation.predictions import Prediction, Source
from zoedepth.evaluation.protocols import Protocol
from zoedepth.evaluation.scoring import Score, score


@dataclass(frozen=True)
class Processes:
    """This process among those that share the work, as ``torchrun`` numbers them."""

    rank: int = 0
    count: int = 1

    @classmethod
    def from_environment(cls) -> "Processes":
        """Of ``torchrun``, or alone."""
        return cls(int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1")))


@dataclass
class Results:
    """The scores of one source on one data set."""

    scores: dict[int, Score] = field(default_factory=dict)
    """By the number of the image in the data set, in its order; images that failed have none."""
    failures: list[str] = field(default_factory=list)
    """One message for each image that could not be read or predicted."""


def prepared(sample: Sample, protocol: Protocol) -> Sample:
    """A sample as the protocol shows it to a source, and scores it."""
    return kitti_crop()(sample, np.random.default_rng()) if protocol.kitti_crop else sample


def evaluate(
    source: Source,
    data: Samples,
    protocols: Mapping[str, Protocol],
    *,
    folder: Path | None = None,
    about: Mapping[str, object] | None = None,
    processes: Processes | None = None,
    track: Callable[[list[int]], Iterator[int]] = iter,
) -> Results:
    """Score image by image. What stands in the folder already is not computed again.

    Args:
        source: of predictions.
        data: photos with depth.
        protocols: by the domain of the sample.
        folder: where the scores are kept, one line of JSON each, written as they come; None keeps none.
        about: what the scores belong to, beside the protocols: an interrupted run goes on only if it is the same.
        processes: this one scores its share; the results are those of all that have written so far.
        track: wraps the numbers of the images to be scored, to show progress.

    Raises:
        InputError: the folder holds the scores of something else.
    """
    processes = processes or Processes()
    header = {
        "about": dict(about or {}),
        "protocols": {domain: protocol.label for domain, protocol in sorted(protocols.items())},
        "images": len(data),
    }
    done, file = {}, None
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        done = _read(folder, header)
        file = _append_to(folder / f"scores-{processes.rank}-of-{processes.count}.jsonl", header)
    results = Results()
    try:
        for index in track([i for i in range(processes.rank, len(data), processes.count) if i not in done]):
            try:
                done[index] = _score_one(source, data[index], protocols)
            except InputError as error:
                results.failures.append(f"image {index}: {error}")
                continue
            if file is not None:
                file.write(json.dumps({"index": index, **done[index].to_json()}) + "\n")
                file.flush()
    finally:
        if file is not None:
            file.close()
    results.scores = dict(sorted(done.items()))
    return results


def predict(source: Source, sample: Sample, protocol: Protocol) -> tuple[Prediction, Sample]:
    """A prediction and the sample it is scored against, as ``evaluate`` makes them."""
    shown = prepared(sample, protocol)
    return source.predict(shown, protocol), shown


def read_scores(folder: Path) -> dict[int, Score]:
    """All scores that processes have written into a folder, as in ``Results``."""
    return dict(sorted(_read(folder, None).items()))


def _score_one(source: Source, sample: Sample, protocols: Mapping[str, Protocol]) -> Score:
    if sample.domain not in protocols:
        raise InputError(f"no protocol is given for the domain {sample.domain!r} of {sample.name}")
    if sample.kind != "depth":
        raise InputError(f"{sample.name} has disparity, in which there are no metres to score")
    protocol = protocols[sample.domain]
    shown = prepared(sample, protocol)
    known = shown.mask if protocol.use_mask else shown.target > 0
    if not known.any():
        return Score(sample.name, sample.domain, None, None)
    return score(source.predict(shown, protocol), shown, protocol)


def _append_to(path: Path, header: dict) -> TextIO:
    written = path.read_bytes() if path.exists() else b""
    if b"\n" not in written:  # new, or killed at its first line
        file = path.open("w", encoding="utf-8")
        file.write(json.dumps(header) + "\n")
    else:
        file = path.open("a", encoding="utf-8")
        if not written.endswith(b"\n"):
            file.write("\n")  # the last line of a killed run
    file.flush()
    return file


def _read(folder: Path, header: dict | None) -> dict[int, Score]:
    """The scores in a folder by the number of their image; a half-written last line is left out."""
    done: dict[int, Score] = {}
    for path in sorted(folder.glob("scores-*-of-*.jsonl")):
        first, *lines = path.read_text(encoding="utf-8").split("\n")
        if not lines:  # another process has just begun it, or was killed then
            continue
        if header is not None and _parse(first) != json.loads(json.dumps(header)):
            raise InputError(
                f"{path} holds scores of another model, data set or protocol: give another --out, or remove it. "
                f"There: {first[:300]}"
            )
        for line in lines:
            if (record := _parse(line)) is not None:
                index = record.pop("index")
                done[index] = Score.from_json(record)
    return done


def _parse(line: str) -> dict | None:
    try:
        return json.loads(line)
    except ValueError:
        return None
