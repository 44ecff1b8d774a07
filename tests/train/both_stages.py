"""Train both stages by the command line, as torchrun starts it: ``both_stages.py OUT DATA``.

Both in one process, because to start one takes longer than to train.
"""

import sys
from pathlib import Path

from zoedepth.cli import main

STEPS = 4
COMMON = [
    "--config.steps", str(STEPS), "--config.batch-size", "8", "--config.model.size", "64", "64", "--config.precision",
    "32-true", "--config.n-workers", "0", "--config.log-every", "1", "--config.pictures", "0",
    "--config.checkpoint-every", str(STEPS),
]  # fmt: skip
METRIC = ["zoed_lite", "--config.optim.learning-rate", "3e-5"]
# Medians, signs and trimming jump: with larger steps the last digit of a sum decides on the loss some steps later.
RELATIVE = [
    "zoed_lite_relative", "--config.optim.learning-rate", "1e-6", "--init", "zoed-lite", "--config.task-weights",
    "pareto", "--config.pareto-every", "2",
]  # fmt: skip


def train_both(data: Path, out: Path) -> None:
    """Train on the folders "indoor", "outdoor" and, in stage 1, "relative" of ``data``."""
    for recipe, names in ((METRIC, ["indoor", "outdoor"]), (RELATIVE, ["indoor", "outdoor", "relative"])):
        sources = [f"{name}={data / name / 'train.csv'}" for name in names]
        folder = out / ("metric" if recipe is METRIC else "relative")
        assert main(["train", *recipe, *COMMON, "--data", *sources, "--out", str(folder)]) == 0


if __name__ == "__main__":
    train_both(Path(sys.argv[1]), Path(sys.argv[2]))
