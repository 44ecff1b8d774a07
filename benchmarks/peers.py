"""Compare the paper's model here and in ``transformers``, with the same random weights: time, memory and depth.

    python -m benchmarks.peers --model zoed-m12-nk --out runs/peers

Every system has a process of its own. They take turns, one forward each, so that a drift of the machine's speed hits
all alike. Exported files are written to ``--out`` once. Beside each time stands its floor, the time that the machine
needs for the multiplications alone: operations (counted by torch) / rate of a large product (measured in the same run,
in the precision of the row). No implementation of the same arithmetic is faster. Linux only, for the memory. Prints a
Markdown table, and draws it to ``--out``/MODEL-BATCH.png.
"""

import math
import multiprocessing
import statistics
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import tyro

SIZE = (384, 512)
SYSTEMS = {
    "transformers, float32": "float32",
    "transformers, bfloat16 autocast": "bfloat16",
    "torch, float32": "float32",
    "torch, bfloat16": "bfloat16",
    "torch.compile, float32": "float32",
    "ONNX Runtime, float32": "float32",
    "OpenVINO, float32": "float32",
    "OpenVINO, bfloat16": "bfloat16",
    "OpenVINO, int8": "int8",
}
"""Row of the table → precision of its floor."""


def main(
    *,
    model: str = "zoed-m12-nk",
    out: Path = Path("runs/peers"),
    batch: int = 1,
    rounds: int = 7,
    systems: tuple[str, ...] = tuple(name for name in SYSTEMS if "compile" not in name),
    photos: Path | None = None,
    keep: bool = False,
) -> None:
    """Measure and print.

    Args:
        model: a preset with BEiT.
        out: folder for the weights, the exported files and the plot.
        batch: images of a forward.
        rounds: measured forwards of each system, after one that is not measured.
        systems: rows; the others are compared with the first. torch.compile runs only if it is named.
        photos: folder of photos to calibrate int8 on; None: made-up colours.
        keep: keep what OpenVINO compiles in ``out``/compiled, as ``predict --fast`` does in the cache: the second run
            shows the second start.
    """
    out.mkdir(parents=True, exist_ok=True)
    files = prepare(model, out, systems, photos)
    compiled = out / "compiled" if keep else None
    gigaflops = _gigaflops(files["weights"], batch)
    rates = machine_rates()
    context = multiprocessing.get_context("spawn")
    workers: dict[str, Any] = {}
    for name in systems:
        here, there = context.Pipe()
        process = context.Process(target=work, args=(name, files, batch, compiled, there), daemon=True)
        process.start()
        load, first = here.recv()  # before the next one starts: loading is timed too
        workers[name] = (process, here, load, first, [])
    for number in range(rounds + 1):
        for _, pipe, _, _, seconds in workers.values():
            pipe.send("run")
            elapsed = pipe.recv()
            if number:
                seconds.append(elapsed)
    rows, expected, base = [], None, None
    for name, (process, pipe, load, first, seconds) in workers.items():
        pipe.send("finish")
        depth, peak = pipe.recv()
        process.join()
        median = statistics.median(seconds)
        expected = depth if expected is None else expected
        base = (median, peak) if base is None else base
        difference = np.median(np.abs(depth - expected) / expected)
        rel = np.mean(np.abs(depth - expected) / expected)
        floor = gigaflops / rates[SYSTEMS[name]]
        rows.append(
            (
                name,
                median,
                min(seconds),
                max(seconds),
                base[0] / median,
                median / floor,
                peak,
                peak / base[1],
                load,
                first,
                difference,
                rel,
            )
        )
    copy = rates["copy"]
    print(f"{model}, {SIZE[0]}x{SIZE[1]}, batch {batch}: {gigaflops:.0f} GFLOP. Products of this machine, GFLOP/s: "
          f"{rates['float32']:.0f} float32, {rates['bfloat16']:.0f} bfloat16, {rates['int8']:.0f} int8; "
          f"copy {copy:.0f} GB/s.\n")  # fmt: skip
    heads = ("s", "least - most", "times faster", "x floor", "peak MB", "of the first's", "load s", "first depth s",
             "median difference", "REL")  # fmt: skip
    print(f"| | {' | '.join(heads)} |\n|---|{len(heads) * '---:|'}")
    for name, s, low, high, ratio, floor, peak, share, load, first, difference, rel in rows:
        times = "" if math.isnan(floor) else f"{floor:.2f}"
        print(f"| {name} | {s:.2f} | {low:.2f} - {high:.2f} | {ratio:.2f} | {times} | {peak:.0f} | {share:.0%} "
              f"| {load:.1f} | {first:.1f} | {difference:.1e} | {rel:.1e} |")  # fmt: skip
    _plot(rows, {name: gigaflops / rates[kind] for name, kind in SYSTEMS.items()}, out / f"{model}-{batch}.png")


