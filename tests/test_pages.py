"""The commands and programs on pages of the documentation work as they stand."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.geometry.test_exif import FILM_LENGTH, photo_of
from tests.pages import blocks

from zoedepth.calibration import is_calibrated, read_calibration
from zoedepth.cli import main
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.outputs.sidecar import read_sidecar

DOCS = Path(__file__).parent.parent / "docs"


def shown(page: str, language: str) -> list[str]:
    return blocks((DOCS / page).read_text(encoding="utf-8"), language)


def commands(page: str) -> list[list[str]]:
    """Return the words of each command of zoedepth on a page."""
    lines = [line.split(" #")[0] for block in shown(page, "bash") for line in block.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith("zoedepth ")]


@pytest.fixture
def workplace(tmp_path: Path, tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write everything that the page on cameras names into the current folder; every model's name is a tiny model's."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("zoedepth.load_model", lambda name: tiny_model)
    for load in ("load_model", "load_for_prediction"):
        monkeypatch.setattr(f"zoedepth.weights.load.{load}", lambda name, **given: tiny_model)
    for folder in ("photos", "sparse"):
        (tmp_path / folder).mkdir()
    for photo in ("photo.jpg", "photos/a.jpg"):
        photo_of(tmp_path / photo, (640, 480), {FILM_LENGTH: 26})
    (tmp_path / "camera.yaml").write_text(
        "image_width: 1280\nimage_height: 960\ncamera_matrix: {data: [1000, 0, 640, 0, 1000, 480, 0, 0, 1]}\n"
    )
    (tmp_path / "sparse" / "cameras.txt").write_text("1 SIMPLE_PINHOLE 640 480 500 320 240\n")
    np.savetxt(tmp_path / "matrix.txt", [[500, 0, 320], [0, 500, 240], [0, 0, 1]])
    return tmp_path


def test_cameras(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in commands("cameras.md"):
        assert main([*words, "--no-preview", "--no-flip"]) == 0, words
    told = {
        sidecar.relative_to(workplace / "depth").as_posix(): read_sidecar(sidecar)["camera"]
        for sidecar in (workplace / "depth").rglob("*.json")
    }
    assert {name: camera["source"] for name, camera in told.items()} == {
        "photo.json": "exif",
        "wide/photo.json": "given",
        "focal/photo.json": "given",
        "numbers/photo.json": "given",
        "file/a.json": "given",
        "none/a.json": "assumed",
        "colmap/a.json": "given",
        "matrix/a.json": "given",
        "again/a.json": "given",
    }
    assert told["numbers/photo.json"]["cx"] == 318.6
    assert told["again/a.json"] == told["wide/photo.json"]
    assert (told["file/a.json"]["fx"], told["colmap/a.json"]["cx"]) == (500, 319.5)
    (program,) = shown("cameras.md", "python")
    exec(program, {})
    assert capsys.readouterr().out.splitlines()[0].startswith("exif 67.")


def test_scale(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The commands for clusters need clusters; ``tests/jobs`` has a Ray of this machine."""
    for photo in ("b", "c"):
        photo_of(workplace / "photos" / f"{photo}.jpg", (640, 480), {FILM_LENGTH: 26})
    for words in commands("scale.md"):
        if "ray" not in words:
            options = ["--no-preview", "--no-flip"] if words[0] == "predict" else []
            assert main([*words, *options]) == 0, words
    (program,) = shown("scale.md", "python")
    capsys.readouterr()
    exec(program, {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[-1] == "3 done, 0 done before"


def test_calibration(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for photo in ("b", "c"):
        photo_of(workplace / "photos" / f"{photo}.jpg", (640, 480), {FILM_LENGTH: 26})
    sparse = np.zeros((480, 640), np.uint16)
    sparse[::40, ::40] = 2000
    Image.fromarray(sparse).save(workplace / "sparse.png")
    for words in commands("calibration.md"):
        options = [] if "--undo" in words else ["--no-flip", "--domain", "indoor"]
        assert main([*words, *options]) == 0, words
    assert read_calibration("camera.json").n_photos == 3
    assert is_calibrated(workplace / "depth" / "photo.json")
    assert not is_calibrated(workplace / "depth" / "photos" / "a.json")
    (program,) = shown("calibration.md", "python")
    capsys.readouterr()
    exec(program, {})
    scale, scale_error, expected_error = map(float, capsys.readouterr().out.splitlines()[0].split())
    assert scale > 0
    assert expected_error > scale_error > 0
