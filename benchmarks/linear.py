"""Products of BEiT-L's linear layers in float32 without gradients: as torch has them, or as 1x1 convolutions.

On a processor of AMD with AVX-512; or on one of Intel with ``MKL_ENABLE_INSTRUCTIONS=AVX2``, which makes MKL take the
path that it takes there.
"""

import torch
from torch import nn

from benchmarks.timing import compare
from zoedepth.model.linear import ConvolvedLinear


@torch.no_grad()
def main() -> None:
    """The four layers of a block, for the 769 tokens of 384x512."""
    for name, channels, output_channels in (
        ("query, key, value", 1024, 3072),
        ("projection", 1024, 1024),
        ("first of the MLP", 1024, 4096),
        ("second of the MLP", 4096, 1024),
    ):
        x = torch.randn(1, 769, channels)
        linear, convolved = nn.Linear(channels, output_channels), ConvolvedLinear(channels, output_channels)
        compare(f"{name}, {channels} to {output_channels}", {
            "linear": lambda x=x, linear=linear: linear(x),
            "convolution": lambda x=x, convolved=convolved: convolved(x),
        })  # fmt: skip
