"""Exported files: the same depth as torch at any size, and nothing left behind where it is not."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from tests.baselines.test_every_baseline import build as build_baseline
from tests.model.heads import test_bts, test_dorn, test_splitter
from tests.model.test_encoder import TINY_SWIN

import zoedepth.export.write
from zoedepth import Predictor, load_model, save_model
from zoedepth.build import build_model
from zoedepth.cli import main
from zoedepth.config import Domain, ModelConfig, RouterConfig
from zoedepth.errors import InputError
from zoedepth.export import export_model, load_exported
from zoedepth.export.write import ExportError
from zoedepth.model.interface import DepthModel
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import ZOED_LITE
from zoedepth.weights.exported import OpenVinoModel
from zoedepth.weights.openvino_graph import LARGE

DOMAINS = (Domain("indoor", 1e-3, 10.0), Domain("outdoor", 1e-3, 80.0))


def beit(tiny_config: ModelConfig, n_domains: int, classifier: str = "transformer") -> DepthModel:
    torch.manual_seed(0)
    router = replace(tiny_config.router, kind="trained", classifier=classifier)
    model = build_model(replace(tiny_config, domains=DOMAINS[:n_domains], router=router)).eval()
    with torch.no_grad():  # random tables are nearly zero: a mistake in them would not show
        for name, table in model.named_parameters():
            if "position_tables" in name:
                table.normal_()
    return model


@pytest.fixture(params=["one domain", "two domains", "mlp router"])
def model(request: pytest.FixtureRequest, tiny_config: ModelConfig) -> DepthModel:
    classifier = "mlp" if request.param == "mlp router" else "transformer"
    return beit(tiny_config, 1 if request.param == "one domain" else 2, classifier)


@pytest.mark.parametrize("to", ["onnx", "openvino"])
@torch.no_grad()
def test_depth_is_that_of_torch_at_any_size_and_head(model: DepthModel, to: str, tmp_path: Path):
    path = tmp_path / ("model.onnx" if to == "onnx" else "model.xml")
    assert export_model(model, path, to=to) < 1e-4
    exported = load_exported(path)
    assert exported.config == model.config
    heads = [None, torch.tensor([0, 1])] if len(model.config.domains) > 1 else [None]
    for size in ((64, 64), (96, 64), (64, 160)):
        pixels = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(size[1]))
        for domain in heads:
            found = exported(pixels, domain=domain, return_std=True)
            expected = model(pixels, domain=domain, return_std=True)
            assert found.domain.tolist() == expected.domain.tolist()
            assert torch.allclose(found.depth, expected.depth, rtol=1e-4, atol=1e-5)
            assert torch.allclose(found.std, expected.std, rtol=1e-3, atol=1e-4)


@torch.no_grad()
def test_images_of_a_batch_take_heads_of_their_own(tiny_config: ModelConfig, tmp_path: Path):
    model = beit(tiny_config, 2, "mlp")
    assert isinstance(model, ZoeDepth)
    pixels = torch.stack([torch.zeros(3, 64, 64), torch.rand(3, 64, 64)])
    logits = model(pixels).domain_logits
    last = model.router.classifier.mlp[-1]
    gap = logits[:, 0] - logits[:, 1]
    last.bias[0] -= gap.mean()  # between the two images, so that each goes elsewhere
    expected = model(pixels)
    assert set(expected.domain.tolist()) == {0, 1}
    for to, name in (("onnx", "model.onnx"), ("openvino", "model.xml")):
        export_model(model, tmp_path / name, to=to)
        found = load_exported(tmp_path / name)(pixels)
        assert found.domain.tolist() == expected.domain.tolist()
        assert torch.allclose(found.depth, expected.depth, rtol=1e-4, atol=1e-5)


def test_names_and_metadata_are_what_other_programs_look_for(tiny_config: ModelConfig, tmp_path: Path):
    import onnxruntime

    export_model(beit(tiny_config, 2), tmp_path / "model.onnx", to="onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "model.onnx"), providers=["CPUExecutionProvider"])
    assert [x.name for x in session.get_inputs()] == ["pixel_values"]
    assert session.get_inputs()[0].shape == ["batch", 3, "height", "width"]
    assert [x.name for x in session.get_overridable_initializers()] == ["domain"]
    assert [x.name for x in session.get_outputs()] == ["predicted_depth", "std", "domain_logits"]
    said = json.loads(session.get_modelmeta().custom_metadata_map["zoedepth"])
    assert said["unit"] == "metre"
    assert said["domains"] == ["indoor", "outdoor"]
    assert said["preprocessing"]["multiple"] == 32


@torch.no_grad()
def test_a_torch_program_takes_any_batch(tiny_config: ModelConfig, tmp_path: Path):
    model = beit(tiny_config, 2)
    export_model(model, tmp_path / "model.pt2", to="torch-export", size=(64, 96))
    program = torch.export.load(tmp_path / "model.pt2").module()
    pixels, domain = torch.rand(3, 3, 64, 96), torch.tensor([1, 0, 1])
    assert torch.allclose(program(pixels, domain)[0], model(pixels, domain=domain).depth[:, 0], rtol=1e-4, atol=1e-5)
    assert torch.allclose(program(pixels, torch.tensor([-1, -1, -1]))[0], model(pixels).depth[:, 0], rtol=1e-4)


def test_a_file_with_other_depth_is_refused_and_removed(
    tiny_config: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    model = beit(tiny_config, 1)
    write = zoedepth.export.write._write_onnx

    def spoiled(wrapped, path):
        bias = wrapped.model.decoder.relative_head.conv2.bias
        before = bias.detach().clone()
        with torch.no_grad():
            bias += 1.0
        write(wrapped, path)
        with torch.no_grad():
            bias.copy_(before)

    monkeypatch.setattr(zoedepth.export.write, "_write_onnx", spoiled)
    (tmp_path / "model.onnx").write_text("earlier")
    with pytest.raises(ExportError, match="gives other depth than torch"):
        export_model(model, tmp_path / "model.onnx", to="onnx")
    assert [path.name for path in tmp_path.iterdir()] == ["model.onnx"]
    assert (tmp_path / "model.onnx").read_text() == "earlier"


@torch.no_grad()
def test_int8_is_close_on_the_photos_it_is_calibrated_on(tmp_path: Path):
    generator = np.random.default_rng(0)
    photos = []
    for number in range(4):
        coarse = generator.integers(0, 256, (6, 8, 3), dtype=np.uint8)
        photos.append(tmp_path / f"{number}.png")
        Image.fromarray(coarse).resize((352, 256)).save(photos[-1])
    model = load_model("zoed-lite")
    path = tmp_path / "out" / "lite.xml"
    export_model(model, path, to="openvino", int8=True, photos=photos)
    graph = path.read_text()
    assert graph.count('type="FakeQuantize"') > 50
    exact, rough = (Predictor(network, flip_average=False)(photos[0]) for network in (model, load_exported(path)))
    assert (np.abs(exact.depth - rough.depth) / exact.depth).mean() < 0.1
    assert not np.array_equal(exact.depth, rough.depth)


def test_int8_is_in_all_of_encoder_and_decoder_and_nothing_else(tiny_config: ModelConfig, tmp_path: Path):
    import openvino

    coarse = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    Image.fromarray(coarse).resize((96, 64)).save(tmp_path / "photo.png")
    path = tmp_path / "model.xml"
    export_model(beit(tiny_config, 2), path, to="openvino", int8=True, photos=[tmp_path / "photo.png"])
    core: Any = openvino.Core()
    found = {True: [], False: []}
    for node in core.read_model(path).get_ops():
        if node.get_type_name() in ("Convolution", "ConvolutionBackpropData", "MatMul"):
            weight = node.input_value(1).get_node()
            found[weight.get_type_name() == "Multiply"].append(node.get_friendly_name())  # 8 bits times a scale
    exact = ("/attractors", "/probability", "/seed", "/router", "/MatMul")
    assert all(name.startswith(exact) for name in found[False] if "attn" not in name)
    assert not any(name.startswith(exact) for name in found[True])
    assert sum("mlp/fc" in name for name in found[True]) == 2 * 4
    assert sum("ConvolutionBackpropData" in name for name in found[True]) == 2


def test_the_command_line_writes_and_reads_exported_files(tmp_path: Path, capsys: pytest.CaptureFixture):
    photo = tmp_path / "photo.jpg"
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)).save(photo)
    for to, name in (("onnx", "lite.onnx"), ("openvino", "lite.xml")):
        assert main(["export", "zoed-lite", "--to", to, "--out", str(tmp_path / name)]) == 0
        assert capsys.readouterr().out.strip() == str(tmp_path / name)
        assert main(["predict", str(photo), "--out", str(tmp_path / to), "--model", str(tmp_path / name)]) == 0
    assert main(["predict", str(photo), "--out", str(tmp_path / "torch")]) == 0
    said = [np.asarray(Image.open(tmp_path / name / "photo_depth.png")) for name in ("torch", "onnx", "openvino")]
    assert np.abs(said[0].astype(int) - said[1]).max() <= 1
    assert np.abs(said[0].astype(int) - said[2]).max() <= 1


HEADS = {
    "normed": lambda config: replace(config, head=replace(config.head, centers="normed")),
    "softmax": lambda config: replace(config, head=replace(config.head, probability="softmax")),
    "splitter": lambda config: replace(config, head=test_splitter.TINY),
    "dorn": lambda config: replace(config, head=test_dorn.TINY),
    "bts": lambda config: replace(config, head=test_bts.TINY),
    "swin": lambda config: replace(config, encoder=TINY_SWIN, size=(64, 64)),
}


@pytest.mark.parametrize("name", HEADS)
def test_other_heads_and_encoders_are_exported_too(name: str, tiny_config: ModelConfig, tmp_path: Path):
    model = beit(HEADS[name](tiny_config), 2)
    assert export_model(model, tmp_path / "model.xml", to="openvino") < 1e-4
    assert export_model(model, tmp_path / "model.pt2", to="torch-export") < 1e-4


@torch.no_grad()
def test_openvino_compiles_for_the_first_shape_and_once_more_for_all_others(tiny_config: ModelConfig, tmp_path: Path):
    model = beit(tiny_config, 2)
    export_model(model, tmp_path / "model.xml", to="openvino")
    exported = load_exported(tmp_path / "model.xml")
    assert isinstance(exported, OpenVinoModel)
    sizes = [(1, 3, 288, 352), (1, 3, 64, 96), (2, 3, 288, 352), (1, 3, 288, 352)]  # large biases at first
    for size in sizes:
        pixels = torch.rand(*size, generator=torch.Generator().manual_seed(0))
        assert torch.allclose(exported(pixels).depth, model(pixels).depth, rtol=1e-4, atol=1e-5)
    assert exported.first_shape == sizes[0]
    assert set(exported.compiled) == {(True, False), (False, False)}
    biases = 4 * (18 * 22 + 1) ** 2
    assert biases > LARGE


def test_what_cannot_be_traced_is_said(tmp_path: Path):
    with pytest.raises(InputError, match="torch-export only"):
        export_model(build_baseline("newcrfs"), tmp_path / "model.xml", to="openvino")
    with pytest.raises(ExportError, match="torch-export only"):
        export_model(build_baseline("adabins"), tmp_path / "model.xml", to="openvino")
    export_model(build_baseline("adabins"), tmp_path / "model.pt2", to="torch-export")
    assert [path.name for path in tmp_path.iterdir()] == ["model.pt2"]


def test_wrong_wishes_are_refused(tiny_config: ModelConfig, tmp_path: Path):
    model = beit(tiny_config, 2)
    labeled = build_model(replace(tiny_config, domains=DOMAINS, router=RouterConfig(kind="labeled"))).eval()
    relative = build_model(replace(ZOED_LITE, domains=())).eval()
    path = tmp_path / "model.onnx"
    for bad, kwargs, message in (
        (model, {"to": "openvino"}, "ends with .xml"),
        (model, {"to": "onnx", "int8": True}, "openvino only"),
        (labeled, {"to": "onnx"}, "labeled router"),
        (relative, {"to": "onnx"}, "without metric heads"),
    ):
        with pytest.raises(InputError, match=message):
            export_model(bad, path, **kwargs)
    with pytest.raises(InputError, match="training mode"):
        export_model(beit(tiny_config, 2).train(), path, to="onnx")
    with pytest.raises(InputError, match="multiples of 32"):
        export_model(model, tmp_path / "model.pt2", to="torch-export", size=(64, 65))
    assert list(tmp_path.iterdir()) == []


def test_a_foreign_or_broken_file_is_refused(tiny_config: ModelConfig, tmp_path: Path):
    import onnx

    for name in ("broken.onnx", "broken.xml"):
        (tmp_path / name).write_bytes(b"no graph")
        with pytest.raises(InputError, match="cannot be read"):
            load_exported(tmp_path / name)
    with pytest.raises(InputError, match="there is no file"):
        load_exported(tmp_path / "missing.onnx")
    value = onnx.helper.make_tensor_value_info("x", 1, [1])
    node = onnx.helper.make_node("Identity", ["x"], ["y"])
    graph = onnx.helper.make_graph([node], "g", [value], [onnx.helper.make_tensor_value_info("y", 1, [1])])
    opset = onnx.helper.make_opsetid("", 18)
    onnx.save(onnx.helper.make_model(graph, opset_imports=[opset], ir_version=8), tmp_path / "foreign.onnx")
    with pytest.raises(InputError, match="not made by zoedepth export"):
        load_exported(tmp_path / "foreign.onnx")


def test_an_exported_model_says_what_it_cannot_do(tiny_config: ModelConfig, tmp_path: Path):
    export_model(beit(tiny_config, 1), tmp_path / "model.onnx", to="onnx")
    exported = load_exported(tmp_path / "model.onnx")
    with pytest.raises(InputError, match="no bins"):
        exported(torch.rand(1, 3, 64, 64), return_bins=True)
    with pytest.raises(InputError, match="relative"):
        exported.relative(torch.rand(1, 3, 64, 64))
    with pytest.raises(InputError, match="cannot be moved"):
        Predictor(exported, device="cuda")
    with pytest.raises(InputError, match="behaviours built in"):
        zoedepth.export.load_model(tmp_path / "model.onnx", compat=("squeeze",))


def test_the_weights_and_the_model_stay_as_they_are(tiny_config: ModelConfig, tmp_path: Path):
    model = beit(tiny_config, 2)
    save_model(model, tmp_path / "before.safetensors")
    export_model(model, tmp_path / "model.onnx", to="onnx")
    save_model(model, tmp_path / "after.safetensors")
    assert (tmp_path / "before.safetensors").read_bytes() == (tmp_path / "after.safetensors").read_bytes()
    assert any(isinstance(module, torch.nn.TransformerEncoder) for module in model.modules())
