"""The time of an exported model by kind of layer and by the numbers that OpenVINO computes it in.

    python -m benchmarks.layers FILE.xml --size 384 512 --precision bfloat16

OpenVINO's own counters are read, which take a few per cent more time. Prints a Markdown table.
"""

import os
import statistics
from collections import defaultdict
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from zoedepth.threads import cpu_count
from zoedepth.weights.openvino_graph import specialized
from zoedepth.weights.tensors import INPUT, STD

_NUMBERS = {"f32": "float32", "bf16": "bfloat16", "f16": "float16", "i8": "int8", "u8": "int8", "i32": "int32"}


def main(
    file: tyro.conf.Positional[Path],
    *,
    size: tuple[int, int] = (384, 512),
    precision: Literal["float32", "bfloat16"] = "float32",
    repeats: int = 5,
    least: float = 0.005,
) -> None:
    """Measure and print.

    Args:
        file: exported model.
        size: height and width of the input.
        precision: numbers of the layers that are not in 8 bits.
        repeats: measured forwards, after one that is not measured.
        least: share of the time below which kinds of layers are put together.
    """
    import openvino

    core = openvino.Core()
    graph = specialized(core.read_model(file), shape=(1, 3, *size), without=(STD,))
    options: dict[str, Any] = {
        "INFERENCE_PRECISION_HINT": {"float32": "f32", "bfloat16": "bf16"}[precision],
        "INFERENCE_NUM_THREADS": cpu_count(),
        "NUM_STREAMS": 1,
        "PERF_COUNT": True,
    }
    compiled = core.compile_model(graph, "CPU", options)
    request = compiled.create_infer_request()
    inputs = {port.get_any_name(): np.ones([d.get_length() for d in port.partial_shape], np.float32)
              for port in compiled.inputs}  # fmt: skip
    inputs[INPUT] = np.random.default_rng(0).normal(size=(1, 3, *size)).astype(np.float32)
    request.infer(inputs)
    runs: list[dict[tuple[str, str, str], tuple[int, float]]] = []
    for _ in range(repeats):
        request.infer(inputs)
        found: dict[tuple[str, str, str], tuple[int, float]] = defaultdict(lambda: (0, 0.0))
        for layer in request.profiling_info:
            seconds = layer.real_time.total_seconds()
            if seconds:
                kernel, _, numbers = layer.exec_type.rpartition("_")
                key = (layer.node_type, _NUMBERS.get(numbers, numbers), kernel)
                found[key] = (found[key][0] + 1, found[key][1] + seconds)
        runs.append(found)
    seconds = {key: statistics.median(run.get(key, (0, 0.0))[1] for run in runs) for key in runs[0]}
    whole = sum(seconds.values())
    print(f"{file.name}, {size[0]}x{size[1]}, {precision}, {os.cpu_count()} cores: {1000 * whole:.0f} ms in layers\n")
    print("| layer | numbers | kernel | number | ms | share |\n|---|---|---|---:|---:|---:|")
    rest = 0.0
    for key, value in sorted(seconds.items(), key=lambda item: -item[1]):
        if value < least * whole:
            rest += value
            continue
        layer, numbers, kernel = key
        print(f"| {layer} | {numbers} | {kernel} | {runs[0][key][0]} | {1000 * value:.1f} | {value / whole:.1%} |")
    print(f"| others | | | | {1000 * rest:.1f} | {rest / whole:.1%} |")


if __name__ == "__main__":
    tyro.cli(main)
