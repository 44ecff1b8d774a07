"""The memory that each head, and each baseline, needs beyond its weights. Linux only.

    python -m benchmarks.heads_memory

Heads are those of their default configs, with one domain, on random decoder features of 256 channels as a photo of
384x512 gives them; baselines are whole, at the size they were published for. Inference at batch 1 and 16, and forward,
loss and backward at batch 1, in float32. Each is measured in a process of its own: the most memory resident while it
runs, beyond what is resident just before, when torch is loaded, weights and inputs are there, and it has run once on
small inputs. Gradients count, those of the features among them; the optimizer's state does not. Prints a Markdown
table.
"""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
import tyro
from torch import Tensor, nn

from zoedepth.build import build_model
from zoedepth.config import HEAD_CONFIGS, INDOOR, AnyModelConfig
from zoedepth.data.sample import Batch
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads import HEADS
from zoedepth.model.heads.output import HeadOutput
from zoedepth.model.interface import DepthOutput
from zoedepth.model.upsample import upsample
from zoedepth.presets import BASELINES, MINIATURE
from zoedepth.train.config import TrainConfig
from zoedepth.train.metric import metric_losses

SIZE, SMALL = (384, 512), (64, 64)
"""(height, width) of the photo whose features a head is given; and of the one it warms up on."""
CHANNELS = DecoderChannels(256, (256, 256, 256, 256), 32)

STEPS: dict[str, tuple[bool, int]] = {
    "inference, batch 1": (False, 1),
    "inference, batch 16": (False, 16),
    "training, batch 1": (True, 1),
}
"""Column of the table → whether it trains, and its batch."""
SYSTEMS = [*HEAD_CONFIGS, *(name for name in BASELINES if name.endswith("-n"))]
"""Rows of the table: heads, and baselines as published for NYU."""

# Any tensor above this is memory of its own, given back when it is freed: what is resident is then what is in use.
_ALLOCATOR = {"MALLOC_MMAP_THRESHOLD_": str(64 * 1024)}


def main(*, only: tuple[str, ...] = (), steps: tuple[str, ...] = ()) -> None:
    """Measure and print.

    Args:
        only: rows to do; none given: all.
        steps: columns to do; none given: all.
    """
    columns = steps or tuple(STEPS)
    print(f"| MB, {torch.get_num_threads()} threads | parameters | {' | '.join(columns)} |")
    print(f"|---|---:|{'---:|' * len(columns)}")
    for name in only or SYSTEMS:
        with torch.device("meta"):
            n_parameters = sum(p.numel() for p in _network(name).parameters())
        cells = [f"{_measured_apart(name, column) / 1e6:.0f}" for column in columns]
        print(f"| {name} | {n_parameters / 1e6:.2f} M | {' | '.join(cells)} |", flush=True)


def _measured_apart(name: str, step: str) -> int:
    code = f"from benchmarks.heads_memory import measure; print(measure({name!r}, {step!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | _ALLOCATOR, stdout=subprocess.PIPE, text=True, check=True
    )
    return int(done.stdout)


def measure(name: str, step: str) -> int:
    """Bytes that a step of a system needs beyond its weights and inputs, in this process."""
    torch.manual_seed(0)
    training, batch = STEPS[step]
    network = _network(name).train(training)
    run = _trained if training else _inferred
    # Code is loaded, and buffers of threads are made, when they are first needed. Two images: batch normalisation.
    run(network, _inputs(name, batch=2, small=True))
    network.zero_grad()
    inputs = _inputs(name, batch=batch, small=False)
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak is that from here on
    before = _resident("VmRSS")
    run(network, inputs)
    return _resident("VmHWM") - before


def _resident(field: str) -> int:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(re.findall(rf"{field}:\s+(\d+) kB", status)[0])


class _Head(nn.Module):
    """Both parts of a head, as a model has them."""

    def __init__(self, name: str) -> None:
        super().__init__()
        config = HEAD_CONFIGS[name]()
        parts = HEADS[type(config)]
        self.shared = parts.shared(CHANNELS, config)
        self.domain = parts.domain(CHANNELS, config, INDOOR)

    def forward(self, features: DecoderFeatures) -> DepthOutput:
        output: HeadOutput = self.domain(self.shared(features))
        size, n = features.last.shape[-2:], len(features.last)
        depth = upsample(output.depth, size)
        none = torch.zeros(n, dtype=torch.long)
        return DepthOutput(depth, None, none, None, None, None, None, output.supervision)


def _network(name: str) -> nn.Module:
    return _Head(name) if name in HEAD_CONFIGS else build_model(BASELINES[name])


def _inputs(name: str, *, batch: int, small: bool) -> Tensor | DecoderFeatures:
    """Random decoder features, which have gradients as in training, or pixels, which have none."""
    if name not in HEAD_CONFIGS:
        config: AnyModelConfig = BASELINES[name]
        return torch.rand(batch, 3, *(SMALL if small and not config.one_size else config.size))
    height, width = SMALL if small else SIZE

    def noise(channels: int, stride: int) -> Tensor:
        return torch.randn(batch, channels, height // stride, width // stride, requires_grad=True)

    levels = tuple(noise(channels, stride) for channels, stride in zip(CHANNELS.levels, (16, 8, 4, 2), strict=True))
    return DecoderFeatures(noise(CHANNELS.bottleneck, 32), levels, noise(CHANNELS.last, 1), noise(1, 1))


@torch.inference_mode()
def _inferred(network: Callable[..., DepthOutput], inputs: Tensor | DecoderFeatures) -> None:
    network(inputs)


def _trained(network: Callable[..., DepthOutput], inputs: Tensor | DecoderFeatures) -> None:
    """Forward, the system's own loss, and backward."""
    output = network(inputs)
    target = torch.linspace(1, 9, output.depth.numel()).view_as(output.depth)
    mask, none = torch.ones_like(target, dtype=torch.bool), torch.zeros(len(target), dtype=torch.long)
    batch = Batch(target, target, mask, none, none, ["random"] * len(target), "depth")
    config = TrainConfig("metric", replace(MINIATURE, domains=(INDOOR,)), (), steps=1)
    torch.stack(list(metric_losses(output, batch, config, ()).values())).sum().backward()


if __name__ == "__main__":
    tyro.cli(main)
