"""Exported files: the same depth as torch at any size, and nothing left behind where it is not.

Exporting takes seconds: one file of each kind is made once for the whole module.
"""

import json
import os
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from PIL import Image
from tests.baselines import test_adabins, test_newcrfs
from tests.baselines.base import build as build_baseline
from tests.baselines.base import photos
from tests.export.models import HEADS, PAIR, balanced, beit, flat, traced_once
from tests.model.heads.test_pixelbins import TINY as PIXEL_BINS
from tests.model.test_encoder import TINY_SWIN
from torch import Tensor, nn

import zoedepth.export.write
from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.export import export_model, load_exported
from zoedepth.export.wrapper import ExportModel
from zoedepth.export.write import OPSET, SUFFIXES, ExportError, Format, check_wish, metadata
from zoedepth.geometry.lens import Lens
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.weights.exported import METADATA, ExportedModel, OpenVinoModel
from zoedepth.weights.openvino_graph import LARGE

MODELS: dict[str, Callable[[ModelConfig], ZoeDepth]] = {
    "one domain": lambda config: flat(config, 1),
    "two domains": lambda config: beit(config, 2),
    "mlp router": lambda config: balanced(flat(config, 2)),
}
NAMES: dict[Format, str] = {"onnx": "model.onnx", "openvino": "model.xml", "torch-export": "model.pt2"}
EARLIER = f'{METADATA}{{"config": "of an earlier export"}}'
FORMATS = pytest.mark.parametrize("to", ["onnx", "openvino"])


class Export(NamedTuple):
    """A model, its graph as it was traced, the file that was made of both, and what loads from there."""

    model: ZoeDepth
    graph: Path
    path: Path
    exported: ExportedModel


Exports = Callable[[str, Format], Export]


@pytest.fixture(scope="module")
def exports(tiny_config: ModelConfig, tmp_path_factory: pytest.TempPathFactory) -> Exports:
    """Models of ``MODELS`` and their files, each made when it is first asked for, of one traced graph."""
    folder = tmp_path_factory.mktemp("exports")

    @cache
    def model_of(name: str) -> ZoeDepth:
        return MODELS[name](tiny_config)

    @cache
    def export(name: str, to: Format) -> Export:
        graph, path = folder / f"{name}.onnx", folder / name / NAMES[to]
        with traced_once(graph):
            assert export_model(model_of(name), path, to=to) < 1e-4
        return Export(model_of(name), graph, path, load_exported(path))

    return export


@FORMATS
@pytest.mark.parametrize("name", MODELS)
@torch.no_grad()
def test_depth_is_that_of_torch_at_any_size_and_head(exports: Exports, name: str, to: Format):
    model, _, _, exported = exports(name, to)
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


@FORMATS
@torch.no_grad()
def test_images_of_a_batch_take_heads_of_their_own(exports: Exports, to: Format):
    model, _, _, exported = exports("mlp router", to)
    expected, found = model(PAIR), exported(PAIR, return_std=True)
    assert set(expected.domain.tolist()) == {0, 1}
    assert found.domain.tolist() == expected.domain.tolist()
    assert torch.allclose(found.depth, expected.depth, rtol=1e-4, atol=1e-5)


