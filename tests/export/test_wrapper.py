"""The exported form of a model computes what the model computes."""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from tests.export.models import DOMAINS, HEADS, PAIR, balanced, flat

from zoedepth.build import build_model
from zoedepth.config import ModelConfig, RouterConfig
from zoedepth.errors import FullDiskError, InputError
from zoedepth.export import export_model
from zoedepth.export.wrapper import ExportModel
from zoedepth.presets import ZOED_LITE


@pytest.mark.parametrize("name", HEADS)
@torch.no_grad()
def test_each_image_has_the_depth_of_its_own_head(name: str, tiny_config: ModelConfig):
    model = balanced(flat(HEADS[name](tiny_config), 2))
    wrapped = ExportModel(model).eval()
    for domain in (None, torch.tensor([0, 0]), torch.tensor([1, 0]), torch.tensor([1, 1])):
        expected = model(PAIR, domain=domain, return_std=True)
        found = wrapped.outputs(PAIR, torch.tensor([-1, -1]) if domain is None else domain)
        assert torch.allclose(found.predicted_depth, expected.depth[:, 0], rtol=1e-4, atol=1e-5)
        assert torch.allclose(found.domain_logits, model(PAIR).domain_logits, rtol=1e-4, atol=1e-5)
        assert (found.std is None) == (expected.std is None)
        if expected.std is not None:
            assert torch.allclose(found.std, expected.std[:, 0], rtol=1e-3, atol=1e-4)
    assert model(PAIR).domain.tolist() in ([0, 1], [1, 0])


@pytest.mark.parametrize("upsampling", ["bilinear", "convex"])
@torch.no_grad()
def test_a_model_with_one_head_needs_no_domain(tiny_config: ModelConfig, upsampling: str):
    decoder = replace(tiny_config.decoder, output_stride=2, upsampling=upsampling)
    model = flat(replace(tiny_config, decoder=decoder), 1)
    if model.convex is not None:
        torch.nn.init.normal_(model.convex.conv2.weight)
    depth, std = ExportModel(model).eval()(PAIR)
    expected = model(PAIR, return_std=True)
    assert torch.allclose(depth, expected.depth[:, 0], rtol=1e-4, atol=1e-5)
    assert torch.allclose(std, expected.std[:, 0], rtol=1e-3, atol=1e-4)


def test_models_whose_head_nothing_in_the_graph_chooses_are_refused(tiny_config: ModelConfig):
    labeled = build_model(replace(tiny_config, domains=DOMAINS, router=RouterConfig(kind="labeled")))
    voting = build_model(replace(tiny_config, router=replace(tiny_config.router, vote="batch")))
    relative = build_model(replace(ZOED_LITE, domains=()))
    for model, message in ((labeled, "labeled router"), (voting, "votes"), (relative, "without metric heads")):
        with pytest.raises(InputError, match=message):
            ExportModel(model)


def test_weights_of_other_number_types_are_refused(tiny_config: ModelConfig, tmp_path: Path):
    with pytest.raises(InputError, match=r"weights are torch.float16.*call model.float"):
        export_model(flat(tiny_config, 1).half(), tmp_path / "model.onnx", to="onnx")


def test_a_disk_without_room_is_told_before_the_work(
    tiny_config: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
    with pytest.raises(FullDiskError, match=r"has 1,000 bytes free, and the export needs about"):
        export_model(flat(tiny_config, 1), tmp_path / "model.onnx", to="onnx")
    assert list(tmp_path.iterdir()) == []
