"""Graphs in 8-bit integers: how far they may differ, and which layers go back to float32 where they differ more."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import openvino
import openvino.opset13 as ops
import pytest
import torch
from PIL import Image
from tests.export.models import DOMAINS, flat

from zoedepth.config import ModelConfig
from zoedepth.export import int8, write
from zoedepth.export.int8 import mean_rel, prepared, quantized, some
from zoedepth.export.write import ExportError


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    coarse = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    path = tmp_path / "photo.png"
    Image.fromarray(coarse).resize((96, 64)).save(path)
    return path


def n_quantized(graph: Any) -> int:
    return sum(node.get_type_name() == "FakeQuantize" for node in graph.get_ops())


def two_layers() -> Any:
    """A graph of two convolutions: the channels of the first have ranges that 8 bits of one scale cannot hold."""
    rng = np.random.default_rng(0)
    pixels = ops.parameter([1, 3, -1, -1], np.float32, name="pixel_values")
    first = (
        rng.normal(size=(8, 3, 3, 3)).astype(np.float32) * np.logspace(-3, 3, 8, dtype=np.float32)[:, None, None, None]
    )
    second = rng.normal(size=(1, 8, 1, 1)).astype(np.float32) / np.logspace(-3, 3, 8, dtype=np.float32)[:, None, None]
    x = ops.relu(ops.convolution(pixels, first, [1, 1], [1, 1], [1, 1], [1, 1], name="/encoder/first"))
    x = ops.convolution(x, second, [1, 1], [0, 0], [0, 0], [1, 1], name="/decoder/second")
    depth = ops.add(ops.abs(ops.squeeze(x, np.array([1]))), np.float32(0.5))
    depth.output(0).set_names({"predicted_depth"})
    pixels.output(0).set_names({"pixel_values"})
    return openvino.Model([depth], [pixels], "two layers")


def test_layers_go_back_to_float32_until_the_depth_is_close_enough(tiny_config: ModelConfig, photo: Path) -> None:
    graph, model = two_layers(), SimpleNamespace(config=replace(tiny_config, domains=DOMAINS[:1]))
    inputs = [{"pixel_values": prepared(cast(Any, model), photo)}]

    def rel(graph: Any) -> float:
        return mean_rel(int8._depths(int8._compiled(graph), inputs), expected)

    expected = int8._depths(int8._compiled(graph), inputs)
    careful = quantized(cast(Any, model), graph, [photo])
    assert rel(careful) <= int8.TOLERANCE_INT8
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(int8, "TOLERANCE_INT8", 1e9)
        plain = quantized(cast(Any, model), graph, [photo])
    assert rel(plain) > int8.TOLERANCE_INT8
    assert n_quantized(careful) < n_quantized(plain)


@pytest.mark.parametrize(("factor", "allowed"), [(1.009, True), (0.991, True), (1.011, False), (0.989, False)])
def test_a_file_may_differ_by_one_percent(
    tiny_config: ModelConfig, photo: Path, factor: float, allowed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = flat(tiny_config, 1)

    def exported(pixels: torch.Tensor) -> SimpleNamespace:
        return SimpleNamespace(depth=factor * model(pixels).depth, domain=torch.zeros(1, dtype=torch.long))

    monkeypatch.setattr(write, "load_exported", lambda _: exported)
    if allowed:
        assert write._check_int8(model, Path("m.xml"), [photo]) == pytest.approx(0.009, abs=1e-5)
        return
    with pytest.raises(ExportError, match=r"m.xml .* on 1 photos the mean relative difference is 0\.011, and 0\.01 is"):
        write._check_int8(model, Path("m.xml"), [photo])


def test_mean_difference_is_that_of_the_photos_and_infinite_without_depth() -> None:
    one, two = np.full((1, 2, 2), 2.0), np.full((1, 2, 2), 4.0)
    assert mean_rel([one * 1.1, two], [one, two]) == pytest.approx(0.05)
    assert mean_rel([one, two * np.nan], [one, two]) == np.inf


def test_photos_to_compare_on_are_spread_evenly() -> None:
    assert list(some(range(5))) == [0, 1, 2, 3, 4]
    assert list(some(range(100))) == [0, 13, 26, 39, 52, 65, 78, 91]
