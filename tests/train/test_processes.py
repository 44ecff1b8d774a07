"""Two processes train as one: the same curve of the loss at the same global batch."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.folders import write_disparity_pairs, write_pairs

from zoedepth.errors import InputError
from zoedepth.train.config import TrainConfig
from zoedepth.train.processes import launch_fabric

COMMON = [
    "--config.steps", "20", "--config.batch-size", "8", "--config.model.size", "64", "64", "--config.precision",
    "32-true", "--config.n-workers", "0", "--config.log-every", "1", "--config.pictures", "0",
    "--config.checkpoint-every", "20",
]  # fmt: skip


def train(command: list[str], out: Path) -> list[dict[str, float]]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, *command, "--out", str(out)], capture_output=True, text=True,
                          env=environment, timeout=300)  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    return [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]


@pytest.mark.parametrize(
    ("recipe", "options", "shown"),
    [
        ("zoed_lite", ["--config.optim.learning-rate", "3e-5"], ["train/silog", "train/domain"]),
        # Medians, signs and trimming jump: with larger steps the last digit of a sum decides where after ten of them.
        (
            "zoed_lite_relative",
            [
                "--config.optim.learning-rate",
                "1e-6",
                "--init",
                "zoed-lite",
                "--config.task-weights",
                "pareto",
                "--config.pareto-every",
                "2",
            ],
            ["train/ssi", "train/weight/indoor", "train/weight/outdoor", "train/weight/relative"],
        ),
    ],
    ids=["metric", "relative with Pareto weights"],
)
def test_two_processes_give_the_curve_of_one(recipe: str, options: list[str], shown: list[str], tmp_path: Path) -> None:
    data = [
        f"indoor={write_pairs(tmp_path / 'rooms', n=6)}",
        f"outdoor={write_pairs(tmp_path / 'streets', n=4, domain='outdoor')}",
    ]
    if recipe.endswith("relative"):
        data.append(f"relative={write_disparity_pairs(tmp_path / 'stills', n=3)}")
    arguments = ["train", recipe, "--data", *data, *COMMON, *options]
    one = train(["-m", "zoedepth", *arguments], tmp_path / "one")
    torchrun = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m", "zoedepth"]
    two = train([*torchrun, *arguments], tmp_path / "two")
    assert [line["step"] for line in two] == list(range(1, 21))
    for name in shown:
        values = [[line[name] for line in lines if name in line] for lines in (one, two)]
        assert values[1] == pytest.approx(values[0], rel=1e-4, abs=1e-4), name
        assert max(values[0]) - min(values[0]) > 0.01, "a curve, nothing that stands still"


def test_devices_that_contradict_torchrun_are_an_error(make_config, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"TORCHELASTIC_RUN_ID": "none", "WORLD_SIZE": "4", "LOCAL_WORLD_SIZE": "2"}.items():
        monkeypatch.setenv(name, value)
    config: TrainConfig = make_config()
    with pytest.raises(InputError, match="torchrun has started 2 processes here, --devices says 3"):
        launch_fabric(config, devices=3, n_nodes=1)
