"""The export command: files are written, checked, and taken by predict."""

import importlib.util
import json
import re
import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
from PIL import Image
from skimage import data
from tests.export.models import traced_once

import zoedepth.export.int8
import zoedepth.export.write
from zoedepth.cli import main
from zoedepth.images import write_image
from zoedepth.predict import Predictor
from zoedepth.weights.load import load_model
from zoedepth.weights.releases import RELEASES

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def lite_onnx(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Zoed-lite for ONNX Runtime, and beside it the graph that was traced for it."""
    path = tmp_path_factory.mktemp("lite") / "lite.onnx"
    with traced_once(path.with_name("graph.onnx")):
        assert main(["export", "zoed-lite", "--to", "onnx", "--out", str(path)]) == 0
    return path


@pytest.mark.parametrize(
    ("model", "file"),
    [("runs/v1.2", "v1.2.onnx"), ("runs/v1.3.safetensors", "v1.3.onnx"), ("lab/depth-v1.0", "depth-v1.0.onnx")],
)
def test_files_are_named_after_the_whole_name_of_the_model(
    model: str, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    monkeypatch.chdir(tmp_path)
    Path("runs/v1.2").mkdir(parents=True)
    Path("runs/v1.3.safetensors").touch()
    monkeypatch.setattr("zoedepth.weights.load.load_model", lambda model, **_: None)
    monkeypatch.setattr("zoedepth.export.write.export_model", lambda network, path, **_: 0.0)
    assert main(["export", model, "--to", "onnx"]) == 0
    assert capsys.readouterr().out.strip() == file


def test_the_command_line_writes_and_reads_exported_files(
    lite_onnx: Path, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
):
    """In float32 for ONNX Runtime, and in 8 bits, calibrated on two photos, for OpenVINO."""
    (tmp_path / "photos").mkdir()
    for name, pixels in (("photo.png", data.coffee()), ("other.png", data.stereo_motorcycle()[0])):
        Image.fromarray(pixels).resize((352, 256)).save(tmp_path / "photos" / name)
    photo, depth, xml = str(tmp_path / "photos/photo.png"), {}, str(tmp_path / "lite.xml")
    for module in (zoedepth.export.int8, zoedepth.export.write):  # two photos are too few to stay within one percent
        monkeypatch.setattr(module, "TOLERANCE_INT8", 0.2)
    int8 = ["--int8", "--calibrate", str(tmp_path / "photos"), "--json"]
    with traced_once(lite_onnx.with_name("graph.onnx")):
        assert main(["export", "zoed-lite", "--to", "openvino", "--out", xml, *int8]) == 0
    said = json.loads(capsys.readouterr().out)  # nothing else is on standard output
    assert said["files"] == [xml, str(tmp_path / "lite.bin")]
    assert (said["format"], said["int8"], said["licence"]) == ("openvino", True, "non-commercial research")
    assert 0 < said["difference"] < 0.2
    for to, file in (("onnx", str(lite_onnx)), ("openvino", xml), ("torch", str(RELEASES["zoed-lite"].path))):
        assert main(["predict", photo, "--out", str(tmp_path / to), "--model", file, "--no-flip"]) == 0
        depth[to] = np.asarray(Image.open(tmp_path / to / "photo_depth.png")).astype(int)
    assert (tmp_path / "lite.xml").read_text().count('type="FakeQuantize"') > 50
    assert 10 < (tmp_path / "lite.xml").read_text().count('name="precise"') < 50
    assert np.abs(depth["onnx"] - depth["torch"]).max() <= 1
    assert 0 < (np.abs(depth["openvino"] - depth["torch"]) / depth["torch"]).mean() < 0.2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--int8"], "--int8 needs --calibrate FOLDER"),
        (["--calibrate", "."], "--calibrate is for --int8 only"),
        (["--size", "64", "64"], "takes any size"),
        (["--int8", "--calibrate", "."], "holds no photos"),
        (["--out", "lite.bin"], r"ends with .xml"),
    ],
)
def test_wrong_options_are_said_before_anything_is_written(
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    assert main(["export", "zoed-lite", "--to", "openvino", *options]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert list(tmp_path.iterdir()) == []


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Return the error, one line, of a command that is refused before a model is loaded."""
    assert main(list(map(str, arguments))) == 2
    return " ".join(capsys.readouterr().err.split())


def test_nothing_is_loaded_for_an_export_that_cannot_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr("zoedepth.weights.load.load_model", lambda *_, **__: pytest.fail("a model was loaded"))
    monkeypatch.chdir(tmp_path)
    command = ["export", "zoed-lite", "--to"]
    # 8 bits: not "give photos" first and "not in this format" then.
    assert "int8 is for openvino only, not for onnx" in refused(capsys, *command, "onnx", "--int8")
    # Files that are not ours.
    (tmp_path / "mine.onnx").write_text("mine")
    (tmp_path / "model.bin").write_text("weights of something else")
    (tmp_path / "folder.onnx").mkdir()
    assert "is not an export of zoedepth" in refused(capsys, *command, "onnx", "--out", "mine.onnx")
    assert "is not an export of zoedepth" in refused(capsys, *command, "onnx", "--out", "folder.onnx")
    assert "model.bin is there already" in refused(capsys, *command, "openvino", "--out", "model.xml")
    # A folder that cannot be.
    below = refused(capsys, *command, "onnx", "--out", "mine.onnx/deep/m.onnx")
    assert "--out: cannot write to mine.onnx/deep" in below
    # A picture that zoedepth has written is no photo.
    write_image(tmp_path / "folder.onnx/a_preview.jpg", np.zeros((9, 9, 3), np.uint8))
    said = refused(capsys, *command, "openvino", "--int8", "--calibrate", "folder.onnx")
    assert "--calibrate folder.onnx holds no photos" in said
    # Libraries that are not installed.
    known = importlib.util.find_spec
    monkeypatch.setattr(zoedepth.export.write, "find_spec", lambda name: None if name == "nncf" else known(name))
    (tmp_path / "photo.png").touch()
    said = refused(capsys, *command, "openvino", "--int8", "--calibrate", ".")
    assert "pip install 'zoedepth[openvino]'" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder.onnx", "mine.onnx", "model.bin", "photo.png"]


def test_exported_files_are_named_where_weights_are_needed(
    lite_onnx: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    Image.new("RGB", (64, 64)).save(tmp_path / "a.png")
    said = refused(capsys, "convert", lite_onnx, tmp_path / "out", "--to", "zoedepth")
    assert "lite.onnx is an exported model, whose weights are in no layout" in said
    said = refused(capsys, "export", lite_onnx, "--to", "onnx", "--out", tmp_path / "again.onnx")
    assert "the model is an exported file already" in said
    assert main(["predict", str(tmp_path / "a.png"), "--relative", "--model", str(lite_onnx), "--out", str(tmp_path)])
    assert "an exported model has no relative depth" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("trained", [{}, {"pad": True, "antialias": False}], ids=["lite", "as the original"])
def test_program_of_the_docs_gives_the_depth_of_the_predictor(
    trained: dict[str, bool], lite_onnx: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Within 1 mm, though it knows nothing of this package. The graph is the same however photos are prepared."""
    text = (DOCS / "export.md").read_text(encoding="utf-8").partition("## Without this package")[2]
    (program,) = re.findall(r"```python\n(.*?)```", text.partition("\n## ")[0], re.DOTALL)
    assert "zoedepth" not in re.sub(r'"(zoedepth|zoed-lite\.onnx)"', "", program)
    shutil.copy(lite_onnx, tmp_path / "zoed-lite.onnx")
    if trained:
        graph = onnx.load(lite_onnx)
        (entry,) = graph.metadata_props
        said = json.loads(entry.value)
        said["config"] |= trained
        said["preprocessing"] |= {"pad": "reflect by 3 sqrt(side / 2)", "interpolation": "bilinear, align_corners"}
        entry.value = json.dumps(said)
        onnx.save(graph, tmp_path / "zoed-lite.onnx")
    coarse = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    Image.fromarray(coarse).resize((200, 150)).save(tmp_path / "photo.jpg")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(program, names)
    expected = Predictor(load_model("zoed-lite.onnx"))("photo.jpg").depth
    assert names["depth"].shape == expected.shape == (150, 200)
    assert np.abs(names["depth"] - expected).max() < 1e-3