@FORMATS
def test_depth_of_a_photo_with_a_camera_is_that_of_torch(exports: Exports, to: Format):
    """What the lens does to the metres is not in the file, but in its configuration."""
    model, _, _, exported = exports("two domains", to)
    photo = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    expected, found = (Predictor(each, camera=Lens(fov_x=70))(photo, domain="outdoor") for each in (model, exported))
    assert found.camera == expected.camera
    assert found.focal_correction == expected.focal_correction != 1
    assert found.std is not None
    assert expected.std is not None
    np.testing.assert_allclose(found.depth, expected.depth, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(found.std, expected.std, rtol=1e-3, atol=1e-4)


def test_names_and_metadata_are_what_other_programs_look_for(exports: Exports):
    import onnxruntime

    path = exports("two domains", "onnx").path
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    assert [x.name for x in session.get_inputs()] == ["pixel_values"]
    assert session.get_inputs()[0].shape == ["batch", 3, "height", "width"]
    assert [x.name for x in session.get_overridable_initializers()] == ["domain"]
    assert [x.name for x in session.get_outputs()] == ["predicted_depth", "std", "domain_logits"]
    said = json.loads(session.get_modelmeta().custom_metadata_map["zoedepth"])
    assert said["unit"] == "metre"
    assert said["camera"].startswith("predicted_depth needs no camera")
    assert said["domains"] == ["indoor", "outdoor"]
    assert said["preprocessing"]["multiple"] == 32


@torch.no_grad()
def test_a_torch_program_takes_any_batch(tiny_config: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """With the head of the fewest operations: tests of the heads have a program of each."""
    model, load, loaded = beit(replace(tiny_config, head=PIXEL_BINS), 2), torch.export.load, []
    monkeypatch.setattr(torch.export, "load", lambda path: loaded.append(load(path)) or loaded[-1])
    export_model(model, tmp_path / "model.pt2", to="torch-export", size=(64, 96))
    assert (tmp_path / "model.pt2").is_file()
    program = loaded[0].module()  # as the export itself read it from the file
    pixels, domain = torch.rand(3, 3, 64, 96), torch.tensor([1, 0, 1])
    assert torch.allclose(program(pixels, domain)[0], model(pixels, domain=domain).depth[:, 0], rtol=1e-4, atol=1e-5)
    assert torch.allclose(
        program(pixels, torch.tensor([-1, -1, -1]))[0], model(pixels).depth[:, 0], rtol=1e-4, atol=1e-5
    )


def test_a_file_with_other_depth_is_refused_and_removed(
    tiny_config: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    model = flat(tiny_config, 1)
    write = zoedepth.export.write.write_onnx

    def spoiled(wrapped, path):
        bias = wrapped.model.decoder.relative_head.conv2.bias
        before = bias.detach().clone()
        with torch.no_grad():
            bias += 1.0
        write(wrapped, path)
        with torch.no_grad():
            bias.copy_(before)

    monkeypatch.setattr(zoedepth.export.write, "write_onnx", spoiled)
    (tmp_path / "model.onnx").write_text(EARLIER)
    with pytest.raises(ExportError, match="gives other depth than torch"):
        export_model(model, tmp_path / "model.onnx", to="onnx")
    assert [path.name for path in tmp_path.iterdir()] == ["model.onnx"]
    assert (tmp_path / "model.onnx").read_text() == EARLIER


def write_onnx(path: Path, texts: dict[str, str], *, about: str = "") -> None:
    """Write the smallest graph, with texts in its metadata and one about it, as torch's newer exporter has them."""
    import onnx
    from onnx import TensorProto, helper

    value = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1])
    graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"], doc_string=about)], "g", [value], [
        helper.make_tensor_value_info("y", TensorProto.FLOAT, [1])
    ])  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, texts)
    onnx.save(model, path)


def test_exports_are_known_by_their_metadata_and_by_no_word(tmp_path: Path, tiny_model: ZoeDepth):
    """Files of other exporters name the source files of transformers' zoedepth."""
    import openvino

    said, about = {METADATA: metadata(tiny_model)}, "transformers/models/zoedepth/modeling_zoedepth.py:12"
    write_onnx(tmp_path / "own.onnx", said)
    graph: Any = openvino.Core().read_model(tmp_path / "own.onnx")
    graph.set_rt_info(said[METADATA], METADATA)
    openvino.save_model(graph, tmp_path / "own.xml")
    program = torch.export.export(nn.Identity(), (torch.zeros(1),))
    torch.export.save(program, tmp_path / "own.pt2", extra_files=said)
    write_onnx(tmp_path / "theirs.onnx", {"model": "{'zoedepth': 1}", "other": '{"config": 1}'}, about=about)
    for to, suffix in SUFFIXES.items():
        check_wish(tmp_path / f"own{suffix}", to=to)
    with pytest.raises(InputError, match=r"theirs\.onnx is there already, and is not an export of zoedepth"):
        check_wish(tmp_path / "theirs.onnx", to="onnx")


def test_int8_is_in_all_of_encoder_and_decoder_and_nothing_else(exports: Exports, tmp_path: Path):
    import openvino

    coarse = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    Image.fromarray(coarse).resize((96, 64)).save(tmp_path / "photo.png")
    path = tmp_path / "model.xml"
    known = exports("two domains", "onnx")
    with traced_once(known.graph):
        export_model(known.model, path, to="openvino", int8=True, photos=[tmp_path / "photo.png"])
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


