"""Change graphs of OpenVINO so that they compute the same faster on a CPU."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from zoedepth.weights.tensors import DOMAIN, INPUT

LARGE = 1 << 18
"""Count of numbers (1 MB in float32) from which a tensor is large: passing it through memory takes time."""


def specialized(graph: Any, *, shape: Sequence[int] | None, without: Sequence[str]) -> Any:
    """Copy a graph for pixels of one shape (None: any shape), without some outputs. The weights are shared."""
    special = graph.clone()
    for result in special.get_results():
        if set(without) & set(result.input_value(0).get_names()):
            special.remove_result(result)
    if shape is not None:
        names = {port.get_any_name() for port in special.inputs}
        special.reshape({INPUT: list(shape)} | ({DOMAIN: shape[:1]} if DOMAIN in names else {}))
        _look_up_biases_late(special)
        _spell_softmax(special)
    return special


def _look_up_biases_late(graph: Any) -> None:
    """Keep BEiT's position biases out of memory: look them up in small tables when a block needs them.

    In a graph for one shape the biases are constants. OpenVINO would compute and keep them, 0.9 GB for BEiT-L.
    A zero that is made from the pixels is added to the indices, so that the biases seem to depend on the pixels.
    """
    from openvino import opset13 as operators

    lookups = [node for node in graph.get_ops() if node.get_type_name() == "Gather" and _is_large(node)]
    if not lookups:
        return
    first = operators.gather(
        operators.reshape(graph.input(INPUT), operators.constant([-1]), False),
        operators.constant([0]), operators.constant(0),
    )  # fmt: skip
    zero = operators.clamp(first, 0.0, 0.0)
    for node in lookups:
        index = node.input_value(1)
        moved = operators.add(index, operators.convert(zero, index.get_element_type().to_string()))
        node.input(1).replace_source_output(moved.output(0))


def _spell_softmax(graph: Any) -> None:
    """Write the softmax over the bins as exp(x - max) / sum, which works with any layout of memory.

    OpenVINO's own softmax needs the bins side by side in memory. No operation around it stores them so: OpenVINO copied
    large maps five times.
    """
    from openvino import opset13 as operators

    for node in graph.get_ops():
        if node.get_type_name() != "Softmax" or not _is_large(node):
            continue
        axis = node.get_attributes()["axis"]
        users = [port.get_node().get_type_name() for port in node.output(0).get_target_inputs()]
        if any(user == "MatMul" for user in users):  # attention: OpenVINO fuses it as it is
            continue
        x, axes = node.input_value(0), operators.constant([axis])
        exp = operators.exp(operators.subtract(x, operators.reduce_max(x, axes, True)))
        # OpenVINO would recognise exp / sum and make it a softmax again.
        one = operators.constant(np.float32(1))
        probability = operators.multiply(exp, operators.divide(one, operators.reduce_sum(exp, axes, True)))
        for port in node.output(0).get_target_inputs():
            port.replace_source_output(probability.output(0))


def _is_large(node: Any) -> bool:
    shape = node.get_output_partial_shape(0)
    return shape.is_static and math.prod(shape.to_shape()) > LARGE


def make_products_unsigned(graph: Any) -> None:
    """Make the inputs of 8-bit matrix products unsigned with a zero point.

    Processors with AVX-512 VNNI but without AMX multiply unsigned by signed numbers: signed inputs take a third longer.
    Where a range happens to be symmetric, calibration makes the input signed (zero point 128): the range is moved by
    one step.
    """
    from openvino import opset13 as operators

    for node in graph.get_ops():
        if node.get_type_name() != "FakeQuantize" or node.get_attributes()["levels"] != 256:
            continue
        users = [port.get_node() for port in node.output(0).get_target_inputs()]
        if not all(user.get_type_name() == "MatMul" and _is_weight(user.input_value(1).get_node()) for user in users):
            continue
        low, high = (node.input_value(at).get_node().data for at in (1, 2))
        if not (np.rint(-low / (high - low) * 255) == 128).any():
            continue
        step = np.maximum(-low / 127, high / 128)
        for at, bound in ((1, -127 * step), (2, 128 * step), (3, -127 * step), (4, 128 * step)):
            node.input(at).replace_source_output(operators.constant(bound.astype(np.float32)).output(0))


def _is_weight(node: Any) -> bool:
    """Return True if the node depends on constants only."""
    inputs = [port.get_source_output().get_node() for port in node.inputs()]
    return all(_is_weight(source) for source in inputs) if inputs else node.get_type_name() == "Constant"
