"""Run the units of a reproduction: train, score, and keep each result under what it is a result of."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from zoedepth import __version__
from zoedepth.errors import InputError, TrainingError
from zoedepth.evaluation.evaluate import evaluate
from zoedepth.evaluation.evaluation_set import EvaluationSet, open_evaluation_set
from zoedepth.evaluation.predictions import ModelSource
from zoedepth.forward.tensors import on_device
from zoedepth.images import atomic_path
from zoedepth.reproduction.units import Training, Unit, content_of
from zoedepth.stored import to_json
from zoedepth.train.metric import train_metric
from zoedepth.train.relative import train_relative
from zoedepth.train.state import checkpoints
from zoedepth.weights.fingerprint import fingerprint, weights_fingerprint
from zoedepth.weights.load import load_network

FAILED = "did not converge"
"""Words in a table where a training ended in numbers that are not finite."""


@dataclass(frozen=True)
class Result:
    """The findings about a unit."""

    scores: Mapping[str, Mapping[str, float] | None]
    """Data set → metrics; None where nothing could be scored."""
    failure: str = ""
    """Why the training ended without a model; empty where it has one."""
    n_parameters: int | None = None


@dataclass(frozen=True)
class Scored:
    """A data set to score on, and what tells its scores from those of another."""

    data: EvaluationSet
    state: str
    content: str
    """See ``content_of``."""


def open_scored(data: Mapping[str, str]) -> dict[str, Scored]:
    """Open the data sets to score on, under the paper's protocols where they are published ones, else by domain.

    Raises:
        InputError: one cannot be opened.
    """
    found = {}
    for name, source in data.items():
        opened = open_evaluation_set(source, name=name)
        labels = {domain: protocol.label for domain, protocol in sorted(opened.protocols.items())}
        content = content_of(opened.dataset, source)
        found[name] = Scored(opened, fingerprint([labels, len(opened.dataset), content]), content)
    return found


def read_result(out: Path, unit: Unit, scored: Mapping[str, Scored]) -> Result | None:
    """Return what has been found of a unit, under these protocols and on this data; None for nothing.

    Args:
        out: folder of the reproduction.
        unit: the unit.
        scored: the data sets to score on. Scores on others are left out.
    """
    if unit.training is None:
        return None
    kept = _read(out, unit.training)
    if kept is None:
        return None
    scores = {
        name: kept["scores"][name]["metrics"]
        for name, each in scored.items()
        if name in kept["scores"] and kept["scores"][name]["state"] == each.state
    }
    return Result(scores, kept["failure"], kept["parameters"])


class _BaseError(TrainingError):
    """Error of the pre-training that a row starts from."""


def run_unit(
    out: Path,
    unit: Unit,
    scored: Mapping[str, Scored],
    *,
    device: str = "auto",
    say: Callable[[str], None] = lambda text: None,
    track: Callable[[list[int], str], Any] | None = None,
) -> Result | None:
    """Train and score a unit, as far as that has not been done. Whatever is finished is kept, at every moment.

    Args:
        out: folder of the reproduction: ``results`` with a file for each training, ``runs`` with the trainings.
        unit: the unit.
        scored: the data sets to score on.
        device: cpu, cuda, mps, or auto for the best there is; where it is scored.
        say: receives a line about what is done.
        track: see ``zoedepth.evaluation.evaluate.evaluate``.

    Returns:
        None if the unit cannot be trained: data is missing, or the pre-training that it starts from did not converge.

    Raises:
        InputError: the data cannot be read, or ``out`` holds something else.
    """
    if unit.training is None:
        return None
    training = unit.training
    with _alone(out, training):
        found = read_result(out, unit, scored)
        if found is not None and (found.failure or found.scores.keys() >= scored.keys()):
            return found
        try:
            model = _trained(out, training, say)
        except _BaseError as error:  # the row was not tried, and is tried again by the next command
            say(str(error))
            return None
        except TrainingError as error:
            _write(out, training, {}, failure=str(error))
            say(f"{training.name}: {FAILED}: {error}")
            return read_result(out, unit, scored)
        say(f"{training.name}, seed {unit.seed}: scored on {', '.join(scored)}")
        # Known by its training and not by its path: the folder may be moved.
        network = on_device(load_network(model), device)
        source = ModelSource(network, about={"training": training.id}, weights=weights_fingerprint(model))
        measured = evaluate(
            {"model": source},
            {name: each.data for name, each in scored.items()},
            folder=_kept(out / "runs", training) / "scores",
            track=track,
            on_failure=say,
        )
        if failures := [summary for summary in measured.summaries if summary.n_failed]:
            raise InputError(
                f"{failures[0].n_failed} images of {failures[0].data} could not be scored, so that there is no number: "
                "repair the data (zoedepth data check), and type the same command again"
            )
        scores = {
            summary.data: {
                "state": scored[summary.data].state,
                "images": summary.n_scored,
                "metrics": None if summary.metrics is None else asdict(summary.metrics),
            }
            for summary in measured.summaries
        }
        n_parameters = sum(parameter.numel() for parameter in network.parameters())
        _write(out, training, scores, n_parameters=n_parameters)
        return read_result(out, unit, scored)


def _trained(out: Path, training: Training, say: Callable[[str], None]) -> Path:
    """Return the last checkpoint of a training, which is trained, or gone on with, where it is not finished."""
    start = training.start
    if isinstance(start, Training):
        with _alone(out, start):
            try:
                init = str(_trained(out, start, say))
            except TrainingError as error:
                raise _BaseError(
                    f"{start.name}, seed {start.config.seed}, from which {training.name} starts: {FAILED}: {error}"
                ) from error
    else:
        init = start
    folder = _kept(out / "runs", training)
    done = checkpoints(folder)
    if done and done[-1].name == f"step_{training.config.steps:06d}":
        return done[-1]
    say(f"{training.name}, seed {training.config.seed}: {training.config.steps} steps, in {folder}")
    train = train_relative if training.config.stage == "relative" else train_metric
    return train(training.config, data=training.data, out=folder, init=init, devices=1)


@contextmanager
def _alone(out: Path, training: Training) -> Iterator[None]:
    """Wait until no other command works on this training, and keep others from it. The lock goes with the process."""
    from filelock import FileLock

    folder = out / "runs"
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / f".{training.id}.lock"):
        yield


def _kept(folder: Path, training: Training, suffix: str = "") -> Path:
    """Return where a training is kept. Rows of several tables may be one training, which has the name of the first."""
    found = sorted(folder.glob(f"*-{training.id}{suffix}"))
    return found[0] if found else folder / f"{training.folder}{suffix}"


def _read(out: Path, training: Training) -> dict[str, Any] | None:
    path = _kept(out / "results", training, ".json")
    if not path.exists():
        return None
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["id"] != training.id or not isinstance(kept["scores"], dict):
            raise ValueError("it is of another training")
        _ = kept["failure"], kept["parameters"], [(each["state"], each["metrics"]) for each in kept["scores"].values()]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path} is not a result of a reproduction ({error}): remove it, and it is made anew"
        ) from None
    return kept


def _write(
    out: Path,
    training: Training,
    scores: Mapping[str, Any],
    *,
    failure: str = "",
    n_parameters: int | None = None,
) -> None:
    before = _read(out, training)
    kept = {} if before is None else before["scores"]
    values = {
        "zoedepth": __version__,
        "id": training.id,
        "name": training.name,
        "seed": training.config.seed,
        "before": [each.id for each in training.chain()[:-1]],
        "parameters": n_parameters,
        "failure": failure,
        "scores": {**kept, **scores},
    }
    with atomic_path(_kept(out / "results", training, ".json")) as part:
        part.write_text(to_json(values, indent=2) + "\n", encoding="utf-8")
