"""Runtimes: their names, why one cannot run here, and what they load."""

from dataclasses import replace
from pathlib import Path

import pytest

from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.runtimes import runtime as runtimes
from zoedepth.runtimes.machine import Machine
from zoedepth.runtimes.runtime import BASE, RUNTIMES, Runtime
from zoedepth.weights.load import load_model
from zoedepth.weights.releases import ASSETS


def test_names_are_those_of_the_table_and_of_the_predictor(tiny_model: ZoeDepth) -> None:
    assert next(iter(RUNTIMES)) == BASE.name == Predictor(tiny_model).runtime == "torch, float32"
    assert Predictor(tiny_model, precision="bfloat16").runtime == "torch, bfloat16"
    assert Predictor(load_model(ASSETS / "zoed-lite.onnx")).runtime == "ONNX Runtime, float32"
    assert "OpenVINO, int8" in RUNTIMES
    assert Runtime("torch", "float16", on_gpu=True).name == "torch, float16, GPU"


@pytest.mark.parametrize(
    ("absent", "name", "packaged", "expected"),
    [
        ("", "OpenVINO, int8", False, ""),
        ("openvino", "OpenVINO, float32", False, "not installed: pip install 'zoedepth[openvino]'"),
        ("onnx", "OpenVINO, bfloat16", True, "not installed: pip install 'zoedepth[openvino]'"),
        ("nncf", "OpenVINO, int8", False, "not installed: pip install 'zoedepth[openvino]'"),
        ("nncf", "OpenVINO, float32", False, ""),
        ("onnx", "ONNX Runtime, float32", False, "not installed: pip install 'zoedepth[onnx]'"),
        ("onnx", "ONNX Runtime, float32", True, ""),
        ("onnxruntime", "ONNX Runtime, float32", True, "not installed: pip install 'zoedepth[onnx]'"),
        ("onnx", "torch, bfloat16", False, ""),
        ("", "torch, float16, GPU", False, "no GPU here"),
    ],
)
def test_what_is_missing_is_said(
    absent: str, name: str, packaged: bool, expected: str, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runtimes, "find_spec", lambda module: None if module == absent else object())
    assert RUNTIMES[name].missing(machine, packaged=packaged) == expected


def test_bfloat16_that_openvino_would_not_compute_is_missing(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtimes, "find_spec", lambda module: object())
    monkeypatch.setattr(runtimes, "has_bfloat16", lambda: False)
    problem = RUNTIMES["OpenVINO, bfloat16"].missing(machine)
    assert problem == "this processor has no bfloat16, and OpenVINO would compute in float32"
    assert RUNTIMES["OpenVINO, float32"].missing(machine) == ""


def test_8_bits_that_the_processor_cuts_off_are_missing(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtimes, "find_spec", lambda module: object())
    monkeypatch.setattr(runtimes, "adds_8_bits_exactly", lambda: False)
    assert "cuts off sums of 8 bits (no VNNI)" in RUNTIMES["OpenVINO, int8"].missing(machine)
    assert RUNTIMES["OpenVINO, float32"].missing(machine) == ""


def test_gpu_that_is_here_is_not_missing(machine: Machine) -> None:
    assert RUNTIMES["torch, float16, GPU"].missing(replace(machine, accelerator="H200")) == ""


def test_torch_loads_weights_and_the_others_their_file(weights: Path) -> None:
    assert isinstance(BASE.load(weights), ZoeDepth)
    assert Predictor(Runtime("ONNX Runtime", "float32").load(ASSETS / "zoed-lite.onnx")).runtime.startswith("ONNX")
