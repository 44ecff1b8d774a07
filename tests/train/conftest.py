"""A tiny training of either stage, for all files of this folder."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.folders import write_disparity_pairs, write_pairs

from zoedepth.config import ModelConfig
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig
from zoedepth.train.processes import launch_fabric
from zoedepth.train.run import Run, set_up


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Four indoor and two outdoor photos, to be read only: NAME → CSV file."""
    folder = tmp_path_factory.mktemp("data")
    return {
        "indoor": write_pairs(folder / "indoor", n=4),
        "outdoor": write_pairs(folder / "outdoor", n=2, domain="outdoor", size=(48, 160)),
    }


@pytest.fixture(scope="session")
def stills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """CSV file of three photos with disparity, to be read only."""
    return write_disparity_pairs(tmp_path_factory.mktemp("stills"), n=3)


@pytest.fixture(scope="session")
def make_config(tiny_config: ModelConfig) -> Callable[..., TrainConfig]:
    """Return a function that configures a training of four steps in float32; every field can get another value."""

    def make(stage: str = "metric", **fields: object) -> TrainConfig:
        defaults: dict[str, object] = {
            "stage": stage,
            "model": tiny_config,
            "sources": tuple(SourceConfig(name) for name in ("indoor", "outdoor", "relative")),
            "steps": 4,
            "batch_size": 2,
            "optim": OptimConfig(learning_rate=1e-3, encoder_factor=1.0, warmup=0.3, clip=1.0),
            "domain_weight": 1.0,
            "ema_decay": 0.9,
            "precision": "32-true",
            "checkpoint_every": 2,
            "log_every": 1,
            "n_workers": 0,
            "pictures": 0,
            # With this one the relative depth of the random tiny model is not 0 everywhere.
            "seed": 3,
        }
        return TrainConfig(**{**defaults, **fields})

    return make


@pytest.fixture
def start_run(
    make_config: Callable[..., TrainConfig], data: dict[str, Path], tmp_path: Path
) -> Iterator[Callable[..., Run]]:
    """Yield a function that sets up a run of stage 2 in ``tmp_path / "run"``; fields as in ``make_config``.

    The run before ends when the next one begins: one command at a time trains in a folder.
    """
    with ExitStack() as stack:

        def start(*, data: dict[str, Path] = data, init: str | None = None, **fields: object) -> Run:
            stack.close()
            config = make_config(**fields)
            fabric = launch_fabric(config, devices=1, n_nodes=1)
            context = set_up(config, fabric, part=lambda model: model, data=data, out=tmp_path / "run", init=init)
            return stack.enter_context(context)

        yield start
