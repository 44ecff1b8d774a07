"""Graphs whose weights stay in their safetensors file, and the one in the package."""

from pathlib import Path
from typing import Any

import onnx
import pytest
import torch
from tests.export.models import DOMAINS, PAIR, beit

from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.export import graph as graphs
from zoedepth.export.graph import tensor_places, write_graph
from zoedepth.weights.exported import OnnxModel, load_exported
from zoedepth.weights.load import load_for_prediction, load_model, load_network
from zoedepth.weights.releases import RELEASES
from zoedepth.weights.save import save_model

LITE = RELEASES["zoed-lite"]


def weights_of(path: Path) -> list[Any]:
    return list(onnx.load(path, load_external_data=False).graph.initializer)


@torch.no_grad()
def test_a_graph_computes_from_the_file_beside_it_what_torch_computes(tiny_config: ModelConfig, tmp_path: Path) -> None:
    file = tmp_path / "model.safetensors"
    save_model(beit(tiny_config, 2), file, dtype=torch.float16)
    path = write_graph(file)
    assert path == tmp_path / "model.onnx"
    assert load_exported(path).config.domains == DOMAINS
    others = beit(tiny_config, 2)
    for weight in others.parameters():
        weight.mul_(1.5)
    found = []
    for model in (load_network(file), others):  # whose weights the graph has never seen
        save_model(model, file, dtype=torch.float16)
        network, exported = load_network(file), load_exported(path)
        for domain in (torch.tensor([0, 1]), torch.tensor([1, 0])):
            found.append(exported(PAIR, domain=domain).depth)
            torch.testing.assert_close(found[-1], network(PAIR, domain=domain).depth, rtol=1e-4, atol=1e-4)
    assert not torch.allclose(found[0], found[2], rtol=1e-3)


def test_a_weight_that_is_not_in_the_file_is_an_error(
    tiny_config: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "model.safetensors"
    save_model(beit(tiny_config, 1), file)

    def traced(_: object, path: Path, *, fold: bool) -> None:
        assert not fold
        weight = onnx.helper.make_tensor("model.strange", onnx.TensorProto.FLOAT, [1], [0])
        onnx.save(onnx.helper.make_model(onnx.helper.make_graph([], "g", [], [], [weight])), path)

    monkeypatch.setattr(graphs, "write_onnx", traced)
    with pytest.raises(InputError, match=r"a weight model\.strange, which is not in the file"):
        write_graph(file)
    assert not file.with_suffix(".onnx").exists()


def test_the_graph_in_the_package_names_each_weight_of_its_file() -> None:
    assert LITE.graph is not None
    places = tensor_places(LITE.path)
    named = {weight.name: weight for weight in weights_of(LITE.path.with_name(LITE.graph)) if weight.external_data}
    for name, (kind, offset, length) in places.items():
        if kind == "I64":  # counters of batch norms
            continue
        weight = named.pop(f"model.{name}" + (".half" if kind == "F16" else ""))
        entries = {entry.key: entry.value for entry in weight.external_data}
        assert entries == {"location": LITE.path.name, "offset": str(offset), "length": str(length)}
    assert not named


@torch.no_grad()
def test_the_graph_in_the_package_computes_what_torch_computes() -> None:
    quick, network = load_for_prediction("zoed-lite", device="cpu"), load_model("zoed-lite")
    assert isinstance(quick, OnnxModel)
    assert quick.config == network.config, "write the graph anew: python scripts/package_graph.py"
    assert quick.provenance == network.provenance
    pixels = torch.rand(2, 3, 8, 11, generator=torch.Generator().manual_seed(0))
    pixels = torch.nn.functional.interpolate(pixels, (128, 192), mode="bilinear")
    found, expected = quick(pixels, return_std=True), network(pixels, return_std=True)
    torch.testing.assert_close(found.depth, expected.depth, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(found.std, expected.std, rtol=1e-3, atol=1e-3)
