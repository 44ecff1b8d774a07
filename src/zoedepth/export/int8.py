"""Graphs of OpenVINO in 8-bit integers: calibrated on photos, and compared with float32 on some of them."""

import logging
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from zoedepth.config import ModelConfig
from zoedepth.export.first_layers import FIRST_LAYERS
from zoedepth.images import read_image
from zoedepth.model.interface import DepthModel
from zoedepth.pixels import resize_pixels
from zoedepth.sizes import network_size
from zoedepth.weights.openvino_graph import make_products_unsigned
from zoedepth.weights.openvino_processor import EXACT, adds_8_bits_exactly
from zoedepth.weights.tensors import DOMAIN, INPUT

TOLERANCE_INT8 = 0.01
"""Largest mean of |int8 - float32| / float32 over photos that is allowed."""

N_COMPARED = 8
"""Photos on which int8 is compared with float32, at most."""

_QUANTIZED = "^(?!/(model|encoder|decoder|shared)/|ConvolutionBackpropData).*$"
"""Layers without a part in int8. Nodes are named after their modules; transposed convolutions, which only decoders
have, are not."""


def quantized(
    model: DepthModel,
    converted: Any,
    photos: Sequence[str | Path],
    *,
    accuracy_control: bool = True,
    tell: Callable[[str], object] = lambda _: None,
) -> Any:
    """Return a graph of OpenVINO whose encoder and decoder compute in 8-bit integers.

    Where its depth differs more than ``TOLERANCE_INT8`` allows, NNCF takes the layers back to float32 one by one, those
    first whose 8 bits cost most, until it does not. That compiles the graph once for each, which takes long.

    Args:
        model: the model.
        converted: its graph in float32.
        photos: photos to calibrate on, a few hundred like those that the model will see.
        accuracy_control: False takes no layer back.
        tell: called with a sentence before layers are taken back.
    """
    import nncf

    nncf.set_log_level(logging.ERROR)  # it would print the name of every node that stays in float32
    config = model.config
    transformer = isinstance(config, ModelConfig) and config.encoder.family != "convolutional"
    choice = {DOMAIN: np.array([-1])} if len(config.domains) > 1 else {}
    inputs = [{INPUT: prepared(model, photo)} | choice for photo in photos]
    compared = some(inputs)
    expected = _depths(_compiled(converted), compared)
    ignored = nncf.IgnoredScope(patterns=[_QUANTIZED, *(() if transformer else FIRST_LAYERS)], validate=False)
    options: dict[str, Any] = {
        "subset_size": len(inputs),
        "preset": nncf.QuantizationPreset.MIXED,
        "model_type": nncf.ModelType.TRANSFORMER if transformer else None,
        "ignored_scope": ignored,
    }
    graph = nncf.quantize(converted, nncf.Dataset(inputs), **options)
    rel = mean_rel(_depths(_compiled(graph), compared), expected)
    if rel > TOLERANCE_INT8 and accuracy_control:
        tell(
            f"In 8 bits the depth of these photos differs by {rel:.1%}: layers are taken back to float32 until it is "
            f"{TOLERANCE_INT8:.0%}, which takes minutes to hours"
        )

        def closeness(compiled: Any, data: Any) -> tuple[float, list[float]]:
            numbers = [int(number) for number in data]
            close = [1 - mean_rel(_depths(compiled, [compared[n]]), [expected[n]]) for n in numbers]
            return float(np.mean(close)), close

        numbers = range(len(compared))
        graph = nncf.quantize_with_accuracy_control(
            converted,
            nncf.Dataset(inputs),
            nncf.Dataset(numbers, lambda number: compared[number]),
            closeness,
            max_drop=TOLERANCE_INT8,
            **options,
        )
    make_products_unsigned(graph)
    return graph


def _compiled(graph: Any) -> Any:
    import openvino

    exact = {} if adds_8_bits_exactly() else EXACT
    return openvino.Core().compile_model(graph, "CPU", {"INFERENCE_PRECISION_HINT": "f32", **exact})


def _depths(compiled: Any, inputs: Sequence[dict[str, Any]]) -> list[np.ndarray]:
    """Return the depth of each input."""
    return [np.array(compiled(each)[compiled.output("predicted_depth")]) for each in inputs]


def mean_rel(found: Sequence[np.ndarray], expected: Sequence[np.ndarray]) -> float:
    """Return the mean over photos of their mean relative difference; infinite where a depth is not finite."""
    rels = [
        float(np.mean(np.abs(one - other) / np.maximum(other, 1e-6)))
        for one, other in zip(found, expected, strict=True)
    ]
    return float(np.mean(rels)) if np.isfinite(rels).all() else math.inf


def some(items: Sequence[Any]) -> Sequence[Any]:
    """Return up to ``N_COMPARED`` items, evenly spread."""
    return items[:: math.ceil(len(items) / N_COMPARED)]


def prepared(model: DepthModel, photo: str | Path) -> np.ndarray:
    """Return a photo as the network sees it: float32 (1, 3, height, width)."""
    config, image = model.config, read_image(photo)
    size = network_size(
        image.shape[:2], config.size, multiple=config.multiple, keep_aspect_ratio=config.keep_aspect_ratio
    )
    pixels = torch.tensor(image).permute(2, 0, 1)[None].float() / 255
    return resize_pixels(pixels, size, antialias=config.antialias).contiguous().numpy()
