"""Write data for a run, watch what it reads, and read what it has written."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.folders import write_csv

from zoedepth.data.pairs import PairDataset
from zoedepth.data.plausible import Doubts
from zoedepth.data.sample import Sample


def log_of(out: Path) -> list[dict[str, float]]:
    """Return the lines of a run's log."""
    return [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]


def weights_of(checkpoint: Path) -> dict[str, torch.Tensor]:
    """Return the weights that training goes on with, not their moving average."""
    return torch.load(checkpoint / "train.pt", weights_only=True)["model"]


def assert_same_checkpoint(first: Path, second: Path) -> None:
    """Check that result, weights, moving average, optimizer and random state are the same, bit for bit."""
    saved = [torch.load(folder / "train.pt", weights_only=True) for folder in (first, second)]
    leaves = [torch.utils._pytree.tree_flatten(values) for values in saved]
    assert leaves[0][1] == leaves[1][1]
    for a, b in zip(leaves[0][0], leaves[1][0], strict=True):
        assert torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b
    for name in ("model.safetensors", "meta.json"):
        assert (first / name).read_bytes() == (second / name).read_bytes()


def on_reading(monkeypatch: pytest.MonkeyPatch, change: Callable[[Sample], Sample]) -> None:
    """Put a change between the files and the training, which looks at its depth without it."""
    monkeypatch.setattr("zoedepth.train.sources.doubt_depth", lambda dataset: Doubts())
    original = PairDataset.__getitem__
    monkeypatch.setattr(PairDataset, "__getitem__", lambda self, index: change(original(self, index)))


def write_sparse(folder: Path, *, n: int = 3) -> Path:
    """Write photos with 2 % known pixels at 4 to 6 m, in a domain of their own; return the list."""
    rng = np.random.default_rng(0)
    (folder / "image").mkdir(parents=True)
    rows = []
    for index in range(n):
        stored = np.where(rng.random((64, 96)) < 0.02, rng.uniform(4000, 6000, (64, 96)), 0).astype(np.uint16)
        Image.fromarray(rng.integers(0, 255, (64, 96, 3), np.uint8)).save(folder / f"image/{index}.jpg")
        Image.fromarray(stored).save(folder / f"image/{index}.png")
        rows.append(
            {"image": f"image/{index}.jpg", "depth": f"image/{index}.png", "depth_scale": 1000, "domain": "warehouse"}
        )
    return write_csv(folder / "train.csv", rows)
