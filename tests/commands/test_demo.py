"""The demo: measured depth with the right unit, and every picture it promises."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zoedepth.cli import main
from zoedepth.commands.demo import motorcycle_depth
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.stored import read_depth


def test_measured_depth_is_in_metres() -> None:
    """Middlebury 2014, Motorcycle: the front wheel at 2 m, the garage wall at 5 m."""
    depth = motorcycle_depth()
    assert depth.shape == (500, 741)
    known = depth[depth > 0]
    assert known.size / depth.size == pytest.approx(0.927, abs=1e-3)
    assert known.min() == pytest.approx(2.1, abs=0.1)
    assert known.max() == pytest.approx(5.0, abs=0.1)


def test_demo(
    tmp_path: Path, tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("zoedepth.weights.load.load_for_prediction", lambda name, **_: tiny_model)
    assert main(["demo", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "REL" in printed
    assert printed.strip().splitlines()[-1].startswith("Pictures: ")
    for name in ("motorcycle", "rocket", "coffee"):
        depth = read_depth(tmp_path / f"{name}_depth.png")
        assert np.isfinite(depth).all()
        assert (tmp_path / f"{name}_preview.jpg").is_file()
    with Image.open(tmp_path / "demo.png") as picture:
        assert min(picture.size) > 1000
    assert "<title>coffee</title>" in (tmp_path / "coffee.html").read_text(encoding="utf-8")[:2000]


def test_folder_that_cannot_be_written_to_is_refused_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    for name in ("demo", "demo-train"):
        assert main([name, "--out", str(tmp_path / "file" / "out")]) == 2
        assert "cannot write" in capsys.readouterr().err
    Image.new("RGB", (4, 4)).save(tmp_path / "coffee_preview.jpg")
    assert main(["demo", "--out", str(tmp_path)]) == 2
    assert "coffee_preview.jpg is not from zoedepth, and would be replaced" in capsys.readouterr().err


def test_missing_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "skimage", None)
    assert main(["demo", "--out", str(tmp_path)]) == 2
    assert "pip install 'zoedepth[demo]'" in capsys.readouterr().err
