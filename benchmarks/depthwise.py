"""Training on the CPU under bfloat16 autocast: depthwise convolutions in bfloat16 or in float32."""

import torch
from torch import nn

from benchmarks.timing import compare


def main() -> None:
    """One forward and backward of the three shapes that cost most in EfficientNet-Lite0 at 256x352, batch 8."""
    for channels, size, kernel, stride in ((96, (128, 176), 3, 2), (240, (32, 44), 5, 1), (672, (16, 22), 5, 1)):
        conv = nn.Conv2d(channels, channels, kernel, stride, kernel // 2, groups=channels, bias=False)
        conv = conv.to(memory_format=torch.channels_last)
        x = torch.randn(8, channels, *size).contiguous(memory_format=torch.channels_last).requires_grad_()

        def step(dtype: torch.dtype, conv: nn.Module = conv, x: torch.Tensor = x) -> None:
            with torch.autocast("cpu", torch.bfloat16, enabled=dtype == torch.bfloat16):
                conv(x.to(dtype)).float().sum().backward()

        compare(f"depthwise {kernel}x{kernel}, {channels} channels, {size}, stride {stride}", {
            "bfloat16": lambda step=step: step(torch.bfloat16),
            "float32": lambda step=step: step(torch.float32),
        })  # fmt: skip
