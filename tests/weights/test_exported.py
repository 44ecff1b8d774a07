"""Exported files: those that run here, those that are refused, and small ones that would unpack to gigabytes."""

import copy
import json
import logging
import os
import pickle
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import openvino.opset13
import pytest
import torch
from onnx import TensorProto, helper
from tests.weights.layouts.test_files import little_memory

from zoedepth.config import to_dict
from zoedepth.errors import InputError, MissingExtraError, is_no_memory
from zoedepth.export import export_model
from zoedepth.geometry.lens import Lens
from zoedepth.predict import Predictor
from zoedepth.presets import PRESETS
from zoedepth.provenance import Provenance
from zoedepth.runtimes.fast import load_fast
from zoedepth.runtimes.runtime import RUNTIMES
from zoedepth.weights.exported import METADATA, OnnxModel, is_exported, load_exported
from zoedepth.weights.load import load_for_prediction, load_model
from zoedepth.weights.openvino_processor import has_bfloat16
from zoedepth.weights.releases import ASSETS
from zoedepth.weights.tensors import INPUT

operators: Any = openvino.opset13
FAR = PRESETS["zoed-m12-n"]
SOUND = json.dumps({"config": to_dict(FAR)})
SIDES = ["batch", 3, "height", "width"]


def onnx_file(path: Path, *nodes: Any, outputs: tuple[str, ...] = (), metadata: str | None = SOUND) -> Path:
    """A graph that gives the mean colour for depth, with more nodes before it."""
    pixels = helper.make_tensor_value_info("pixel_values", TensorProto.FLOAT, SIDES)
    names = ("predicted_depth", *outputs)
    given = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in names]
    mean = helper.make_node("ReduceMean", ["pixel_values"], ["predicted_depth"], axes=[1], keepdims=0)
    values = [helper.make_tensor("many", TensorProto.INT64, [2], [2**15, 2**15])]
    graph = helper.make_graph([*nodes, mean], "g", [pixels], given, values)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if metadata is not None:
        helper.set_model_props(model, {METADATA: metadata})
    onnx.save(model, path)
    return path


def openvino_file(path: Path, source: Path) -> Path:
    """The same graph for OpenVINO."""
    graph: Any = openvino.Core().read_model(source)
    graph.set_rt_info(SOUND, METADATA)
    openvino.save_model(graph, path)
    return path


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return onnx_file(tmp_path / "model.onnx")


def test_suffixes_tell_exported_files():
    assert is_exported("a/model.onnx")
    assert is_exported(Path("MODEL.XML"))
    assert not is_exported("model.safetensors")
    assert not is_exported("zoed-lite")


@pytest.mark.parametrize("load", [load_exported, load_model])
def test_files_of_both_runtimes_run(load: Callable, file: Path, tmp_path: Path):
    pixels = torch.rand(2, 3, 64, 96)
    for path in (file, openvino_file(tmp_path / "model.xml", file)):
        model = load(path)
        assert model.config == FAR
        assert torch.allclose(model(pixels).depth[:, 0], pixels.mean(dim=1), atol=1e-5)


def test_onnx_runtime_sends_nobody_a_message(tmp_path: Path):
    """From version 1.29 on it keeps what it would send, and a number for the machine, in the user's cache."""
    code = f"from zoedepth.weights.exported import load_exported; load_exported({str(ASSETS / 'zoed-lite.onnx')!r})"
    kept = {name: value for name, value in os.environ.items() if name not in ("CI", "ORT_DISABLE_TELEMETRY")}
    homes = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    subprocess.run([sys.executable, "-c", code], env={**kept, **homes}, check=True)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_threads_of_onnx_runtime_wait_asleep_where_openmps_do(file: Path, monkeypatch: pytest.MonkeyPatch):
    spinning = "session.intra_op.allow_spinning"
    monkeypatch.setenv("OMP_WAIT_POLICY", "PASSIVE")
    assert OnnxModel(file, threads=2).session.get_session_options().get_session_config_entry(spinning) == "0"
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    with pytest.raises(RuntimeError):  # its default
        OnnxModel(file, threads=2).session.get_session_options().get_session_config_entry(spinning)


