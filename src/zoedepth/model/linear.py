"""Linear layers on processors whose matrix products are slow in torch."""

import functools
import os
import platform
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


@functools.cache
def products_are_slow() -> bool:
    """Whether torch's float32 products run at about half the processor's speed, and its convolutions do not.

    MKL, which makes the products, has fast paths for Intel's processors only; oneDNN, which makes the convolutions,
    goes by what the processor can do. With ``MKL_ENABLE_INSTRUCTIONS=AVX2`` MKL is on Intel's as it is on others.
    """
    if not torch.backends.mkl.is_available():
        return False
    if "MKL_ENABLE_INSTRUCTIONS" in os.environ:
        return not os.environ["MKL_ENABLE_INSTRUCTIONS"].startswith("AVX512")
    try:
        about = Path("/proc/cpuinfo").read_text()
    except OSError:
        about = platform.processor()
    return "AuthenticAMD" in about


class ConvolvedLinear(nn.Linear):
    """A linear layer that is a 1x1 convolution over its rows, in float32 on the CPU without gradients."""

    def forward(self, input: Float[Tensor, "*rows channels"]) -> Float[Tensor, "*rows output_channels"]:
        """The same, up to rounding."""
        other = torch.is_grad_enabled() or input.device.type != "cpu" or input.dtype != torch.float32
        if other or torch.is_autocast_enabled("cpu") or torch.compiler.is_compiling():
            return super().forward(input)
        rows = input.reshape(1, 1, -1, input.shape[-1]).permute(0, 3, 1, 2)  # channels last, as they are in memory
        out = F.conv2d(rows, self.weight[:, :, None, None], self.bias)
        return out.permute(0, 2, 3, 1).reshape(*input.shape[:-1], -1)


def replace_linear(network: nn.Module) -> None:
    """Put a ``ConvolvedLinear`` with the same parameters in the place of each linear layer, where it is faster."""
    if not products_are_slow():
        return
    modules: list[Any] = list(network.modules())
    for parent in modules:
        if hasattr(parent, "qkv_bias_separate"):  # timm's attention calls its layer then, not only for its weight
            parent.qkv_bias_separate = True
        for name, linear in parent.named_children():
            if type(linear) is nn.Linear:
                twin = ConvolvedLinear(linear.in_features, linear.out_features, bias=False, device="meta")
                twin.weight, twin.bias = linear.weight, linear.bias
                setattr(parent, name, twin)
