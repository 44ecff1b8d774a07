"""After a step: what is logged, validated, drawn and saved, and when."""

import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.folders import write_pairs
from tests.train.runs import log_of

from zoedepth.errors import Terminated
from zoedepth.train import report as module
from zoedepth.train.report import report
from zoedepth.train.run import Run
from zoedepth.train.state import checkpoints

StartRun = Callable[..., Run]
_WHITE = np.full((8, 8, 3), 255, np.uint8)


def take(run: Run, steps: int) -> None:
    """Report steps that change nothing but their number."""
    batch = next(run.batches)
    for _ in range(steps):
        run.state.step += 1
        report(run, {"silog": run.state.step / 8}, batch)


def test_each_comes_at_its_steps_and_at_the_end(start_run: StartRun) -> None:
    run = start_run(
        steps=7, log_every=2, checkpoint_every=3, validate_every=4, holdout=1, pictures=1, keep_checkpoints=9
    )
    take(run, 7)
    lines = log_of(run.out)
    training = [line for line in lines if "train/silog" in line]
    assert [(line["step"], line["train/silog"]) for line in training] == [(2, 0.25), (4, 0.5), (6, 0.75), (7, 0.875)]
    assert [line["step"] for line in lines if "validation/indoor/rel" in line] == [4, 7]
    assert [path.name for path in checkpoints(run.out)] == ["step_000003", "step_000006", "step_000007"]
    assert sorted(path.name for path in (run.out / "pictures").iterdir()) == ["step_000004.jpg", "step_000007.jpg"]


def test_training_lines_have_rates_and_speeds(start_run: StartRun) -> None:
    run = start_run()
    take(run, 1)
    (line,) = log_of(run.out)
    assert {name for name in line if name.startswith("rate/")} == {
        "rate/encoder", "rate/position", "rate/decoder", "rate/head",
    }  # fmt: skip
    assert line["rate/head"] == run.config.optim.learning_rate
    assert line["images_per_s"] > 0
    assert 0 < line["data_wait"] <= 1
    assert run.batches.take_waited() == 0, "waiting is counted from one line to the next"


def test_validation_is_that_of_the_moving_average(start_run: StartRun, monkeypatch: pytest.MonkeyPatch) -> None:
    models = []
    monkeypatch.setattr(module, "validate", lambda model, data, *, stage: models.append((model, stage)) or {})
    run = start_run(holdout=1, steps=1, ema_decay=0.5)
    take(run, 1)
    assert models == [(run.state.ema.module, "metric")]


def test_nothing_is_drawn_or_validated_where_nothing_is_wanted(start_run: StartRun) -> None:
    run = start_run(steps=1)
    take(run, 1)
    assert not (run.out / "pictures").exists()
    assert len(log_of(run.out)) == 1


@pytest.mark.parametrize(("holdout", "expected"), [(0, ["batch"] * 2), (2, ["held out"] * 2), (1, ["held out"])])
def test_pictures_show_held_out_photos_or_else_those_of_the_batch(
    start_run: StartRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, holdout: int, expected: list[str]
) -> None:
    shown = []
    draw = module.predictions_sheet
    monkeypatch.setattr(
        module,
        "predictions_sheet",
        lambda model, samples, *, stage: shown.extend(samples) or draw(model, samples, stage=stage),
    )
    run = start_run(data={"indoor": write_pairs(tmp_path / "rooms", n=5)}, steps=1, holdout=holdout, pictures=2)
    take(run, 1)
    held_out = [f"train_{i:03d}.jpg" for i in range(5 - holdout, 5)]
    found = ["held out" if Path(sample.name).name in held_out else "batch" for sample in shown]
    assert found == expected
    assert all(sample.domain == "indoor" for sample in shown)
    with Image.open(run.out / "pictures/step_000001.jpg") as picture:
        width, height = picture.size
    # A row a sample, of three panels that are 320 pixels wide.
    assert 3 * 320 < width < 4 * 320
    assert len(expected) * 200 < height < (len(expected) + 1) * 320


def test_pictures_are_spread_over_the_data_sets(
    start_run: StartRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = []
    monkeypatch.setattr(module, "validate", lambda *_, **__: {})
    monkeypatch.setattr(module, "predictions_sheet", lambda model, samples, *, stage: shown.extend(samples) or _WHITE)
    both = {name: write_pairs(tmp_path / name, n=3, domain=name) for name in ("indoor", "outdoor")}
    take(start_run(data=both, steps=1, holdout=2, pictures=2), 1)
    assert [sample.domain for sample in shown] == ["indoor", "outdoor"]


def test_a_run_that_is_asked_to_end_saves_its_step_first(start_run: StartRun) -> None:
    run = start_run(steps=9, checkpoint_every=100)
    take(run, 1)
    assert checkpoints(run.out) == []
    signal.raise_signal(signal.SIGTERM)
    with pytest.raises(Terminated, match="step 2 is saved; the same command goes on from there"):
        take(run, 1)
    assert [path.name for path in checkpoints(run.out)] == ["step_000002"]


def test_a_run_that_is_asked_to_end_at_its_last_step_has_finished_and_says_so(start_run: StartRun) -> None:
    """Its caller may have another stage to train, or a model to score."""
    run = start_run(steps=1)
    signal.raise_signal(signal.SIGTERM)
    with pytest.raises(Terminated, match="step 1 is saved"):
        take(run, 1)
    assert [path.name for path in checkpoints(run.out)] == ["step_000001"]


def test_checkpoints_say_what_data_they_are_of(start_run: StartRun) -> None:
    run = start_run(steps=1)
    take(run, 1)
    assert '"indoor"' in (run.out / "step_000001/meta.json").read_text()