def test_foreign_and_broken_files_are_refused(tmp_path: Path):
    for name in ("broken.onnx", "broken.xml"):
        (tmp_path / name).write_bytes(b"no graph")
        with pytest.raises(InputError, match="cannot be read"):
            load_exported(tmp_path / name)
    with pytest.raises(InputError, match="there is no file"):
        load_exported(tmp_path / "missing.onnx")
    with pytest.raises(InputError, match=r"give a .onnx or .xml file"):
        load_exported(Path(__file__))
    with pytest.raises(InputError, match="not made by zoedepth export"):
        load_exported(onnx_file(tmp_path / "foreign.onnx", metadata=None))


@pytest.mark.parametrize(
    ("module", "suffix", "message"),
    [
        ("onnxruntime", ".onnx", r"running an ONNX file needs the extra \[onnx\]"),
        ("onnx", ".onnx", r"running an ONNX file needs the extra \[onnx\]"),
        ("openvino", ".xml", r"running an OpenVINO file needs the extra \[openvino\]"),
    ],
)
def test_a_runtime_that_is_not_installed_is_named(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, suffix: str, message: str
) -> None:
    """Without onnx, a file of a stranger could not be looked through before it is run."""
    path = file if suffix == ".onnx" else openvino_file(tmp_path / "model.xml", file)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=message):
        load_exported(path)


@pytest.mark.parametrize("metadata", ["{", "[1]", "{}", '{"config": 3}', '{"config": {}}', "[" * 10_000])
def test_damaged_metadata_is_refused(tmp_path: Path, metadata: str):
    with pytest.raises(InputError, match=r"model.onnx"):
        load_exported(onnx_file(tmp_path / "model.onnx", metadata=metadata))


def test_an_exported_model_says_what_it_cannot_do(file: Path):
    exported = load_exported(file)
    with pytest.raises(InputError, match="no bins"):
        exported(torch.rand(1, 3, 64, 64), return_bins=True)
    with pytest.raises(InputError, match="no gradients"):
        exported(torch.rand(1, 3, 64, 64, requires_grad=True))
    with torch.no_grad():
        assert exported(torch.rand(1, 3, 64, 64, requires_grad=True)).depth.isfinite().all()
    with pytest.raises(InputError, match="relative"):
        exported.relative(torch.rand(1, 3, 64, 64))
    with pytest.raises(InputError, match="cannot be moved"):
        Predictor(exported, device="cuda")
    with pytest.raises(InputError, match="behaviours built in"):
        load_model(file, compat=("squeeze",))


def test_depth_is_corrected_by_the_camera_of_the_photo(tmp_path: Path):
    """The file says the focal length of the training photos, and the predictor does the rest."""
    config = replace(FAR, domains=(replace(FAR.domains[0], focal_px=300.0),), canonical_camera=True)
    file = onnx_file(tmp_path / "model.onnx", metadata=json.dumps({"config": to_dict(config)}))
    photo = np.full((384, 512, 3), 150, np.uint8)
    predictor = Predictor(load_model(file), pad=False, camera=Lens(focal_px=600.0))
    found, plain = predictor(photo), predictor(photo, camera="none")
    assert (found.focal_correction, plain.focal_correction) == (2, 1)
    np.testing.assert_array_equal(found.depth, 2 * plain.depth)


# --- bombs ------------------------------------------------------------------------------------------------------------

ONE = helper.make_node("Constant", [], ["one"], value=helper.make_tensor("one", TensorProto.FLOAT, [1, 1], [1.0]))
BOMBS = {
    "filled": [helper.make_node("ConstantOfShape", ["many"], ["big"])],
    "expanded": [ONE, helper.make_node("Expand", ["one", "many"], ["big"])],
    "tiled": [ONE, helper.make_node("Tile", ["one", "many"], ["big"])],
    "multiplied": [
        helper.make_node("Mul", ["many", "many"], ["more"]),
        helper.make_node("ConstantOfShape", ["more"], ["big"]),
    ],
}


@pytest.mark.parametrize("bomb", BOMBS)
@pytest.mark.parametrize("suffix", [".onnx", ".xml"])
def test_graph_that_would_unpack_to_gigabytes_is_not_run(tmp_path: Path, bomb: str, suffix: str):
    path = onnx_file(tmp_path / "bomb.onnx", *BOMBS[bomb], outputs=("big",))
    if suffix == ".xml":
        path = openvino_file(tmp_path / "bomb.xml", path)
    assert path.stat().st_size < 30_000
    with little_memory(200_000_000), pytest.raises(InputError, match=r"bomb\S* of [\d,]+ bytes would unpack to"):
        load_model(path)


