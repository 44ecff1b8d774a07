"""The speed of one large product in each precision, measured once on a machine: what else is fast depends on it."""

import json
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from typing import Any

from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.runtimes.exports import cache_folder
from zoedepth.runtimes.machine import Machine, versions
from zoedepth.stored import read_json

ROWS, INNER, OUTER = 768, 1024, 4096
"""Sides of the product: the patches of a photo at 384x512, and the widths of the largest layer of BEiT-L."""

_REPEATS = 7

Products = dict[str, float]
"""Precision → GFLOP/s."""


def products(machine: Machine, *, measure: Callable[[bool], Products] | None = None) -> Products:
    """Return the GFLOP/s of the product in float32 and bfloat16: those in the user's cache, or measured now.

    Args:
        machine: this machine.
        measure: measures it, on the GPU if its argument is True; None: ``measure_products``.
    """
    wanted = {"machine": asdict(machine), "torch": versions()["torch"]}
    path = cache_folder() / "products" / f"{machine.fingerprint}.json"
    try:
        kept = read_json(path)
        if {name: kept[name] for name in wanted} == wanted and kept["float32"] > 0 and kept["bfloat16"] > 0:
            return {name: float(kept[name]) for name in ("float32", "bfloat16")}
    except (InputError, KeyError, TypeError):  # there is none, or another version wrote it
        pass
    found = (measure or measure_products)(machine.accelerator is not None)
    # Where the cache cannot be written to, it is measured every time.
    with suppress(OSError), atomic_path(path) as part:
        part.write_text(json.dumps({**wanted, **found}, indent=2) + "\n", encoding="utf-8")
    return found


def measure_products(on_gpu: bool) -> Products:
    """Measure the GFLOP/s of the product, with all threads of torch.

    The precisions take turns, and the fastest of several counts: so other programs of the machine disturb little.

    Args:
        on_gpu: multiply on the GPU.
    """
    import torch

    device = torch.accelerator.current_accelerator() if on_gpu else torch.device("cpu")
    x, weight = torch.randn(ROWS, INNER, device=device), torch.randn(OUTER, INNER, device=device)
    half_x, half_weight = x.bfloat16(), weight.bfloat16()
    image = x.T.reshape(1, INNER, 1, ROWS).contiguous(memory_format=torch.channels_last)
    kernels: list[tuple[str, Callable[[], Any]]] = [
        ("float32", lambda: torch.nn.functional.linear(x, weight)),
        # A product as a convolution: where torch's own is slow (model/linear.py), this one is taken.
        ("float32", lambda: torch.conv2d(image, weight[:, :, None, None])),
        ("bfloat16", lambda: torch.nn.functional.linear(half_x, half_weight)),
    ]
    fastest = {"float32": float("inf"), "bfloat16": float("inf")}
    with torch.inference_mode():
        for number in range(_REPEATS + 1):
            for name, multiply in kernels:
                started = time.perf_counter()
                multiply()
                if on_gpu:
                    torch.accelerator.synchronize()
                if number:  # the first one warms up
                    fastest[name] = min(fastest[name], time.perf_counter() - started)
    return {name: 2 * ROWS * INNER * OUTER / seconds / 1e9 for name, seconds in fastest.items()}
