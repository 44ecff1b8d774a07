"""The page about three dimensions: its commands and its program work as they stand."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.pages import blocks

import zoedepth
from zoedepth.cli import main
from zoedepth.geometry.mesh import Mesh
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.panorama import PanoramaMap

PAGE = (Path(__file__).parent.parent / "docs" / "three-d.md").read_text(encoding="utf-8")


@pytest.fixture(autouse=True)
def workplace(tmp_path: Path, tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with the photos that the page names; every model is the tiny one."""
    monkeypatch.chdir(tmp_path)
    for name, size in (("photo.jpg", (48, 64)), ("panorama.jpg", (48, 96))):
        Image.fromarray(np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8)).save(name)

    def load_model(name: str, **options: object) -> ZoeDepth:
        return tiny_model

    monkeypatch.setattr(zoedepth, "load_model", load_model)  # first: it is found in the other, and kept
    for load in ("load_model", "load_for_prediction"):
        monkeypatch.setattr(f"zoedepth.weights.load.{load}", load_model)
    return tmp_path


def test_commands_make_the_files_that_are_promised() -> None:
    pytest.importorskip("OpenEXR")
    commands = re.findall(r"^zoedepth .*", PAGE, flags=re.MULTILINE)
    assert len(commands) == 5
    for command in commands:
        assert main(shlex.split(command.partition("#")[0])[1:]) == 0, command
    for name in ("photo.html", "panorama.html", "depth/photo.glb", "depth/photo.ply", "around/panorama.glb"):
        assert Path(name).stat().st_size > 1000
    with np.load("around/panorama.npz") as arrays:
        assert str(arrays["projection"]) == "equirectangular"
    assert '"place": "around"' in Path("panorama.html").read_text(encoding="utf-8")


def test_program() -> None:
    pytest.importorskip("fast_simplification")
    names: dict[str, object] = {}
    (program,) = blocks(PAGE, "python")
    exec(program, names)
    around = names["around"]
    assert isinstance(around, PanoramaMap)
    assert isinstance(around.mesh(), Mesh)
    assert Path("photo.glb").read_bytes()[:4] == Path("panorama.glb").read_bytes()[:4] == b"glTF"


def test_pictures_are_there() -> None:
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", PAGE)
    assert len(pictures) == 3
    for name in pictures:
        with Image.open(Path(__file__).parent.parent / "docs" / name) as picture:
            assert min(picture.size) > 500
