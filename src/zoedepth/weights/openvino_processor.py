"""Two questions to OpenVINO about this processor, on which it computes other numbers without a word."""

import functools
from typing import Any

import numpy as np


@functools.cache
def has_bfloat16() -> bool:
    """Return True if OpenVINO computes in bfloat16 where it is told to. Otherwise it takes float32.

    Raises:
        ModuleNotFoundError: OpenVINO is not installed.
    """
    import openvino

    return "BF16" in openvino.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")


@functools.cache
def adds_8_bits_exactly() -> bool:
    """Return True if sums of products of 8-bit integers are exact.

    Processors of x86 without VNNI add two products in 16 bits, and cut off what is larger: half of the largest sums.
    The same graph then gives other numbers than where it was made and checked. A small layer shows it.

    Raises:
        ModuleNotFoundError: OpenVINO is not installed.
    """
    import openvino
    from openvino import opset13 as operators

    n_channels, largest = 64, np.full((64, 64, 1, 1), 127, np.float32)
    x = operators.parameter([1, n_channels, 4, 4], np.float32)
    low, high = np.float32(0), np.float32(255)
    unsigned = operators.fake_quantize(x, low, high, low, high, 256)
    low, high = np.float32(-127), np.float32(127)
    signed = operators.fake_quantize(operators.constant(largest), low, high, low, high, 255)
    layer = operators.convolution(unsigned, signed, [1, 1], [0, 0], [0, 0], [1, 1])
    model: Any = openvino.Model
    compiled = openvino.Core().compile_model(model([layer], [x], "sums"), "CPU")
    found = compiled(np.full((1, n_channels, 4, 4), 255, np.float32))[compiled.output(0)]
    return bool(np.allclose(found, 255 * 127 * n_channels, rtol=0.01))


EXACT: dict[str, str] = {"LP_TRANSFORMS_MODE": "OFF"}
"""Options with which OpenVINO rounds to 8 bits and multiplies in float32: exact on any processor, and no faster."""

UNMERGED: dict[str, str] = {"SNIPPETS_MODE": "DISABLE"}
"""Options with which OpenVINO merges no operations, and so needs no more registers than there are."""