def test_graph_that_grows_when_it_runs_is_an_error_that_names_it(tmp_path: Path):
    """The runtime itself refuses 800 TB."""
    many = helper.make_tensor("times", TensorProto.INT64, [4], [1, 1, 10**5, 10**5])
    times = helper.make_node("Constant", [], ["times"], value=many)
    tile = helper.make_node("Tile", ["pixel_values", "times"], ["big"])
    model = load_exported(onnx_file(tmp_path / "bomb.onnx", times, tile, outputs=("big",)))
    with pytest.raises(InputError, match=r"bomb\.onnx cannot be run: .*Tile"):
        model(torch.zeros(1, 3, 64, 64))


def test_too_little_memory_for_onnx_runtime_is_told_as_it_is(file: Path, monkeypatch: pytest.MonkeyPatch):
    """Not as a fault of the file: the service and the command line say what to do about memory."""

    def full(*_: object) -> object:
        raise RuntimeError("[ONNXRuntimeError] : 6 : Failed to allocate memory for requested buffer of size 400")

    monkeypatch.setattr(onnxruntime.InferenceSession, "run", full)
    with pytest.raises(RuntimeError, match="Failed to allocate memory") as caught:
        load_exported(file)(torch.zeros(1, 3, 64, 64))
    assert is_no_memory(caught.value)
    assert not isinstance(caught.value, InputError)


def test_other_failures_of_a_run_are_errors_that_name_the_file_and_not_its_folder(file: Path, tmp_path: Path):
    """The service hands them on to strangers."""
    for path in (file, openvino_file(tmp_path / "model.xml", file)):
        with pytest.raises(InputError, match=rf"(?s)^{re.escape(path.name)} cannot be run: .*Export the model again"):
            load_exported(path).run({INPUT: np.zeros((1, 3, 64, 64), np.float32), "foreign": np.zeros(1)}, std=True)


def test_too_little_memory_for_openvino_is_told_as_it_is(
    tmp_path: Path, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = openvino_file(tmp_path / "model.xml", file)

    def full(*_: object) -> object:
        raise RuntimeError("std::bad_alloc")

    compiling, running = load_exported(path), load_exported(path)
    pixels = {INPUT: np.zeros((1, 3, 64, 64), np.float32)}
    running.run(pixels, std=True)
    monkeypatch.setattr(openvino.CompiledModel, "create_infer_request", full)
    with pytest.raises(RuntimeError, match=r"^std::bad_alloc"):
        running.run(pixels, std=True)
    monkeypatch.setattr(openvino.Core, "compile_model", full)
    with pytest.raises(RuntimeError, match=r"^std::bad_alloc"):
        compiling.run(pixels, std=True)


def test_loops_are_not_run(tmp_path: Path):
    inner = helper.make_graph([], "inner", [], [helper.make_tensor_value_info("many", TensorProto.INT64, [2])])
    true = helper.make_node("Constant", [], ["true"], value=helper.make_tensor("true", TensorProto.BOOL, [], [True]))
    branch = helper.make_node("If", ["true"], ["x"], then_branch=inner, else_branch=inner)
    with pytest.raises(InputError, match="has a loop or a branch"):
        load_exported(onnx_file(tmp_path / "loop.onnx", true, branch))


def of_openvino(kind: str) -> Any:
    """A node that holds a graph of its own."""
    x = operators.parameter([2], np.float32, name=INPUT)
    inner = [operators.parameter([2], np.float32) for _ in range(2)]
    true = operators.constant(np.array(True))
    bodies = [openvino.Model([operators.relu(each), operators.constant(np.array(True))], [each]) for each in inner]
    if kind == "If":
        node = operators.if_op(true)
        node.set_then_body(bodies[0])
        node.set_else_body(bodies[1])
        node.set_input(x.output(0), *inner)
        node.set_output(bodies[0].results[0], bodies[1].results[0])
    else:
        node = operators.loop(operators.constant(np.array(3)), true) if kind == "Loop" else operators.tensor_iterator()
        (node.set_function if kind == "Loop" else node.set_body)(bodies[0])
        if kind == "Loop":
            node.set_special_body_ports([-1, 1])
        node.set_invariant_input(inner[0], x.output(0))
        node.get_iter_value(bodies[0].results[0].output(0), -1)
    node.constructor_validate_and_infer_types()
    return openvino.Model([operators.result(node.output(0))], [x])


@pytest.mark.parametrize("kind", ["If", "Loop", "TensorIterator"])
def test_loops_of_openvino_are_not_run(kind: str, tmp_path: Path):
    graph = of_openvino(kind)
    assert kind in {node.get_type_name() for node in graph.get_ops()}
    graph.set_rt_info(SOUND, METADATA)
    openvino.save_model(graph, tmp_path / "loop.xml")
    with pytest.raises(InputError, match=r"loop\.xml has a loop or a branch"):
        load_exported(tmp_path / "loop.xml")


def test_constants_of_openvino_are_no_larger_than_their_file(tmp_path: Path, file: Path):
    path = openvino_file(tmp_path / "model.xml", file)
    before = path.read_text()
    changed = before.replace('size="8"', 'size="80000000000"')
    assert changed != before
    path.write_text(changed)
    with little_memory(200_000_000), pytest.raises(InputError, match="cannot be read as OpenVINO"):
        load_model(path)


def test_names_in_xml_are_not_expanded(tmp_path: Path):
    """A document of a few lines that names itself ten times at every level."""
    levels = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))
    text = f'<?xml version="1.0"?><!DOCTYPE net [<!ENTITY l0 "lol">{levels}]><net name="&l9;" version="11">&l9;</net>'
    (tmp_path / "bomb.xml").write_text(text)
    with little_memory(200_000_000), pytest.raises(InputError, match="holds no configuration"):
        load_model(tmp_path / "bomb.xml")