class Together(nn.Module):
    """Models with different heads on the same encoder and decoder: one export for all of them."""

    def __init__(self, models: dict[str, ZoeDepth]) -> None:
        super().__init__()
        self.parts = nn.ModuleDict({name: ExportModel(model) for name, model in models.items()})
        first, *others = (part.model for part in self.parts.values())
        self.features_of = first.relative_features
        for model in (first, *others):
            model.relative_features = lambda _: self.features

    def forward(self, pixel_values: Tensor, domain: Tensor) -> tuple[Tensor, ...]:
        """The depth of each."""
        self.features = self.features_of(pixel_values)
        parts: list[Any] = list(self.parts.values())
        domains = [domain if len(part.model.heads) > 1 else None for part in parts]
        return tuple(part.outputs(pixel_values, one).predicted_depth for part, one in zip(parts, domains, strict=True))


@pytest.fixture
def together(tiny_config: ModelConfig) -> Together:
    """Return every kind of head for one domain, and one for two: test_wrapper.py has the heads of two domains.

    Tests of the heads have a torch program of each.
    """
    models = {name: flat(change(tiny_config), 1) for name, change in HEADS.items()}
    return Together({"routed": balanced(flat(tiny_config, 2)), **models}).eval()


ANY_HEADS = [(PAIR, torch.tensor([-1, -1])), (torch.rand(3, 3, 64, 96), torch.tensor([1, 0, -1]))]


