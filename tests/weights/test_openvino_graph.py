"""Changed graphs compute what they computed before."""

from typing import Any

import numpy as np
import openvino.opset13
import pytest

from zoedepth.weights.openvino_graph import make_products_unsigned, specialized

operators: Any = openvino.opset13
Model: Any = openvino.Model


def run(graph: Any, *inputs: np.ndarray) -> list[np.ndarray]:
    core: Any = openvino.Core()
    compiled = core.compile_model(graph, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    results = compiled(list(inputs))
    return [results[output] for output in compiled.outputs]


def kinds(graph: Any) -> list[str]:
    return [node.get_type_name() for node in graph.get_ops()]


def distribution_graph(*, attention: bool) -> Any:
    """Two outputs, predicted_depth and std, of a softmax that is used by products of pairs or of matrices."""
    pixels = operators.parameter([-1, 3, -1, -1], np.float32, name="pixel_values")
    maps = operators.transpose(pixels, operators.constant([0, 2, 3, 1]))
    weight = operators.constant(np.random.default_rng(0).normal(size=(3, 64)).astype(np.float32))
    probability = operators.softmax(operators.matmul(maps, weight, False, False), 3)
    centers = operators.constant(np.linspace(1, 9, 64, dtype=np.float32))
    if attention:
        mean = operators.matmul(probability, operators.unsqueeze(centers, operators.constant([1])), False, False)
    else:
        mean = operators.reduce_sum(operators.multiply(probability, centers), operators.constant([3]), True)
    std = operators.sqrt(mean)
    for output, name in ((mean, "predicted_depth"), (std, "std"), (pixels, "pixel_values")):
        output.output(0).set_names({name})
    return Model([mean, std], [pixels])


@pytest.mark.parametrize("attention", [False, True])
def test_a_special_graph_gives_the_same(attention: bool):
    graph = distribution_graph(attention=attention)
    pixels = np.random.default_rng(1).normal(size=(2, 3, 64, 96)).astype(np.float32)
    mean, std = run(graph, pixels)
    before = kinds(graph)
    for shape in (None, pixels.shape):
        special = specialized(graph, shape=shape, without=("std",))
        found = run(special, pixels)
        assert len(found) == 1
        assert np.allclose(found[0], mean, rtol=1e-5)
        assert ("Softmax" in kinds(special)) == (attention or shape is None)
    both = run(specialized(graph, shape=pixels.shape, without=()), pixels)
    assert np.allclose(both[0], mean, rtol=1e-5)
    assert np.allclose(both[1], std, rtol=1e-5)
    assert kinds(graph) == before


def test_a_softmax_far_from_zero_stays_finite():
    graph = distribution_graph(attention=False)
    pixels = 1e4 * np.random.default_rng(1).normal(size=(1, 3, 64, 96)).astype(np.float32)
    (found,) = run(specialized(graph, shape=pixels.shape, without=("std",)), pixels)
    assert np.isfinite(found).all()
    assert np.allclose(found, run(graph, pixels)[0], rtol=1e-5)


@pytest.mark.parametrize(("low", "high", "point"), [(-4.0, 4 * 127 / 128, 127), (-1.0, 3.0, 64), (0.0, 2.0, 0)])
def test_inputs_of_products_get_a_zero_point(low: float, high: float, point: int):
    x = operators.parameter([5, 8], np.float32)
    generator = np.random.default_rng(0)
    integers = operators.constant(generator.integers(-127, 128, (8, 6)).astype(np.int8))
    weight = operators.multiply(operators.convert(integers, "f32"), operators.constant(np.float32(0.01)))
    bounds = [operators.constant(np.float32(bound)) for bound in (low, high, low, high)]
    quantized = operators.fake_quantize(x, *bounds, 256)
    graph = Model([operators.matmul(quantized, weight, False, False)], [x])
    values = generator.uniform(low, high, (5, 8)).astype(np.float32)
    (before,) = run(graph, values)
    make_products_unsigned(graph)
    (node,) = [node for node in graph.get_ops() if node.get_type_name() == "FakeQuantize"]
    found = [float(node.input_value(at).get_node().data.reshape(())) for at in (1, 2, 3, 4)]
    assert found[:2] == found[2:]
    assert round(-found[0] / (found[1] - found[0]) * 255) == point
    step = (high - low) / 255
    assert np.abs(run(graph, values)[0] - before).max() <= 8 * 1.27 * 1.1 * step


def test_what_meets_no_weight_keeps_its_sign():
    """Queries and keys, whose product is fused as it is."""
    x = operators.parameter([5, 5], np.float32)
    bounds = [operators.constant(np.float32(bound)) for bound in (-4, 4 * 127 / 128) * 2]
    quantized = operators.fake_quantize(x, *bounds, 256)
    graph = Model([operators.matmul(quantized, quantized, False, True)], [x])
    make_products_unsigned(graph)
    (node,) = [node for node in graph.get_ops() if node.get_type_name() == "FakeQuantize"]
    assert float(node.input_value(1).get_node().data.reshape(())) == -4
