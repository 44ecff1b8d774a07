"""Kill a training at random steps with ``kill -9``, let it go on each time, and compare with one left alone.

    python -m benchmarks.kill [--kills 10] [--stage metric]

The two must end with the same bits. A small model on a few pairs that the script writes; nothing else is needed.
"""

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro
from PIL import Image

from zoedepth.train.state import checkpoints

STEPS = 60


def main(*, kills: int = 10, stage: Literal["metric", "relative"] = "metric", seed: int | None = None) -> int:
    """Exit code 0 if the killed and the uninterrupted training end with the same bits."""
    seed = random.randrange(1 << 30) if seed is None else seed
    rng = random.Random(seed)
    print(f"seed {seed}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for domain in ("indoor", "outdoor"):
            _write_pairs(folder / domain, domain)
        _start(folder, "alone", stage).wait()
        done = 0
        while done < kills:
            process = _start(folder, "killed", stage)
            before = _steps_logged(folder / "killed")
            target = before + rng.randrange(1, max(2, STEPS // kills))
            while process.poll() is None and _steps_logged(folder / "killed") < target:
                time.sleep(0.005)
            time.sleep(rng.random() * 0.05)  # in the middle of anything: a step, a checkpoint, a line of the log
            if process.poll() is not None:
                print(f"it ended before kill {done + 1}; {done} kills")
                break
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            done += 1
            print(f"kill {done} after step {_steps_logged(folder / 'killed')}", flush=True)
        _start(folder, "killed", stage).wait()
        same = _same(folder / "alone", folder / "killed")
        print(f"{done} kills: the same bits: {same}")
        return 0 if same and done == kills else 1


def _start(folder: Path, name: str, stage: str) -> subprocess.Popen:
    recipe = "zoed_lite" if stage == "metric" else "zoed_lite_relative"
    command = [
        sys.executable, "-m", "zoedepth", "train", recipe,
        "--data", f"indoor={folder / 'indoor'}", f"outdoor={folder / 'outdoor'}", "--out", str(folder / name),
        "--config.steps", str(STEPS), "--config.batch-size", "2", "--config.model.size", "64", "96",
        "--config.checkpoint-every", "3", "--config.log-every", "1", "--config.pictures", "0",
        "--config.ema-decay", "0.9", "--config.n-workers", "1",
    ]  # fmt: skip
    if stage == "relative":
        command += ["--config.task-weights", "pareto", "--config.pareto-every", "4"]
    # A group of its own, so that its data workers die with it.
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)


def _steps_logged(out: Path) -> int:
    path = out / "log.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    for line in reversed(lines):
        try:
            return json.loads(line)["step"]
        except ValueError:
            continue
    return 0


def _same(alone: Path, killed: Path) -> bool:
    """Weights, optimizer and moving average of the last checkpoints, bit by bit."""
    first, second = (
        torch.load(checkpoints(out)[-1] / "train.pt", weights_only=True, map_location="cpu") for out in (alone, killed)
    )
    models = [(checkpoints(out)[-1] / "model.safetensors").read_bytes() for out in (alone, killed)]
    return models[0] == models[1] and _equal(first, second)


def _equal(a: object, b: object) -> bool:
    if isinstance(a, torch.Tensor):
        return isinstance(b, torch.Tensor) and torch.equal(a, b)
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(_equal(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return isinstance(b, list | tuple) and len(a) == len(b) and all(map(_equal, a, b))
    return a == b


def _write_pairs(folder: Path, domain: str) -> None:
    rng = np.random.default_rng(len(domain))
    (folder / "image").mkdir(parents=True)
    (folder / "depth").mkdir()
    lines = ["image,depth,depth_scale,domain"]
    for index in range(6):
        depth = np.cumsum(rng.random((64, 96)), axis=1) * (0.08 if domain == "indoor" else 0.6) + 1
        Image.fromarray((255 / depth).astype(np.uint8)).save(folder / f"image/{index}.png")
        Image.fromarray((depth * 256).astype(np.uint16)).save(folder / f"depth/{index}.png")
        lines.append(f"image/{index}.png,depth/{index}.png,256,{domain}")
    (folder / "train.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
