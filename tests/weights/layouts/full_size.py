"""A checkpoint with the names of a released one, and the memory that it takes to load it."""

import ast
import re
import sys
from pathlib import Path

import torch

from zoedepth.model.interface import DepthModel
from zoedepth.weights.load import load_model

KEYS = Path(__file__).parent / "keys"
WIDTH = 256
"""Channels of BEiT's tokens in place of 1024: with these the file has 0.2 GB, not 1.4."""


def write(keys: str, target: Path) -> None:
    """Write a ``.pt`` of the original's layout with the names and shapes of a key list, ``WIDTH`` and random values."""
    generator = torch.Generator().manual_seed(0)
    state = {}
    for line in (KEYS / keys).read_text().splitlines():
        name, shape, kind = re.fullmatch(r"(\S+) (\(.*\)) torch\.(\w+)", line).groups()
        shape, dtype = _narrowed(name, ast.literal_eval(shape)), getattr(torch, kind)
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


def _narrowed(name: str, shape: tuple[int, ...]) -> tuple[int, ...]:
    """The shape of a weight between tokens of ``WIDTH`` channels. Maps are made of tokens by the convolutions "3"."""
    if ".pretrained.model." in name or ".project." in name:
        return tuple(side * WIDTH // 1024 if side % 1024 == 0 else side for side in shape)
    return (shape[0], WIDTH, 1, 1) if re.search(r"act_postprocess\d\.3\.weight", name) else shape


def load(path: Path) -> tuple[DepthModel, int]:
    """Load; the model and the most memory that loading took beyond what there was before, bytes: 0 but on Linux."""
    if sys.platform != "linux":
        return load_model(path), 0
    Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here on
    before = _peak()
    model = load_model(path)
    return model, _peak() - before


def _peak() -> int:
    """Most memory this process had, bytes."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(re.search(r"VmHWM:\s+(\d+) kB", status)[1])
