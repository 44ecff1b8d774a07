"""The export command: files are written, checked, and taken by predict."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.cli import main


def test_the_command_line_writes_and_reads_exported_files(tmp_path: Path, capsys: pytest.CaptureFixture):
    """In float32 for ONNX Runtime, and in 8 bits, calibrated on two photos, for OpenVINO."""
    generator = np.random.default_rng(0)
    (tmp_path / "photos").mkdir()
    for name in ("photo.png", "other.png"):
        coarse = generator.integers(0, 256, (6, 8, 3), dtype=np.uint8)
        Image.fromarray(coarse).resize((352, 256)).save(tmp_path / "photos" / name)
    int8 = ["--int8", "--calibrate", str(tmp_path / "photos")]
    photo, depth = str(tmp_path / "photos/photo.png"), {}
    for to, name, options in (("onnx", "lite.onnx", []), ("openvino", "lite.xml", int8), ("torch", "zoed-lite", [])):
        file = str(tmp_path / name) if to != "torch" else name
        if to != "torch":
            assert main(["export", "zoed-lite", "--to", to, "--out", file, *options]) == 0
            assert capsys.readouterr().out.splitlines()[-1] == file
        assert main(["predict", photo, "--out", str(tmp_path / to), "--model", file, "--no-flip"]) == 0
        depth[to] = np.asarray(Image.open(tmp_path / to / "photo_depth.png")).astype(int)
    assert (tmp_path / "lite.xml").read_text().count('type="FakeQuantize"') > 50
    assert np.abs(depth["onnx"] - depth["torch"]).max() <= 1
    assert 0 < (np.abs(depth["openvino"] - depth["torch"]) / depth["torch"]).mean() < 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--int8"], "--int8 needs --calibrate FOLDER"),
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
