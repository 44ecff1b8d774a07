"""The log: a line of JSON for each logged step, speeds without the time of validation, and a console on stderr."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.train.config import TrainConfig
from zoedepth.train.log import Log

MakeConfig = Callable[..., TrainConfig]


def lines_of(folder: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def test_lines_of_later_steps_and_cut_off_lines_are_dropped_on_resuming(
    make_config: MakeConfig, tmp_path: Path
) -> None:
    config = make_config(steps=9)
    with Log(tmp_path, config, first_step=0, active=True) as log:
        for step in range(1, 6):
            log.write(step, {"train/loss": step / 8})
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write('{"step": 2, "train/lo')  # killed while writing
    with Log(tmp_path, config, first_step=3, active=True) as log:
        log.write(4, {"train/loss": 44.0})
    found = [(line["step"], line["train/loss"]) for line in lines_of(tmp_path)]
    assert found == [(1, 0.125), (2, 0.25), (3, 0.375), (4, 44.0)]


def test_processes_but_the_first_write_nothing(
    make_config: MakeConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Log(tmp_path / "run", make_config(), first_step=0, active=False) as log:
        log.say("hello")
        log.write(1, {"train/loss": 1.0})
        log.picture(1, np.zeros((8, 8, 3), np.uint8))
    assert not (tmp_path / "run").exists()
    captured = capsys.readouterr()
    assert captured.out + captured.err == ""


def test_speed_and_waiting_are_those_of_training_alone(
    make_config: MakeConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("zoedepth.train.log.monotonic", lambda: now)
    with Log(tmp_path, make_config(batch_size=6), first_step=10, active=True) as log:
        now += 4
        log.write(12, {}, waited=1.0)
        with log.paused():
            now += 1000
            log.write(12, {"validation/rel": 0.5})
        now += 3
        log.write(13, {}, waited=0.75)
    first, validation, second = lines_of(tmp_path)
    assert (first["images_per_s"], first["data_wait"]) == (2 * 6 / 4, 0.25)
    assert validation == {"step": 12, "validation/rel": 0.5}
    assert (second["images_per_s"], second["data_wait"]) == (6 / 3, 0.25)


def test_pictures_are_files_and_in_tensorboard(make_config: MakeConfig, tmp_path: Path) -> None:
    with Log(tmp_path, make_config(), first_step=0, active=True) as log:
        log.picture(7, np.full((20, 30, 3), 200, np.uint8))
    with Image.open(tmp_path / "pictures/step_000007.jpg") as picture:
        assert picture.size == (30, 20)
        assert np.asarray(picture).mean() == pytest.approx(200, abs=2)
    (events,) = (tmp_path / "tensorboard").iterdir()
    content = events.read_bytes()
    assert b"predictions" in content
    assert b"PNG" in content


def test_numbers_are_in_tensorboard_by_name(make_config: MakeConfig, tmp_path: Path) -> None:
    with Log(tmp_path, make_config(), first_step=0, active=True) as log:
        log.write(1, {"train/silog": 0.5}, waited=0.0)
    (events,) = (tmp_path / "tensorboard").iterdir()
    content = events.read_bytes()
    assert all(name in content for name in (b"train/silog", b"speed/images_per_s", b"speed/data_wait"))


def test_tensorboard_forgets_later_steps_on_resuming(make_config: MakeConfig, tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    with Log(tmp_path, make_config(), first_step=0, active=True) as log:
        for step in range(1, 6):
            log.write(step, {"train/loss": 1.0})
    with Log(tmp_path, make_config(), first_step=3, active=True) as log:
        log.write(4, {"train/loss": 44.0})
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    found = [(event.step, event.value) for event in events.Scalars("train/loss")]
    assert found == [(1, 1), (2, 1), (3, 1), (4, 44)]


def test_console_says_the_numbers_but_the_rates_and_keeps_stdout_for_results(
    make_config: MakeConfig, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with Log(tmp_path, make_config(), first_step=0, active=True) as log:
        log.say("metric from [nothing]: steps 0 to 4")
        log.write(1, {"train/silog": 0.123456789, "rate/head": 0.001})
    said = capfd.readouterr()
    assert said.out == ""
    assert "metric from [nothing]: steps 0 to 4" in said.err
    assert "step 1: silog=0.1235" in said.err
    assert "rate" not in said.err


def test_numbers_that_are_not_finite_are_written_down_and_can_be_read_again(
    make_config: MakeConfig, tmp_path: Path
) -> None:
    with Log(tmp_path, make_config(), first_step=0, active=True) as log:
        log.write(1, {"train/gradient_norm": math.inf})
    with Log(tmp_path, make_config(), first_step=1, active=True):
        pass
    assert lines_of(tmp_path) == [{"step": 1, "train/gradient_norm": math.inf}]
