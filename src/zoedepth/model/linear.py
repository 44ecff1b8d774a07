"""Linear layers for processors on which torch multiplies matrices slowly."""

import functools
import os
import platform
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.errors import InputError

SWITCH = "ZOEDEPTH_SLOW_PRODUCTS"
"""Environment variable that decides in place of the processor: "1", products are slow; "0", they are not."""


def products_are_slow() -> bool:
    """Return True if torch's float32 matrix products are slow here, at about half the speed of its convolutions.

    The environment variable ``ZOEDEPTH_SLOW_PRODUCTS`` decides; without it, the processor does.

    Raises:
        InputError: the variable is neither 0 nor 1.
    """
    forced = os.environ.get(SWITCH)
    if forced is None:
        return _processor_is_slow()
    if forced not in ("0", "1"):
        raise InputError(f"{SWITCH} is {forced!r}. Set it to 1 (slow) or 0 (not slow), or unset it.")
    return forced == "1"


@functools.cache
def _processor_is_slow() -> bool:
    """Return True if MKL, which makes the products, leaves this processor's AVX-512 unused.

    MKL uses it on Intel's processors only. oneDNN, which makes the convolutions, uses it on any. Where there is only
    AVX2, both use that, and the convolutions are slower: on AMD a forward of ZoeD-M12-NK takes 1.3 times as long.
    ``MKL_ENABLE_INSTRUCTIONS=AVX2`` gives MKL on Intel's processors the speed it has on others.
    """
    if not torch.backends.mkl.is_available() or torch.backends.cpu.get_cpu_capability() != "AVX512":
        return False
    if "MKL_ENABLE_INSTRUCTIONS" in os.environ:
        return not os.environ["MKL_ENABLE_INSTRUCTIONS"].startswith("AVX512")
    try:
        about = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        about = platform.processor()
    return "AuthenticAMD" in about


class ConvolvedLinear(nn.Linear):
    """A linear layer that runs as a 1x1 convolution over its rows: in float32 on the CPU without gradients."""

    def forward(self, input: Float[Tensor, "*rows channels"]) -> Float[Tensor, "*rows output_channels"]:
        """Return what ``nn.Linear`` returns, up to rounding."""
        other = torch.is_grad_enabled() or input.device.type != "cpu" or input.dtype != torch.float32
        if other or torch.is_autocast_enabled("cpu") or torch.compiler.is_compiling():
            return super().forward(input)
        rows = input.reshape(1, 1, -1, input.shape[-1]).permute(0, 3, 1, 2)  # channels last, as they are in memory
        out = F.conv2d(rows, self.weight[:, :, None, None], self.bias)
        return out.permute(0, 2, 3, 1).reshape(*input.shape[:-1], -1)


def replace_linear(network: nn.Module) -> None:
    """Replace each linear layer by a ``ConvolvedLinear`` with the same parameters, if products are slow here.

    ``Encoder`` applies it once, when it is built, and nothing else does: so a ZoeDepth has the same layers however it
    is built, loaded or copied.
    """
    if not products_are_slow():
        return
    modules: list[Any] = list(network.modules())
    for parent in modules:
        if hasattr(parent, "qkv_bias_separate"):  # then timm's attention calls its layer; else it takes the weight only
            parent.qkv_bias_separate = True
        for name, linear in parent.named_children():
            if type(linear) is nn.Linear:
                twin = ConvolvedLinear(linear.in_features, linear.out_features, bias=False, device="meta")
                twin.weight, twin.bias = linear.weight, linear.bias
                setattr(parent, name, twin)
