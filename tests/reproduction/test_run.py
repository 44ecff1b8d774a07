"""Units are trained and scored once, and a reproduction that was killed goes on to the same numbers."""

import dataclasses
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.reproduction.conftest import TABLE

from zoedepth.errors import InputError, TrainingError
from zoedepth.reproduction import run
from zoedepth.reproduction.run import FAILED, open_scored, read_result, run_unit
from zoedepth.reproduction.scale import Scale
from zoedepth.reproduction.shown import shown
from zoedepth.reproduction.units import Training, Unit, plan
from zoedepth.train.config import TrainConfig


class Killed(BaseException):
    """The end of the process, which nothing can catch."""


@pytest.fixture
def units(tiny: Scale, data: dict[str, str]) -> list[Unit]:
    return plan(TABLE, tiny, data, seeds=(3,))


def all_results(out: Path, units: list[Unit], data: dict[str, str]) -> str:
    scored = open_scored(data)
    return shown(TABLE, units, [read_result(out, unit, scored) for unit in units]).markdown()


@pytest.mark.usefixtures("random_start")
def test_killed_at_any_moment_it_ends_with_the_same_table(
    tiny: Scale, units: list[Unit], data: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scored, trained = open_scored(data), []
    for name in ("train_relative", "train_metric"):
        before = getattr(run, name)

        def watch(config: TrainConfig, *, before: Callable[..., Path] = before, **rest: object) -> Path:
            trained.append(config.stage)
            return before(config, **rest)

        monkeypatch.setattr(run, name, watch)
    for unit in units:
        run_unit(tmp_path / "whole", unit, scored)
    # The two rows share one pre-training, which is trained once.
    assert trained == ["relative", "metric", "metric"]
    expected = all_results(tmp_path / "whole", units, data)
    assert "not run" not in expected.partition("\n\n")[2].partition("\n\n")[0]

    out = tmp_path / "killed"
    with monkeypatch.context() as patch:  # after the pre-training
        patch.setattr(run, "train_metric", _kill)
        with pytest.raises(Killed):
            run_unit(out, units[0], scored)
    assert read_result(out, units[0], scored) is None
    with monkeypatch.context() as patch:  # in the middle of a training: only an early checkpoint is there
        patch.setattr(run, "evaluate", _kill)
        with pytest.raises(Killed):
            run_unit(out, units[0], scored)
    with monkeypatch.context() as patch:  # while its result is written
        patch.setattr(os, "replace", _kill)
        with pytest.raises(Killed):
            run_unit(out, units[0], scored)
    assert read_result(out, units[0], scored) is None
    assert "not run" in all_results(out, units, data)
    trained.clear()
    for unit in units:
        run_unit(out, unit, scored)
    assert trained == ["metric"]  # that of the second row
    assert all_results(out, units, data) == expected
    trained.clear()
    shutil.move(out, tmp_path / "elsewhere")
    for unit in units:
        run_unit(tmp_path / "elsewhere", unit, scored)
    assert trained == []


def _kill(*_: object, **__: object) -> None:
    raise Killed


def _diverge(*_: object, **__: object) -> None:
    raise TrainingError("the loss is not finite")


@pytest.mark.usefixtures("random_start")
def test_training_that_does_not_converge_is_a_result(
    units: list[Unit], data: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "train_relative", lambda config, **_: tmp_path)
    monkeypatch.setattr(run, "train_metric", _diverge)
    said: list[str] = []
    found = run_unit(tmp_path, units[0], open_scored(data), say=said.append)
    assert found is not None
    assert found.failure == "the loss is not finite"
    monkeypatch.setattr(run, "train_metric", _kill)
    assert run_unit(tmp_path, units[0], open_scored(data)) == found  # it is not tried again
    assert FAILED in all_results(tmp_path, units, data)
    assert any("the loss is not finite" in line for line in said)


@pytest.mark.usefixtures("random_start")
def test_pre_training_that_does_not_converge_is_no_result_of_the_row(
    units: list[Unit], data: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unit = next(each for each in units if each.training and isinstance(each.training.start, Training))
    monkeypatch.setattr(run, "train_relative", _diverge)
    said: list[str] = []
    assert run_unit(tmp_path, unit, open_scored(data), say=said.append) is None
    assert any("base" in line and "the loss is not finite" in line for line in said)
    monkeypatch.setattr(run, "train_relative", _kill)
    with pytest.raises(Killed):  # it is tried again
        run_unit(tmp_path, unit, open_scored(data))


@pytest.mark.usefixtures("random_start")
def test_rows_of_two_tables_that_are_one_training_share_run_and_result(
    units: list[Unit], data: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first has scores on less data than the second asks for."""
    first, scored = units[0], open_scored(data)
    assert first.training is not None
    for name in ("A first", "Z second"):
        found = run_unit(
            tmp_path, dataclasses.replace(first, training=dataclasses.replace(first.training, name=name)), scored
        )
        assert found is not None
        assert found.scores.keys() == scored.keys()
        monkeypatch.setattr(run, "train_metric", _kill)
        scored = open_scored(data | {"kitchen": data["nyu"]})
    assert [path.name[:7] for path in (tmp_path / "results").iterdir()] == ["A-first"]
    assert read_result(tmp_path, first, scored) == found


def test_result_of_another_making_is_not_taken(units: list[Unit], data: dict[str, str], tmp_path: Path) -> None:
    training = units[0].training
    assert training is not None
    path = tmp_path / "results" / f"{training.folder}.json"
    path.parent.mkdir()
    score = {"state": "of other data", "images": 1, "metrics": {"rel": 0.1}}
    values = {"id": training.id, "failure": "", "parameters": 1, "scores": {"nyu": score}}
    path.write_text(json.dumps(values))
    found = read_result(tmp_path, units[0], open_scored(data))
    assert found is not None
    assert found.scores == {}
    path.write_text("{")
    with pytest.raises(InputError, match=r"is not a result.*remove it"):
        read_result(tmp_path, units[0], open_scored(data))


def test_scores_belong_to_the_pairs_that_are_scored(data: dict[str, str], tmp_path: Path) -> None:
    folder = tmp_path / "nyu"
    shutil.copytree(data["nyu"], folder)
    before = open_scored({"nyu": str(folder)})["nyu"].state
    listed = folder / "test.csv"
    listed.write_text(listed.read_text().replace(",1000,", ",500,"))
    assert open_scored({"nyu": str(folder)})["nyu"].state != before
    (folder / "train.csv").unlink()  # what is scored only needs no part to train on
    assert open_scored({"nyu": str(folder)})["nyu"].data.dataset


def test_trainings_belong_to_the_weights_that_they_start_from(
    tiny: Scale, data: dict[str, str], tmp_path: Path
) -> None:
    base = tmp_path / "base.safetensors"

    def ids(content: bytes) -> list[str]:
        base.write_bytes(content)
        units = plan(TABLE, tiny, data, seeds=(3,), bases={"N": str(base)})
        return [unit.training.id for unit in units if unit.training is not None]

    assert len(ids(b"one")) == 2
    assert ids(b"one") == ids(b"one")
    assert not set(ids(b"one")) & set(ids(b"two"))


def test_weights_to_start_from_are_read_once(
    tiny: Scale, data: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    base, read = tmp_path / "base.safetensors", []
    base.write_bytes(b"weights")
    monkeypatch.setattr("zoedepth.reproduction.units.weights_fingerprint", lambda path: read.append(path) or "hash")
    assert len(plan(TABLE, tiny, data, seeds=(3, 4), bases={"N": str(base)})) == 4
    assert read == [base]
