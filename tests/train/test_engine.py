"""What a run promises beside its losses: accumulation, checkpointing, signals, speeds and pictures in the log."""

import dataclasses
import json
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from PIL import Image

from zoedepth.data.sample import Batch
from zoedepth.train.config import OptimConfig, TrainConfig
from zoedepth.train.loop import Run
from zoedepth.train.metric import train_metric
from zoedepth.train.relative import train_relative
from zoedepth.train.state import checkpoints

MakeConfig = Callable[..., TrainConfig]
Data = dict[str, Path]

PLAIN = {"batch_size": 4, "steps": 2, "ema_decay": None, "checkpoint_every": 1}
# AdamW's first steps are signs of gradients, which turn the last digit into a whole step.
CALM = OptimConfig(learning_rate=1e-3, encoder_factor=1.0, warmup=0.3, clip=1.0, eps=1.0)


def weights_of(checkpoint: Path) -> dict[str, torch.Tensor]:
    return torch.load(checkpoint / "train.pt", weights_only=True)["model"]


@pytest.fixture
def steps_seen(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The number of images of each batch that went through ``learn``."""
    seen: list[int] = []
    learn = Run.learn

    def spy(self: Run, loss: torch.Tensor, batch: Batch, numbers: dict[str, float]) -> None:
        seen.append(len(batch.names))
        learn(self, loss, batch, numbers)

    monkeypatch.setattr(Run, "learn", spy)
    return seen


def test_accumulated_step_is_that_of_the_whole_batch(
    make_config: MakeConfig, data: Data, tmp_path: Path, steps_seen: list[int]
) -> None:
    results, logs = [], []
    for accumulate in (1, 2):
        config = make_config("relative", **PLAIN, accumulate=accumulate, optim=CALM)
        out = tmp_path / str(accumulate)
        results.append(weights_of(train_relative(config, data=data, out=out)))
        logs.append([json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()])
    assert steps_seen == [4, 4, 2, 2, 2, 2]
    for name, value in results[0].items():
        torch.testing.assert_close(results[1][name], value, rtol=1e-4, atol=1e-6, msg=name)
    for one, two in zip(*logs, strict=True):
        assert one["step"] == two["step"]
        assert two["train/ssi"] == pytest.approx(one["train/ssi"], rel=1e-4)


def test_batch_that_cannot_be_split_is_an_error(make_config: MakeConfig) -> None:
    with pytest.raises(ValueError, match="cannot be split into 3 equal parts"):
        make_config(batch_size=4, accumulate=3)


def test_gradient_checkpointing_changes_no_gradient(make_config: MakeConfig, data: Data, tmp_path: Path) -> None:
    results = []
    for checkpointing in (False, True):
        config = make_config(**PLAIN, gradient_checkpointing=checkpointing, optim=CALM)
        results.append(weights_of(train_metric(config, data=data, out=tmp_path / str(checkpointing))))
    for name, value in results[0].items():
        torch.testing.assert_close(results[1][name], value, rtol=1e-5, atol=1e-7, msg=name)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=["SIGTERM", "Ctrl-C"])
def test_signal_finishes_the_step_writes_a_checkpoint_and_ends(
    make_config: MakeConfig, data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    config = make_config(steps=4, checkpoint_every=100)
    whole = train_metric(config, data=data, out=tmp_path / "whole")
    handlers = [signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)]
    learn = Run.learn

    def interrupt(self: Run, loss: torch.Tensor, batch: Batch, numbers: dict[str, float]) -> None:
        if self.state.step == 1:
            signal.raise_signal(number)
        learn(self, loss, batch, numbers)

    monkeypatch.setattr(Run, "learn", interrupt)
    with pytest.raises(KeyboardInterrupt, match="step 2 is saved"):
        train_metric(config, data=data, out=tmp_path / "out")
    monkeypatch.setattr(Run, "learn", learn)
    assert [signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)] == handlers
    assert [path.name for path in checkpoints(tmp_path / "out")] == ["step_000002"]
    resumed = train_metric(config, data=data, out=tmp_path / "out")
    for name, value in weights_of(whole).items():
        assert torch.equal(weights_of(resumed)[name], value), name


def test_log_has_rates_speed_and_the_share_of_waiting(make_config: MakeConfig, data: Data, tmp_path: Path) -> None:
    train_metric(make_config(steps=2), data=data, out=tmp_path)
    first = json.loads((tmp_path / "log.jsonl").read_text().splitlines()[0])
    assert first["images_per_s"] > 0
    assert 0 < first["data_wait"] < 1
    assert first["rate/head"] > 0
    assert {"train/silog", "train/domain", "train/gradient_norm", "rate/encoder", "rate/decoder"} <= set(first)


@pytest.mark.parametrize("stage", ["relative", "metric"])
@pytest.mark.parametrize("holdout", [0, 1])
def test_pictures_of_predictions_are_drawn(
    make_config: MakeConfig, data: Data, tmp_path: Path, stage: str, holdout: int
) -> None:
    train = train_relative if stage == "relative" else train_metric
    train(make_config(stage, steps=2, holdout=holdout, validate_every=1, pictures=2), data=data, out=tmp_path)
    files = sorted((tmp_path / "pictures").iterdir())
    assert [path.name for path in files] == ["step_000001.jpg", "step_000002.jpg"]
    with Image.open(files[0]) as picture:
        width, height = picture.size
    # Two rows of three panels, 320 pixels wide each.
    assert width > 3 * 320
    assert height > 2 * 100


def test_pareto_weights_in_bfloat16(make_config: MakeConfig, data: Data, stills: Path, tmp_path: Path) -> None:
    """Fabric guards mixed precision against backward passes it does not know of."""
    config = make_config("relative", steps=2, batch_size=6, task_weights="pareto", precision="bf16-mixed")
    assert train_relative(config, data={**data, "relative": stills}, out=tmp_path).name == "step_000002"


def test_pareto_weights_outlive_an_interruption(
    make_config: MakeConfig, data: Data, stills: Path, tmp_path: Path
) -> None:
    """Solved for at every third step: between them, a resumed run needs the last solution."""
    config = make_config("relative", steps=4, batch_size=6, task_weights="pareto", pareto_every=3)
    every = {**data, "relative": stills}
    whole = train_relative(config, data=every, out=tmp_path / "whole")

    shutil.copytree(tmp_path / "whole/step_000002", tmp_path / "out/step_000002")
    resumed = train_relative(config, data=every, out=tmp_path / "out")
    for name, value in weights_of(whole).items():
        assert torch.equal(weights_of(resumed)[name], value), name
    lines = [json.loads(line) for line in (tmp_path / "whole/log.jsonl").read_text().splitlines()]
    weights = [[line[f"train/weight/{name}"] for name in ("indoor", "outdoor", "relative")] for line in lines]
    assert all(sum(row) == pytest.approx(1, abs=1e-5) for row in weights)
    assert weights[1] == weights[0] == weights[2]
    assert weights[3] != weights[2]


def test_gradient_term_can_be_left_out_for_a_source(make_config: MakeConfig, data: Data, tmp_path: Path) -> None:

    losses = []
    for term in (True, False):
        config = make_config("relative", steps=1)
        sources = tuple(dataclasses.replace(source, gradient_term=term) for source in config.sources)
        config = dataclasses.replace(config, sources=sources)
        train_relative(config, data={"indoor": data["indoor"]}, out=tmp_path / str(term))
        losses.append(json.loads((tmp_path / str(term) / "log.jsonl").read_text().splitlines()[0])["train/ssi"])
    assert losses[1] < 0.9 * losses[0]