def test_metadata_that_would_unpack_to_gigabytes_is_refused(tmp_path: Path):
    """A bracket of two bytes is a list of sixty."""
    path = onnx_file(tmp_path / "model.onnx", metadata="[" + "[]," * 1_000_000 + "[]]")
    with little_memory(200_000_000), pytest.raises(InputError, match="too long for JSON"):
        load_model(path)


def test_numbers_are_those_of_the_runtime(file: Path):
    """The helper above would hide a model that is never asked."""
    pixels = np.linspace(0, 1, 3 * 64 * 64, dtype=np.float32).reshape(1, 3, 64, 64)
    assert np.allclose(load_exported(file).run({"pixel_values": pixels}, std=True)["predicted_depth"], pixels.mean(1))


def test_copies_and_pickles_load_the_file_again(file: Path, tmp_path: Path):
    """A session can neither be copied nor sent to another process."""
    pixels = torch.rand(1, 3, 64, 64)
    for path in (file, openvino_file(tmp_path / "model.xml", file)):
        model = load_exported(path, threads=1)
        for other in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model)):
            assert type(other) is type(model)
            torch.testing.assert_close(other(pixels).depth, model(pixels).depth, rtol=1e-4, atol=1e-5)
    assert pickle.loads(pickle.dumps(load_exported(tmp_path / "model.xml", streams=2))).options["streams"] == 2


def test_terms_of_the_weights_are_in_the_metadata(tmp_path: Path):
    said = json.dumps({"config": to_dict(FAR), "licence": "cc-by-nc-4.0", "trained_on": None})
    model = load_exported(onnx_file(tmp_path / "model.onnx", metadata=said))
    assert model.provenance == Provenance("cc-by-nc-4.0")


def test_what_an_exported_file_has_not_is_said(file: Path):
    with pytest.raises(InputError, match="an exported model has no relative depth: use the model"):
        Predictor(load_exported(file)).relative(np.zeros((64, 64, 3), np.uint8))
    with pytest.raises(InputError, match="the model is an exported file already"):
        export_model(load_exported(file), file.with_name("other.onnx"), to="onnx")


def test_programs_of_torch_are_named(tmp_path: Path):
    program = torch.export.export(torch.nn.Linear(2, 3), (torch.rand(1, 2),))
    torch.export.save(program, tmp_path / "model.pt2")
    torch.jit.script(torch.nn.Linear(2, 3)).save(tmp_path / "model.pt")
    for name, message in (("model.pt2", r"is a torch-export.*torch\.export\.load"), ("model.pt", "is a TorchScript")):
        with pytest.raises(InputError, match=message):
            load_model(tmp_path / name)


