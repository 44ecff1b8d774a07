"""The examples run as they stand, and do what they say."""

import runpy
import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from PIL import Image

from zoedepth import load_model
from zoedepth.model.heads import HEADS

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.fixture(autouse=True)
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run each example in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(monkeypatch: pytest.MonkeyPatch, name: str, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")


def test_all_examples_are_short_and_tested_here() -> None:
    tests = Path(__file__).read_text(encoding="utf-8")
    for path in EXAMPLES.glob("*.py"):
        assert f'"{path.name}"' in tests, path
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 40, path


def test_one_photo(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], workplace: Path) -> None:
    run(monkeypatch, "one_photo.py")
    assert capsys.readouterr().out.startswith("indoor: ")
    with Image.open(workplace / "depth.png") as depth:
        assert (np.asarray(depth) > 0).all()
    assert (workplace / "preview.jpg").is_file()


def test_folder_of_photos(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], workplace: Path) -> None:
    (workplace / "photos").mkdir()
    for name in ("a", "b"):
        Image.new("RGB", (160, 120), "grey").save(workplace / "photos" / f"{name}.jpg")
    (workplace / "photos" / "c.jpg").write_bytes(b"no photo")
    run(monkeypatch, "folder_of_photos.py", "photos", "depth")
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines] == [str(Path("photos") / f"{name}.jpg") for name in "abc"]
    assert {path.name for path in (workplace / "depth").iterdir()} == {
        f"{name}{ending}" for name in "ab" for ending in ("_depth.png", ".npz", ".json")
    }


def test_finetune(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], workplace: Path) -> None:
    run(monkeypatch, "finetune.py", "synthetic:rooms?n=2&size=96x128", "runs/mine", "1")
    assert "1 steps" in capsys.readouterr().out
    load_model(workplace / "runs" / "mine" / "model.safetensors")


def test_evaluate_models(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run(monkeypatch, "evaluate_models.py", "synthetic:rooms?n=2&size=96x128")
    ours, constant = (line.partition(":") for line in capsys.readouterr().out.splitlines())
    assert (ours[0], constant[0]) == ("zoed-lite", "three metres")
    assert 0 < float(ours[2].split()[1].rstrip(",")) < 2


def test_own_head(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    with patch.dict(HEADS):
        run(monkeypatch, "own_head.py")
    losses = [float(line.rpartition(" ")[2]) for line in capsys.readouterr().out.splitlines()]
    assert losses[-1] < losses[0]