@torch.no_grad()
def test_all_heads_are_the_same_in_openvino(together: Together, tmp_path: Path):
    import openvino

    with torch.enable_grad():  # or what heads compute in pieces would be traced piece by piece
        torch.onnx.export(
            together, ANY_HEADS[0], tmp_path / "heads.onnx", input_names=["pixels", "domain"], opset_version=OPSET,
            dynamic_axes={"pixels": {0: "batch", 2: "height", 3: "width"}, "domain": {0: "batch"}}, dynamo=False,
        )  # fmt: skip
    core: Any = openvino.Core()
    with zoedepth.export.write._without_telemetry():
        converted = openvino.convert_model(tmp_path / "heads.onnx")
    run = core.compile_model(converted, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    for pixels, domain in ANY_HEADS:
        found = run([pixels.numpy(), domain.numpy()])
        for name, output, expected in zip(together.parts, run.outputs, together(pixels, domain), strict=True):
            assert np.allclose(found[output], expected, rtol=1e-4, atol=1e-5), name


@pytest.fixture
def swin(tiny_config: ModelConfig) -> ZoeDepth:
    """Make a model with a small Swin. A convolutional encoder is zoed-lite's: tests of the commands export that."""
    encoder = replace(TINY_SWIN, depth=(1, 1, 1, 1))
    return beit(replace(tiny_config, encoder=encoder, head=PIXEL_BINS, size=(64, 64)), 1, "mlp")


# OpenVINO itself ends the process: what it sees of the processor, and what its oneDNN is shown, are two things then. A
# processor that has AVX2 only shows the same to both.
@pytest.mark.skipif("ONEDNN_MAX_CPU_ISA" in os.environ, reason="OpenVINO crashes at a Swin under ONEDNN_MAX_CPU_ISA")
def test_swin_is_exported_to_openvino(swin: ZoeDepth, tmp_path: Path):
    assert export_model(swin, tmp_path / "model.xml", to="openvino") < 1e-4


def test_swin_is_exported_to_a_torch_program(swin: ZoeDepth):
    encoder = swin.encoder
    *others, _ = (module for module in encoder.modules() if hasattr(module, "blocks"))
    for stage in others:
        del stage.blocks[:]  # which take a second each, and are the same
    shapes = ({0: torch.export.Dim("batch", min=1, max=1024)},)
    program = torch.export.export(encoder, (PAIR,), dynamic_shapes=shapes, strict=False).module()
    pixels = torch.rand(3, 3, 64, 64)
    with torch.no_grad():
        for found, expected in zip(program(pixels).maps, encoder(pixels).maps, strict=True):
            assert torch.allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_exporting_sends_nobody_a_message(exports: Exports, monkeypatch: pytest.MonkeyPatch):
    from openvino_telemetry import Telemetry

    exports("one domain", "openvino")
    assert not Telemetry().consent
    monkeypatch.setenv("CI", "false")
    monkeypatch.delenv("NNCF_CI", raising=False)
    with zoedepth.export.write._without_telemetry():
        assert (os.environ["CI"], os.environ["NNCF_CI"]) == ("true", "true")
    assert (os.environ["CI"], os.environ.get("NNCF_CI")) == ("false", None)


@torch.no_grad()
def test_openvino_compiles_for_the_first_shape_and_once_more_for_all_others(exports: Exports):
    model, _, path, _ = exports("two domains", "openvino")
    exported = load_exported(path)
    assert isinstance(exported, OpenVinoModel)
    sizes = [(1, 3, 256, 288), (1, 3, 64, 96), (2, 3, 256, 288), (1, 3, 256, 288)]  # large biases at first
    for size in sizes:
        pixels = torch.rand(*size, generator=torch.Generator().manual_seed(0))
        assert torch.allclose(exported(pixels).depth, model(pixels).depth, rtol=1e-4, atol=1e-5)
    assert exported.first_shape == sizes[0]
    assert set(exported.compiled) == {(True, False), (False, False)}
    biases = 4 * (16 * 18 + 1) ** 2
    assert biases > LARGE


def test_what_cannot_be_traced_is_said(tmp_path: Path):
    with pytest.raises(InputError, match="torch-export only"):
        export_model(build_baseline(test_newcrfs.TINY), tmp_path / "model.xml", to="openvino")
    with pytest.raises(ExportError, match="torch-export only"):
        export_model(build_baseline(test_adabins.TINY), tmp_path / "model.onnx", to="onnx")
    assert list(tmp_path.iterdir()) == []
    wrapped = ExportModel(build_baseline(test_adabins.TINY)).eval()
    program = torch.export.export(wrapped, (photos(test_adabins.TINY),), strict=False).module()
    with torch.no_grad():
        assert torch.allclose(program(photos(test_adabins.TINY))[0], wrapped(photos(test_adabins.TINY))[0], rtol=1e-4)


def test_too_little_memory_is_not_blamed_on_the_model(
    tiny_config: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def write(*_: object, **__: object) -> float:
        raise RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 8 bytes")

    monkeypatch.setattr("zoedepth.export.write._write", write)
    with pytest.raises(RuntimeError, match="can't allocate memory"):  # what the command line knows too little memory by
        export_model(beit(tiny_config, 2), tmp_path / "model.onnx", to="onnx")
    assert list(tmp_path.iterdir()) == []


def test_wrong_wishes_are_refused(tiny_config: ModelConfig, tmp_path: Path):
    model = beit(tiny_config, 2)
    path = tmp_path / "model.onnx"
    with pytest.raises(InputError, match=r"ends with .xml"):
        export_model(model, path, to="openvino")
    with pytest.raises(InputError, match="openvino only"):
        export_model(model, path, to="onnx", int8=True)
    with pytest.raises(InputError, match="training mode"):
        export_model(beit(tiny_config, 2).train(), path, to="onnx")
    with pytest.raises(InputError, match="multiples of 32"):
        export_model(model, tmp_path / "model.pt2", to="torch-export", size=(64, 65))
    assert list(tmp_path.iterdir()) == []


@FORMATS
def test_the_weights_and_the_model_stay_as_they_are(exports: Exports, to: Format, tiny_config: ModelConfig):
    exported, new = exports("two domains", to).model, MODELS["two domains"](tiny_config)
    assert any(isinstance(module, torch.nn.TransformerEncoder) for module in exported.modules())
    assert [type(module) for module in exported.modules()] == [type(module) for module in new.modules()]
    weights = exported.state_dict()
    assert weights.keys() == new.state_dict().keys()
    assert all(torch.equal(weights[name], value) for name, value in new.state_dict().items())


def test_model_in_one_camera_says_how_metres_come_about(tiny_model: ZoeDepth):
    domains = tuple(replace(domain, focal_px=80.0) for domain in tiny_model.config.domains)
    tiny_model.config = replace(tiny_model.config, domains=domains, canonical_camera=True)
    said = json.loads(metadata(tiny_model))
    assert "multiply it by the photo's focal length" in said["camera"]
    assert said["config"]["canonical_camera"]
    assert [domain["focal_px"] for domain in said["config"]["domains"]] == [80.0, 80.0]
    assert "std_factor of the domain" in said["std"]
    assert [domain["std_factor"] for domain in said["config"]["domains"]] == [1.0, 1.0]
