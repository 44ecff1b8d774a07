"""A checkpoint of a released size, and what it takes to load one.

python -m tests.weights.layouts.full_size FILE    # loads it and prints one JSON object
"""

import ast
import json
import re
import sys
from pathlib import Path

import torch

KEYS = Path(__file__).parent / "keys"


def write(keys: str, target: Path) -> None:
    """Write a ``.pt`` of the original's layout with the names and shapes of a key list and random values."""
    generator = torch.Generator().manual_seed(0)
    state = {}
    for line in (KEYS / keys).read_text().splitlines():
        name, shape, kind = re.fullmatch(r"(\S+) (\(.*\)) torch\.(\w+)", line).groups()
        shape, dtype = ast.literal_eval(shape), getattr(torch, kind)
        if dtype is torch.int64:
            state[name] = torch.arange(shape[1]).view(shape)
            continue
        if name.endswith("K_minus_1"):
            state[name] = torch.full(shape, 63.0)
            continue
        value = torch.empty(shape, dtype=dtype).uniform_(-1, 1, generator=generator)
        if value.ndim > 1:
            value *= (3 / value[0].numel()) ** 0.5
        elif "norm" in name and name.endswith("weight"):
            value = 1 + 0.1 * value
        else:
            value *= 0.1
        state[name] = value
    torch.save({"model": state, "optimizer": None, "epoch": 5}, target)


def load(path: str) -> dict:
    """Load and predict; the most memory that loading took beyond what there was before, in bytes."""
    from zoedepth.weights.load import load_model

    _import_timm()
    before = _peak()
    model = load_model(path)
    peak = _peak() - before
    pixels = torch.rand(1, 3, 64, 96, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        output = model(pixels)
    return {
        "peak": peak,
        "size": Path(path).stat().st_size,
        "config": repr(model.config),
        "depth": [float(output.depth.min()), float(output.depth.max())],
        "finite": bool(output.depth.isfinite().all()),
    }


def _import_timm() -> None:
    """Import what building a model imports, so that its memory does not count as the weights'."""
    import timm

    timm.create_model("beit_base_patch16_384", depth=1, embed_dim=16, num_heads=1, num_classes=0)


def _peak() -> int:
    """Most memory this process had so far, bytes. (ru_maxrss would count the parent's.)"""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(re.search(r"VmHWM:\s+(\d+) kB", status)[1])


if __name__ == "__main__":
    print(json.dumps(load(sys.argv[1])))
