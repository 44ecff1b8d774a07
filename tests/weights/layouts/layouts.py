"""Weights in the layouts of others: the released names and shapes without values, and tiny models with them."""

import ast
import re
from functools import cache
from pathlib import Path

import torch
from tests.twins import KITTI, NYU, twin, twin_config

from zoedepth.weights.checkpoint import Checkpoint
from zoedepth.weights.layouts import huggingface

KEYS = Path(__file__).parent / "keys"
TINY = {"n": ((NYU,), "softplus"), "k": ((KITTI,), "normed"), "nk": ((NYU, KITTI), "softplus")}
"""Heads and centers of a tiny twin of each released model."""


def released(name: str) -> dict[str, torch.Tensor]:
    """The state dict of a released file, by its key list, on the meta device."""
    weights = {}
    for line in (KEYS / f"{name}.txt").read_text().splitlines():
        key, shape, dtype = re.fullmatch(r"(\S+) (\(.*\)) torch\.(\w+)", line).groups()
        weights[key] = torch.empty(ast.literal_eval(shape), dtype=getattr(torch, dtype), device="meta")
    return weights


@cache
def tiny(kind: str = "n") -> Checkpoint:
    """A small random model of a kind of ``TINY``. Its tensors are shared: do not change them in place."""
    heads, centers = TINY[kind]
    config = twin_config(heads=heads, centers=centers)
    ours, weights, _ = huggingface.read(twin(config).state_dict(), config.to_dict(), layout=5)
    return Checkpoint(ours, {name: value.detach() for name, value in weights.items()}, "huggingface", str)


def same(first: dict[str, torch.Tensor], second: dict[str, torch.Tensor]) -> bool:
    """Whether two state dicts are equal: names, types, shapes and bits."""
    return first.keys() == second.keys() and all(
        value.dtype == second[name].dtype and torch.equal(value, second[name]) for name, value in first.items()
    )
