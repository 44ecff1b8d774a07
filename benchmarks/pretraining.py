"""Measure if stage 2 is better after stage 1: train it for equal steps from ImageNet weights and from stage 1.

    python -m benchmarks.pretraining --indoor nyu --outdoor kitti --relative relative --synthetic synthetic:all \\
        --test nyu/test.csv --out runs/pretraining

The model is ``zoed-lite`` at 160x224, trained once for every seed. Prints a Markdown table. Trainings that are finished
in ``--out`` are not repeated. ``--synthetic`` adds rendered scenes, or shards of them, to stage 1.
"""

import json
import subprocess
import sys
from pathlib import Path
from statistics import fmean

import tyro

SIZE = ["--config.model.size", "160", "224", "--config.pictures", "0"]


def main(
    *,
    indoor: Path,
    outdoor: Path,
    relative: Path,
    test: Path,
    out: Path,
    synthetic: str = "",
    steps: int = 200,
    relative_steps: int = 120,
    task_weights: str = "images",
    seeds: tuple[int, ...] = (43, 44),
) -> None:
    """Train and evaluate all of them, and print the table."""
    found: dict[str, list[dict[str, float]]] = {"stage 2 alone": [], "stage 1, then stage 2": []}
    for seed in seeds:
        first = ["--data", f"indoor={indoor}", f"outdoor={outdoor}", f"relative={relative}"]
        first += [f"synthetic={synthetic}"] if synthetic else []
        start = _train(
            "zoed_lite_relative", out / f"relative-{seed}",
            [*first, "--init", "imagenet", "--config.steps", str(relative_steps),
             "--config.task-weights", task_weights],
            seed,
        )  # fmt: skip
        for name, init in (("stage 2 alone", "imagenet"), ("stage 1, then stage 2", str(start))):
            model = _train(
                "zoed_lite", out / f"{name.replace(', ', '-').replace(' ', '-')}-{seed}",
                ["--data", f"indoor={indoor}", f"outdoor={outdoor}", "--init", init, "--config.steps", str(steps)],
                seed,
            )  # fmt: skip
            found[name].append(_evaluate(model, test))
    print(f"\n| {steps} steps of stage 2 | REL | RMSE | delta1 | REL of each seed |\n|---|---:|---:|---:|---:|")
    for name, runs in found.items():
        means = (f"{fmean(run[metric] for run in runs):.3f}" for metric in ("rel", "rmse", "delta1"))
        each = ", ".join(f"{run['rel']:.3f}" for run in runs)
        print(f"| {name} | {' | '.join(means)} | {each} |")


def _train(recipe: str, out: Path, arguments: list[str], seed: int) -> Path:
    command = [sys.executable, "-m", "zoedepth", "train", recipe, "--out", str(out), *arguments, *SIZE]
    done = subprocess.run([*command, "--config.seed", str(seed)], stdout=subprocess.PIPE, text=True, check=True)
    return Path(done.stdout.splitlines()[-1])


def _evaluate(model: Path, test: Path) -> dict[str, float]:
    command = [sys.executable, "-m", "zoedepth", "evaluate", "--model", str(model), "--data", f"test={test}", "--json"]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout)


if __name__ == "__main__":
    tyro.cli(main)