def prepare(model: str, out: Path, systems: tuple[str, ...], photos: Path | None) -> dict[str, Path]:
    """Write the weights in the layouts of all systems, once, and return the files."""
    import torch

    from zoedepth.build import build_model
    from zoedepth.export import export_model
    from zoedepth.images import IMAGE_SUFFIXES, write_image
    from zoedepth.presets import PRESETS
    from zoedepth.weights.checkpoint import write_checkpoint
    from zoedepth.weights.load import load_model
    from zoedepth.weights.save import checkpoint_of, save_model

    files = {
        "weights": out / f"{model}.safetensors",
        "transformers": out / f"{model}-transformers",
        "onnx": out / f"{model}.onnx",
        "openvino": out / f"{model}.xml",
        "int8": out / f"{model}-int8.xml",
    }
    if not files["weights"].exists():
        torch.manual_seed(0)
        save_model(build_model(PRESETS[model]).eval(), files["weights"])
    network = load_model(files["weights"])
    if not files["transformers"].exists():
        write_checkpoint(checkpoint_of(network), files["transformers"], to="huggingface")
    if any("ONNX" in name for name in systems) and not files["onnx"].exists():
        export_model(network, files["onnx"], to="onnx")
    if {"OpenVINO, float32", "OpenVINO, bfloat16"} & set(systems) and not files["openvino"].exists():
        export_model(network, files["openvino"], to="openvino")
    if "OpenVINO, int8" in systems and not files["int8"].exists():
        if photos is None:
            photos = out / "photos"
            generator = np.random.default_rng(0)
            for number in range(8):
                coarse = np.kron(generator.integers(0, 256, (6, 8, 3)), np.ones((64, 64, 1)))
                write_image(photos / f"{number}.png", coarse.astype(np.uint8))
        paths = sorted(path for path in photos.rglob("*") if path.suffix.lower() in IMAGE_SUFFIXES)
        export_model(network, files["int8"], to="openvino", int8=True, photos=paths[:: -(-len(paths) // 8)])
    return files


def work(name: str, files: dict[str, Path], batch: int, compiled: Path | None, pipe: Connection) -> None:
    """Run one system: load, one forward, then a forward for each message; at the end send depth and peak memory.

    The pixels are an array: exported files are run without torch, which would take half a gigabyte of their memory.
    """
    pixels = np.random.default_rng(0).random((batch, 3, *SIZE), dtype=np.float32)
    started = time.perf_counter()
    run = _load(name, files, compiled)
    loaded = time.perf_counter()
    depth = run(pixels)
    pipe.send((loaded - started, time.perf_counter() - loaded))
    while pipe.recv() == "run":
        started = time.perf_counter()
        depth = run(pixels)
        pipe.send(time.perf_counter() - started)
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = next(int(line.split()[1]) / 1000 for line in status.splitlines() if line.startswith("VmHWM"))
    pipe.send((depth, peak))


def _load(name: str, files: dict[str, Path], compiled: Path | None) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function from pixels to metres, both arrays."""
    bfloat16 = "bfloat16" in name
    if not name.startswith(("transformers", "torch")):
        from zoedepth.weights.exported import load_exported

        key = "onnx" if "ONNX" in name else "int8" if "int8" in name else "openvino"
        keep = compiled / key if compiled is not None else None
        exported = load_exported(files[key], precision="bfloat16" if bfloat16 else "float32", keep=keep)
        return lambda pixels: exported.compute(pixels, std=False).predicted_depth
    import torch

    if name.startswith("transformers"):
        from transformers import ZoeDepthForDepthEstimation

        peer = ZoeDepthForDepthEstimation.from_pretrained(files["transformers"]).eval()

        def depth_of(pixels: torch.Tensor) -> torch.Tensor:
            return peer(pixel_values=2 * pixels - 1).predicted_depth
    else:
        from zoedepth import load_model

        network = load_model(files["weights"])
        forward = torch.compile(network) if "compile" in name else network

        def depth_of(pixels: torch.Tensor) -> torch.Tensor:
            return forward(pixels).depth[:, 0]

    def run(pixels: np.ndarray) -> np.ndarray:
        with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
            return depth_of(torch.from_numpy(pixels)).float().numpy()

    return run


def machine_rates() -> dict[str, float]:
    """Measure GFLOP/s of large products in each precision with all threads, and GB/s that a copy reads and writes.

    A precision that torch has no fast product for here, as on processors without AVX-512, is NaN.
    """
    import torch

    def best(function: Callable[[], object]) -> float:
        function()
        times = []
        for _ in range(9):
            started = time.perf_counter()
            function()
            times.append(time.perf_counter() - started)
        return min(times)

    def rate(
        product: Callable[[torch.Tensor, torch.Tensor], torch.Tensor], matrix: torch.Tensor, few: torch.Tensor
    ) -> float:
        if 2 * len(few) ** 3 / best(lambda: product(few, few)) / 1e9 < rates["float32"] / 10:
            return math.nan
        return 2 * n**3 / best(lambda: product(matrix, matrix)) / 1e9

    n = 3072
    x = torch.randn(n, n)
    rates: dict[str, float] = {}
    with torch.inference_mode():
        # There are several kernels for a product; the best one shows what the machine can do.
        image = x.T.reshape(1, n, 1, n).contiguous(memory_format=torch.channels_last)
        linear, convolution = best(lambda: x @ x), best(lambda: torch.conv2d(image, x[:, :, None, None]))
        rates["float32"] = 2 * n**3 / min(linear, convolution) / 1e9
        few = x[:256, :256].contiguous()
        rates["bfloat16"] = rate(torch.mm, x.bfloat16(), few.bfloat16())
        rates["int8"] = rate(torch._int_mm, (100 * x).to(torch.int8), (100 * few).to(torch.int8))
        source = torch.empty(1 << 26)
        target = torch.empty_like(source)
        rates["copy"] = 2 * source.nbytes / best(lambda: target.copy_(source)) / 1e9
    return rates


def _gigaflops(weights: Path, batch: int) -> float:
    import torch
    from torch.utils.flop_counter import FlopCounterMode

    from zoedepth import load_model

    model = load_model(weights)
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        model(torch.rand(1, 3, *SIZE))
    return batch * counter.get_total_flops() / 1e9


def _plot(rows: list[tuple], floors: dict[str, float], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = [row[0] for row in rows]
    figure, axes = pyplot.subplots(figsize=(8, 0.5 * len(rows) + 1.2), layout="constrained")
    places = range(len(rows))[::-1]
    spread = [[row[1] - row[2] for row in rows], [row[3] - row[1] for row in rows]]
    colors = ["#888888" if name.startswith("transformers") else "#3b6fb6" for name in names]
    axes.barh(places, [row[1] for row in rows], xerr=spread, color=colors, height=0.6)
    axes.scatter([floors[name] for name in names], places, marker="|", s=300, color="#d1495b", label="floor", zorder=3)
    axes.set_yticks(places, names)
    axes.set_xlabel("seconds a forward (bar: median, line: fastest to slowest)")
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    tyro.cli(main)
