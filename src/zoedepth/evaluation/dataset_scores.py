"""Score one source on one data set: a line of JSON for each image, resumable, alone or among processes."""

import json
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from zoedepth.data.sample import Sample, Samples
from zoedepth.errors import InputError
from zoedepth.evaluation.predictions import PredictionSource, prepare
from zoedepth.evaluation.protocols import Protocol
from zoedepth.evaluation.scoring import Score, score


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


def score_dataset(
    source: PredictionSource,
    data: Samples,
    protocols: Mapping[str, Protocol],
    *,
    folder: Path | None = None,
    about: Mapping[str, object] | None = None,
    processes: Processes | None = None,
    track: Callable[[list[int]], Iterable[int]] = iter,
) -> DatasetScores:
    """Score image by image, except those whose score stands in the folder already.

    Args:
        source: predicts each photo.
        data: photos with depth.
        protocols: domain → protocol, for every domain that occurs.
        folder: where the scores are kept, a line of JSON each, written one by one; None keeps none.
        about: facts that the scores belong to, beside the protocols. A folder is used again only if they are the same.
        processes: if there are several, this one scores its share; the result then has all that was written so far.
        track: receives the numbers of the images to score and yields them, to show progress.

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
    failures = []
    try:
        for index in track([i for i in range(processes.rank, len(data), processes.count) if i not in done]):
            try:
                done[index] = _score_one(source, data[index], protocols)
            except InputError as error:
                failures.append(f"image {index}: {error}")
                continue
            if file is not None:
                file.write(json.dumps({"index": index, **done[index].to_json()}) + "\n")
                file.flush()
    finally:
        if file is not None:
            file.close()
    return DatasetScores(dict(sorted(done.items())), failures)


def read_scores(folder: Path) -> dict[int, Score]:
    """Read all scores that processes have written into a folder, as ``DatasetScores.scores``."""
    return dict(sorted(_read(folder, None).items()))


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
    return score(source.predict(shown, protocol), shown, protocol)


def _append_to(path: Path, header: dict) -> TextIO:
    written = path.read_bytes() if path.exists() else b""
    if b"\n" not in written:  # a new file, or one whose process was killed while it wrote the first line
        file = path.open("w", encoding="utf-8")
        file.write(json.dumps(header) + "\n")
    else:
        file = path.open("a", encoding="utf-8")
        if not written.endswith(b"\n"):
            file.write("\n")  # ends the line that a killed process left
    file.flush()
    return file


def _read(folder: Path, header: dict | None) -> dict[int, Score]:
    """Read the scores in a folder by the number of their image; a half-written line is left out."""
    done: dict[int, Score] = {}
    for path in sorted(folder.glob("scores-*-of-*.jsonl")):
        first, *lines = path.read_text(encoding="utf-8").split("\n")
        if not lines:  # another process has just begun this file, or was killed then
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
