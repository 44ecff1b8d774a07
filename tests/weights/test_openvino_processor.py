"""Answers of OpenVINO about this processor, whichever it is: they hold for other graphs, too."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import openvino.opset13
import pytest

from zoedepth.weights.openvino_processor import EXACT, adds_8_bits_exactly, has_bfloat16

operators: Any = openvino.opset13
Model: Any = openvino.Model


@pytest.fixture(autouse=True)
def asked_anew() -> Iterator[None]:
    """Neither an answer from before is taken, nor one from here kept."""
    for question in (adds_8_bits_exactly, has_bfloat16):
        question.cache_clear()
    yield
    for question in (adds_8_bits_exactly, has_bfloat16):
        question.cache_clear()


def largest_sum(options: dict[str, str]) -> float:
    """The sum of 200 products of the largest 8-bit numbers, in units of the true one, as a matrix product."""
    x = operators.parameter([1, 200], np.float32)
    low, high = np.float32(0), np.float32(255)
    unsigned = operators.fake_quantize(x, low, high, low, high, 256)
    low, high = np.float32(-127), np.float32(127)
    weights = operators.constant(np.full((16, 200), 127, np.float32))
    signed = operators.fake_quantize(weights, low, high, low, high, 255)
    model = Model([operators.matmul(unsigned, signed, False, True)], [x], "product")
    compiled = openvino.Core().compile_model(model, "CPU", options)
    return float(compiled(np.full((1, 200), 255, np.float32))[compiled.output(0)].flat[0]) / (255 * 127 * 200)


def test_sums_are_exact_where_it_says_so() -> None:
    assert (abs(largest_sum({}) - 1) < 0.01) == adds_8_bits_exactly()


def test_sums_are_exact_on_any_processor_with_the_options() -> None:
    assert abs(largest_sum(EXACT) - 1) < 0.01


def test_the_answer_is_openvinos(monkeypatch: pytest.MonkeyPatch) -> None:
    for capabilities, answer in ((["FP32", "INT8"], False), (["FP32", "BF16"], True)):
        monkeypatch.setattr(openvino.Core, "get_property", lambda core, device, name, said=capabilities: said)
        has_bfloat16.cache_clear()
        assert has_bfloat16() is answer
