"""A training step of zoed-lite, in float32 and bfloat16, and the operations that its time goes to.

    OMP_NUM_THREADS=1 python -m benchmarks.training

bfloat16 is measured where ``train`` would take it. Random pixels and depth, so that no data are waited for. Models keep
their weights with the channels last, which the other rows undo. The rows take turns. Prints two Markdown tables.
"""

import statistics
import time
from collections import defaultdict
from collections.abc import Callable

import torch
import tyro

from zoedepth import losses
from zoedepth.build import build_model
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.recipes import RECIPES
from zoedepth.train.processes import resolve
from zoedepth.train.step import freeze_batch_norm

KINDS = {
    "convolution": (
        "aten::convolution_backward",
        "aten::mkldnn_convolution",
        "aten::_slow_conv2d",
        "aten::thnn_conv2d",
    ),
    "batch norm": ("aten::native_batch_norm",),
    "activation": ("aten::hardtanh", "aten::clamp", "aten::threshold", "aten::gelu", "aten::softplus", "aten::relu"),
    "copies and changes of number": ("aten::copy_", "aten::_to_copy", "aten::to", "aten::fill_", "aten::zero_"),
    "upsampling": ("aten::upsample",),
    "optimizer": ("Optimizer", "aten::lerp", "aten::addcdiv", "aten::addcmul", "aten::sqrt"),
}
"""Kind of operation → beginnings of the names that torch's profiler gives it."""


def main(*, size: tuple[int, int] = (256, 352), batch: int = 8, rounds: int = 5) -> None:
    """Measure and print.

    Args:
        size: height and width.
        batch: images of a step.
        rounds: measured steps of each row, after one that is not measured.
    """
    config = RECIPES["zoed_lite"]().model
    torch.manual_seed(0)
    pixels = torch.rand(batch, 3, *size)
    target = 1 + 5 * torch.rand(batch, 1, *size)
    known = torch.ones_like(target, dtype=torch.bool)

    def step(*, bfloat16: bool, channels_last: bool) -> Callable[[], None]:
        layout = torch.channels_last if channels_last else torch.contiguous_format
        model = build_model(config).train().to(memory_format=layout)
        assert isinstance(model, ZoeDepth)
        freeze_batch_norm(model.encoder)
        optimizer = torch.optim.AdamW(model.parameters(), lr=1e-6)

        def take() -> None:
            with torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
                output = model(pixels.to(memory_format=layout))
            depth = torch.nn.functional.interpolate(output.depth.float(), size, mode="bilinear", align_corners=True)
            losses.silog(depth, target, known).backward()
            optimizer.step()
            optimizer.zero_grad()

        return take

    precisions = ("float32", "bfloat16") if resolve("auto") == "bf16-mixed" else ("float32",)
    rows = {
        f"{name}{layout}": step(bfloat16=name == "bfloat16", channels_last=not layout)
        for name in precisions
        for layout in (", channels first", "")
    }
    seconds: dict[str, list[float]] = defaultdict(list)
    for number in range(rounds + 1):
        for name, take in rows.items():
            started = time.perf_counter()
            take()
            if number:
                seconds[name].append(time.perf_counter() - started)
    print(f"A step of {batch} images of {size[0]}x{size[1]}, {torch.get_num_threads()} threads\n")
    print("| | s | least - most | ratio |\n|---|---:|---:|---:|")
    base = statistics.median(seconds["float32"])
    for name, times in seconds.items():
        median = statistics.median(times)
        print(f"| {name} | {median:.2f} | {min(times):.2f} - {max(times):.2f} | {median / base:.2f} |")
    shares = {name: _shares(rows[name]) for name in precisions}
    print(f"\n| share of the time | {' | '.join(precisions)} |\n|---|{len(precisions) * '---:|'}")
    for kind in (*KINDS, "others"):
        print(f"| {kind} | {' | '.join(f'{shares[name][kind]:.0%}' for name in precisions)} |")


def _shares(take: Callable[[], None]) -> dict[str, float]:
    """Return the share of a step's time that each kind of operation takes, of three steps."""
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU]) as profiler:
        for _ in range(3):
            take()
    times: dict[str, float] = defaultdict(float)
    for event in profiler.key_averages():
        kind = next((kind for kind, names in KINDS.items() if event.key.startswith(names)), "others")
        times[kind] += event.self_cpu_time_total
    return {kind: times[kind] / sum(times.values()) for kind in (*KINDS, "others")}


if __name__ == "__main__":
    tyro.cli(main)
