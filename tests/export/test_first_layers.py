"""The first layers of EfficientNets are marked, so that OpenVINO computes them in float32."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import openvino
import openvino.opset13 as ops

from zoedepth.export.first_layers import keep_in_float32

STAGES = "/encoder/network/stages"


def convolution(x: openvino.Node, n: int, name: str) -> openvino.Node:
    weights = np.random.default_rng(0).normal(size=(n, x.get_output_partial_shape(0)[1].get_length(), 1, 1))
    return ops.convolution(x, weights.astype(np.float32), [1, 1], [0, 0], [0, 0], [1, 1], name=name)


def marked(path: Path) -> list[str | None]:
    layers = ElementTree.parse(path).getroot().iter("layer")
    return [layer.get("name") for layer in layers if layer.find("rt_info/attribute[@name='precise']") is not None]


def test_first_layers_are_marked_and_others_not(tmp_path: Path) -> None:
    pixels = ops.parameter([1, 3, -1, -1], np.float32, name="pixel_values")
    x = convolution(pixels, 4, f"{STAGES}/conv_stem/Conv")
    x = ops.clamp(x, 0.0, 6.0, name=f"{STAGES}/bn1/act/Clip")
    x = convolution(x, 4, f"{STAGES}/blocks.0/blocks.0.0/conv_pw/Conv")
    x = convolution(x, 4, f"{STAGES}/blocks.1/blocks.1.0/conv_pw/Conv")
    x = ops.clamp(x, 0.0, 6.0, name=f"{STAGES}/blocks.1/blocks.1.0/bn1/act/Clip")
    path, image = tmp_path / "model.xml", np.random.default_rng(1).normal(size=(1, 3, 5, 7)).astype(np.float32)
    openvino.save_model(openvino.Model([x], [pixels], "model"), path, compress_to_fp16=False)
    float32 = {"INFERENCE_PRECISION_HINT": "f32"}
    before = openvino.compile_model(path, "CPU", float32)(image)[0]
    keep_in_float32(path)
    assert marked(path) == [
        f"{STAGES}/conv_stem/Conv",
        f"{STAGES}/bn1/act/Clip",
        f"{STAGES}/blocks.0/blocks.0.0/conv_pw/Conv",
    ]
    np.testing.assert_allclose(openvino.compile_model(path, "CPU", float32)(image)[0], before, rtol=1e-5, atol=1e-5)
    core = openvino.Core()
    compiled = core.compile_model(path, "CPU", {"INFERENCE_PRECISION_HINT": "bf16"})
    numbers = {
        node.get_friendly_name(): node.get_rt_info()["runtimePrecision"].astype(str)
        for node in compiled.get_runtime_model().get_ops()
    }
    first, other = (f"{STAGES}/blocks.{n}/blocks.{n}.0/conv_pw/Conv" for n in (0, 1))
    assert numbers[first] == "f32"
    has_bfloat16 = "BF16" in core.get_property("CPU", "OPTIMIZATION_CAPABILITIES")
    assert numbers[other] == ("bf16" if has_bfloat16 else "f32")
