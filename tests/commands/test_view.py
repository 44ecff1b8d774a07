"""The view command: its options arrive, and nothing is replaced. ``tests/outputs/test_html.py`` tests the pages."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from zoedepth.cli import main
from zoedepth.geometry.camera import Camera
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.outputs import Maps, write_maps

XMP = b'<x:xmpmeta xmlns:x="adobe:ns:meta/" GPano:ProjectionType="equirectangular"/>'


@pytest.fixture(autouse=True)
def model(tiny_model: ZoeDepth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Every model name gives the tiny model, and commands run in an empty folder; the names are kept."""
    asked: dict[str, Any] = {}
    for load in ("load_model", "load_for_prediction"):
        monkeypatch.setattr(f"zoedepth.weights.load.{load}", lambda name, **_: asked.update(name=name) or tiny_model)
    monkeypatch.chdir(tmp_path)
    return asked


def write_photo(name: str, size: tuple[int, int] = (30, 40), **options: Any) -> str:
    noise = np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8)
    Image.fromarray(noise).save(name, **options)
    return name


def facts(page: str) -> dict[str, str]:
    found = re.search(r'id="facts">(.*?)</script>', Path(page).read_text(encoding="utf-8"))
    assert found
    return json.loads(found[1])


def test_a_photo_becomes_a_page_with_its_name(model: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", write_photo("my photo.png"), "--model", "some"]) == 0
    assert facts("my photo.html") == {"kind": "glb", "up": "y", "place": "photo"}
    assert "<title>my photo.png</title>" in Path("my photo.html").read_text(encoding="utf-8")
    assert "my photo.html" in capsys.readouterr().out
    assert model == {"name": "some"}
    assert main(["view", "my photo.png"]) == 0  # replaces its own page


def test_the_page_is_opened_where_there_is_a_browser(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: not opened.append(address) and len(opened) == 1)
    photo = write_photo("my photo.png")
    for said in ("MB).\n", "MB). No browser was found here: open it elsewhere.\n"):
        assert main(["view", photo, "--open"]) == 0
        assert capsys.readouterr().out.endswith(said)
    assert opened == [Path("my photo.html").resolve().as_uri()] * 2


def test_points_of_a_photo(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--cloud", "--max-points", "100", "--out", "folder/page.html", "--fov-x", "50"]
    assert main(["view", write_photo("photo.png"), *arguments]) == 0
    assert facts("folder/page.html") == {"kind": "ply", "up": "-y", "place": "photo"}


def test_what_is_too_far_is_not_shown(capsys: pytest.CaptureFixture[str]) -> None:
    photo = write_photo("photo.png")
    sizes = []
    for end in ((), ("--max-depth", "1000")):
        assert main(["view", photo, "--cloud", *end]) == 0
        sizes.append(Path("photo.html").stat().st_size)
    assert sizes[0] == sizes[1]
    assert main(["view", photo, "--cloud", "--max-depth", "0.01"]) == 2
    assert "no pixel has a depth that makes a point" in capsys.readouterr().err
    assert main(["view", photo, "--max-depth", "0"]) == 2
    assert "points end at a distance above 0 m (--max-depth" in capsys.readouterr().err


def test_panoramas_are_asked_for_or_known_by_their_notes() -> None:
    assert main(["view", write_photo("around.png", (32, 64)), "--panorama"]) == 0
    assert facts("around.html")["place"] == "around"
    assert main(["view", write_photo("sphere.jpg", (32, 64), xmp=XMP)]) == 0
    assert facts("sphere.html")["place"] == "around"
    assert main(["view", write_photo("wide.png", (32, 64))]) == 0
    assert facts("wide.html")["place"] == "photo"


@pytest.mark.parametrize("kind", ["glb", "ply", "pcd"])
def test_files_are_shown_without_a_model(kind: str, model: dict[str, Any]) -> None:
    depth = np.full((6, 8), 2.0, np.float32)
    write_maps(f"shape.{kind}", Maps(depth=depth, camera=Camera.from_fov((6, 8), horizontal=60)))
    assert main(["view", f"shape.{kind}"]) == 0
    assert facts("shape.html") == {"kind": kind, "up": "y" if kind == "glb" else "-y", "place": "photo"}
    assert main(["view", f"shape.{kind}", "--up", "z", "--out", "other.html"]) == 0
    assert facts("other.html")["up"] == "z"
    assert model == {}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "page.txt"], "ends in .html"),
        (["--out", "theirs.html"], "would be replaced"),
        (["--up", "z"], "--up is for files"),
        (["--max-points", "0"], "1 or more"),
        (["--max-triangles", "-5"], "1 or more"),
        (["--panorama"], "twice as wide as high"),
        (["--panorama", "--fov-x", "60"], "has no camera"),
        (["--camera", "none", "--fov-x", "60"], "give one of them"),
    ],
)
def test_what_cannot_be_is_said(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("theirs.html").write_text("<p>mine</p>", encoding="utf-8")
    assert main(["view", write_photo("photo.png"), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert sorted(path.name for path in Path().iterdir()) == ["photo.png", "theirs.html"]
    assert Path("theirs.html").read_text(encoding="utf-8") == "<p>mine</p>"


def test_options_of_photos_are_not_for_files(capsys: pytest.CaptureFixture[str]) -> None:
    Path("shape.ply").write_bytes(b"ply\n")
    for option in (["--cloud"], ["--panorama"], ["--max-depth", "3"]):
        assert main(["view", "shape.ply", *option]) == 2
        assert "are for photos" in capsys.readouterr().err


def test_what_is_no_photo_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    Path("notes.txt").write_text("hello", encoding="utf-8")
    assert main(["view", "notes.txt"]) == 2
    assert "notes.txt" in capsys.readouterr().err
    assert main(["view", "missing.jpg"]) == 2
    assert "missing.jpg" in capsys.readouterr().err
