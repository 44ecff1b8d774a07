"""Every head and every baseline on equal terms: one encoder, one training set, as many steps, one seed.

    python -m benchmarks.heads --nyu nyu --out runs/heads

``--nyu`` is a folder with ``train.csv`` and ``test.csv``. Each is trained by ``zoedepth train`` (the recipes
``comparison*``), scored by ``zoedepth evaluate``, and timed: one photo through the network at its size, batch 1, the
median of several, all in turn at the end, when nothing trains. What is finished in ``--out`` is not computed again.
Prints a Markdown table.
"""

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

import torch
import tyro

from zoedepth.weights.load import load_model

SYSTEMS: dict[str, tuple[str, list[str]]] = {
    "attractor (zoed-lite's values)": ("comparison", []),
    "attractor (the paper's values)": ("comparison", [
        "--config.model.head.n-bins", "64", "--config.model.head.alpha", "300",
        "--config.model.head.initial-centers", "random",
    ]),
    "attractor (the paper's values, the sum of the pulls)": ("comparison", [
        "--config.model.head.n-bins", "64", "--config.model.head.reduce", "sum", "--config.model.head.alpha", "300",
        "--config.model.head.initial-centers", "random",
    ]),
    "attractor, exponential": ("comparison", ["--config.model.head.kind", "exponential"]),
    "attractor, softmax": ("comparison", ["--config.model.head.probability", "softmax"]),
    "attractor, without relative depth": ("comparison", ["--config.model.head.no-relative-input"]),
    "splitter (LocalBins), softmax": ("comparison", ["--head", "splitter"]),
    "splitter, log-binomial": ("comparison", [
        "--head", "splitter", "--config.model.head.probability", "log-binomial",
    ]),
    "PixelBins": ("comparison", ["--head", "pixelbins"]),
    "DORN": ("comparison", ["--head", "dorn"]),
    "NeWCRFs": ("comparison", ["--head", "newcrfs"]),
    "naive": ("comparison", ["--head", "naive"]),
    "AdaBins": ("comparison", ["--head", "adabins"]),
    "BTS": ("comparison", ["--head", "bts"]),
    "native BTS": ("comparison_bts", []),
    "native AdaBins": ("comparison_adabins", []),
    "native LocalBins": ("comparison_localbins", []),
    "native PixelBins": ("comparison_pixelbins", []),
    "native NeWCRFs": ("comparison_newcrfs", []),
    "native DORN": ("comparison_dorn", []),
}  # fmt: skip
"""Row of the table → recipe and options."""


def main(*, nyu: Path, out: Path, steps: int = 100, only: tuple[str, ...] = (), seed: int = 43) -> None:
    """Train, score, time, print.

    Args:
        nyu: folder with train.csv and test.csv.
        out: folder of the runs.
        steps: optimizer steps of 8 photos each.
        only: rows to do; none given: all.
        seed: of weights, order and augmentation.
    """
    rows = {name: SYSTEMS[name] for name in only or SYSTEMS}
    models = {}
    for name, (recipe, options) in rows.items():
        folder = out / "".join(c if c.isalnum() else "-" for c in name)
        models[name] = folder / "model.txt", folder / "scores.json"
        if models[name][1].is_file():
            continue
        arguments = ["--config.steps", str(steps), "--config.seed", str(seed), *options]
        started = time.monotonic()
        model = _run("train", recipe, "--data", f"nyu={nyu}", "--out", str(folder), "--init", "imagenet", *arguments)
        seconds = time.monotonic() - started
        scores = _run("evaluate", "--model", model, "--data", f"nyu={nyu / 'test.csv'}", "--json")
        models[name][0].write_text(model, encoding="utf-8")
        models[name][1].write_text(json.dumps({**json.loads(scores), "seconds": seconds}), encoding="utf-8")
        print(f"{name}: {scores}", file=sys.stderr)
    times = _times({name: paths[0].read_text(encoding="utf-8") for name, paths in models.items()})
    print(f"\n| {steps} steps | REL | RMSE | delta1 | parameters | ms a photo |\n|---|---:|---:|---:|---:|---:|")
    for name, paths in models.items():
        found = json.loads(paths[1].read_text(encoding="utf-8"))
        n_parameters, milliseconds = times[name]
        print(
            f"| {name} | {found['rel']:.3f} | {found['rmse']:.3f} | {found['delta1']:.3f} "
            f"| {n_parameters / 1e6:.1f} M | {milliseconds:.0f} |"
        )


def _run(*arguments: str) -> str:
    done = subprocess.run([sys.executable, "-m", "zoedepth", *arguments], stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout.splitlines()[-1]


@torch.inference_mode()
def _times(models: dict[str, str], *, rounds: int = 15) -> dict[str, tuple[int, float]]:
    """Parameters, and the median milliseconds of one photo in float32; in turn, so that drift hits all alike."""
    loaded = {name: load_model(path) for name, path in models.items()}
    found: dict[str, list[float]] = {name: [] for name in loaded}
    for turn in range(rounds + 2):
        for name, model in loaded.items():
            pixels = torch.rand(1, 3, *model.config.size)
            started = time.perf_counter()
            model(pixels)
            if turn >= 2:
                found[name].append(1000 * (time.perf_counter() - started))
    return {
        name: (sum(p.numel() for p in model.parameters()), statistics.median(found[name]))
        for name, model in loaded.items()
    }


if __name__ == "__main__":
    tyro.cli(main)