@pytest.mark.parametrize(
    ("packaged", "device", "first"),
    [
        (True, "auto", "CPUExecutionProvider"),
        (False, "auto", "CUDAExecutionProvider"),
        (False, "cuda", "CUDAExecutionProvider"),
        (False, "cpu", "CPUExecutionProvider"),
    ],
)
def test_graphs_of_the_package_and_those_for_the_cpu_run_there_alone(
    packaged: bool, device: str, first: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where ONNX Runtime's package for GPUs is installed, too."""
    session, asked = onnxruntime.InferenceSession, list[str]()

    def start(path: str, options: object, *, providers: list[str]) -> object:
        asked.extend(providers)
        return session(path, options, providers=providers[-1:])

    available = ["TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider"]
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: available)
    monkeypatch.setattr(onnxruntime, "InferenceSession", start)
    file = ASSETS / "zoed-lite.onnx" if packaged else onnx_file(tmp_path / "a.onnx")
    for load in (load_for_prediction, load_fast):
        asked.clear()
        load(file, device=device)
        assert (asked[0], asked[-1], len(asked)) == (first, "CPUExecutionProvider", 1 if "CPU" in first else 2)


def test_what_is_timed_as_on_the_processor_runs_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[str]()
    monkeypatch.setattr("zoedepth.runtimes.runtime.load_exported", lambda *_, device, **__: asked.append(device))
    RUNTIMES["ONNX Runtime, float32"].load(tmp_path / "a.onnx")
    assert asked == ["cpu"]


def test_images_of_a_batch_are_computed_one_by_one_on_a_processor(monkeypatch: pytest.MonkeyPatch):
    model = load_exported(ASSETS / "zoed-lite.onnx")
    sizes: list[int] = []
    run = model.run

    def noted(inputs: Mapping[str, np.ndarray], *, std: bool) -> Mapping[str, np.ndarray]:
        assert {len(each) for each in inputs.values()} == {len(inputs["pixel_values"])}
        sizes.append(len(inputs["pixel_values"]))
        return run(inputs, std=std)

    monkeypatch.setattr(model, "run", noted)
    pixels = np.random.default_rng(0).random((3, 3, 64, 96), dtype=np.float32)
    heads = np.array([1, 0, 1])
    one_by_one = model.compute(pixels, heads)
    monkeypatch.setattr(model, "together", True)  # as on a GPU
    together = model.compute(pixels, heads)
    assert sizes == [1, 1, 1, 3]
    for one, other in zip(one_by_one, together, strict=True):
        assert one.shape == other.shape
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)
    # Each image takes the head that was asked for it.
    assert not np.allclose(one_by_one.predicted_depth[:1], model.compute(pixels[:1], heads[1:2]).predicted_depth)


def graph_file(path: Path, depth_of: Callable[[Any], Any]) -> Path:
    """A file for OpenVINO whose depth is the mean over the channels of what a function makes of the pixels."""
    pixels = operators.parameter([-1, 3, -1, -1], np.float32, name=INPUT)
    pixels.output(0).set_names({INPUT})
    depth = operators.reduce_mean(depth_of(pixels), np.array([1]))
    depth.output(0).set_names({"predicted_depth"})
    graph: Any = openvino.Model([depth], [pixels], "graph")
    graph.set_rt_info(SOUND, METADATA)
    openvino.save_model(graph, path, compress_to_fp16=False)
    return path


def convolved(x: Any, kernel: Any) -> Any:
    return operators.convolution(x, kernel, [1, 1], [0, 0], [0, 0], [1, 1])


def attractors_file(path: Path, n_attractors: int) -> Path:
    """A graph that moves 64 bin centers as the heads do, and gives their mean for depth."""
    random = np.random.default_rng(0)

    def moved_centers(pixels: Any) -> Any:
        centers, attractors = (
            operators.softplus(convolved(pixels, random.standard_normal((n, 3, 1, 1)).astype(np.float32)))
            for n in (64, n_attractors)
        )
        moved = centers
        for attractor in operators.split(attractors, 1, n_attractors).outputs():
            distance = operators.subtract(attractor, centers)
            strength = operators.multiply(operators.multiply(distance, distance), np.float32(300))
            moved = operators.add(moved, operators.divide(distance, operators.add(np.float32(1), strength)))
        return moved

    return graph_file(path, moved_centers)


