"""A comparison so small that it runs in a second, for all files of this folder."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import pytest
from tests.folders import write_pairs

from zoedepth.config import ModelConfig, NaiveConfig
from zoedepth.reproduction.scale import Scale, relative_model
from zoedepth.reproduction.tables import BaseName, Row, Table
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig

TABLE = Table(
    "tiny",
    "Heads",
    (Row("Naive head", "table_5_naive", "N"), Row("Attractors", "table_5_inverse_16_8_4_1", "N")),
    (("nyu", "rel"), ("nyu", "rmse")),
    reference="Naive head",
    variable="the head",
    paper=("table-5",),
)
"""Two rows after one pre-training on NYU."""


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Three photos to train on, two to score on, to be read only."""
    folder = tmp_path_factory.mktemp("nyu")
    write_pairs(folder, n=3)
    write_pairs(folder, n=2, split="test")
    return {"nyu": str(folder)}


@pytest.fixture(scope="session")
def tiny(tiny_config: ModelConfig) -> Scale:
    """Two steps of stage 1, four of stage 2."""
    optim = OptimConfig(learning_rate=1e-3, clip=1.0)

    def training(stage: Literal["relative", "metric"], model: ModelConfig, steps: int) -> TrainConfig:
        return TrainConfig(
            stage, model, (SourceConfig("nyu"),), steps=steps, batch_size=1, optim=optim, precision="32-true",
            validate_every=10**6, checkpoint_every=2, pictures=0, n_workers=0, keep_checkpoints=1,
        )  # fmt: skip

    def adapt(row: Row) -> TrainConfig:
        head = NaiveConfig(width=8) if row.name == "Naive head" else tiny_config.head
        return training("metric", dataclasses.replace(tiny_config, domains=tiny_config.domains[:1], head=head), 4)

    def pretrain(base: BaseName, model: ModelConfig) -> tuple[TrainConfig, ...]:
        return (training("relative", relative_model(model, model.size), 2),)

    return Scale("tiny", adapt, pretrain)


@pytest.fixture
def random_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let pre-trainings begin with random weights: there are no ImageNet weights of the tiny encoder."""
    from zoedepth.reproduction import run

    for name in ("train_relative", "train_metric"):
        train: Callable[..., Path] = getattr(run, name)

        def begin(config: TrainConfig, *, init: str, train: Callable[..., Path] = train, **rest: object) -> Path:
            return train(config, init=None if init == "imagenet" else init, **rest)

        monkeypatch.setattr(run, name, begin)