def test_attractors_are_compiled_on_every_processor(tmp_path: Path) -> None:
    """OpenVINO merges them into more than a processor without AVX-512 has registers for."""
    model = load_exported(attractors_file(tmp_path / "model.xml", 16))
    pixels = np.random.default_rng(1).random((1, 3, 64, 96), dtype=np.float32)
    # The graph for one shape merges the attractors, and the one for other shapes does not.
    alone, two = (model.run({INPUT: np.repeat(pixels, n, axis=0)}, std=True)["predicted_depth"] for n in (1, 2))
    assert alone.std() > 0.01
    assert np.allclose(alone[0], two[1], rtol=1e-4)


def test_what_openvino_has_no_registers_for_is_compiled_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = load_exported(attractors_file(tmp_path / "model.xml", 2))
    compile_model, seen = openvino.Core.compile_model, list[bool]()

    def without_registers(core: Any, graph: Any, device: str, properties: dict[str, Any]) -> Any:
        merged = "SNIPPETS_MODE" not in properties
        seen.append(merged)
        if merged:
            raise RuntimeError("... Can't allocate registers for a snippet: not enough registers")
        return compile_model(core, graph, device, properties)

    monkeypatch.setattr(openvino.Core, "compile_model", without_registers)
    for size in (64, 96):
        assert model.run({INPUT: np.ones((1, 3, size, 64), np.float32)}, std=True)["predicted_depth"].size
    assert seen == [True, False, False]


def test_other_failures_of_openvino_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = load_exported(attractors_file(tmp_path / "model.xml", 2))

    def failing(core: Any, graph: Any, device: str, properties: dict[str, Any]) -> Any:
        raise RuntimeError("the processor is on fire")

    monkeypatch.setattr(openvino.Core, "compile_model", failing)
    with pytest.raises(InputError, match=r"cannot compile .*the processor is on fire"):
        model.run({INPUT: np.ones((1, 3, 64, 64), np.float32)}, std=True)


@pytest.mark.parametrize(("capabilities", "computed"), [(["FP32"], "float32"), (["FP32", "BF16"], "bfloat16")])
def test_bfloat16_is_said_where_it_is_computed(
    capabilities: list[str], computed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """OpenVINO takes no notice of the wish where the processor cannot do it."""
    monkeypatch.setattr(openvino.Core, "get_property", lambda core, device, name: capabilities)
    has_bfloat16.cache_clear()
    try:
        model = load_exported(attractors_file(tmp_path / "model.xml", 2), precision="bfloat16")
    finally:
        has_bfloat16.cache_clear()
    assert model.precision == computed


def rounded_file(path: Path) -> Path:
    """A graph that gives 96 * 127 times the photo's mean, rounded to 8 bits, for depth."""

    def sums(pixels: Any) -> Any:
        many = operators.concat([operators.fake_quantize(pixels, *map(np.float32, (0, 1, 0, 1)), 256)] * 32, 1)
        weights = operators.constant(np.full((64, 96, 1, 1), 127, np.float32))
        return convolved(many, operators.fake_quantize(weights, *map(np.float32, (-127, 127, -127, 127)), 255))

    return graph_file(path, sums)


def test_8_bits_are_added_exactly_on_every_processor(tmp_path: Path) -> None:
    """Without VNNI, OpenVINO gives about half of these sums."""
    model = load_exported(rounded_file(tmp_path / "model.xml"))
    assert model.precision == "int8"
    for size in (64, 96):  # the first shape, and any other
        depth = model.run({INPUT: np.ones((1, 3, size, 64), np.float32)}, std=True)["predicted_depth"]
        assert np.allclose(depth, 127 * 96, rtol=0.01)


def test_8_bits_that_are_cut_off_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("zoedepth.weights.exported.adds_8_bits_exactly", lambda: False)
    with caplog.at_level(logging.WARNING):
        model = load_exported(rounded_file(tmp_path / "model.xml"))
        load_exported(attractors_file(tmp_path / "float.xml", 2))
    assert caplog.text.count("cuts off their sums (it has no VNNI)") == 1
    depth = model.run({INPUT: np.ones((1, 3, 64, 64), np.float32)}, std=True)["predicted_depth"]
    assert np.allclose(depth, 127 * 96, rtol=0.01)


@pytest.mark.parametrize("name", ["model.onnx", "model.xml"])
def test_float16_is_refused_in_a_sentence(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    with pytest.raises(InputError, match=rf"float16 is for models of torch on a GPU: load .*{name} in float32"):
        load_exported(tmp_path / name, precision="float16")
