"""The page about files: its commands and programs work as they stand, and it names every kind of file."""

import ast
import re
import shlex
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.pages import blocks

from zoedepth.cli import main
from zoedepth.outputs import OUTPUTS, Options
from zoedepth.outputs.surface import MAX_TEXTURE
from zoedepth.stored import read_depth

PAGE = (Path(__file__).parent.parent / "docs" / "formats.md").read_text(encoding="utf-8")


def programs() -> list[str]:
    """Return the page's programs in Python whose libraries are installed."""
    found = blocks(PAGE, "python")
    assert len(found) > 5

    def runs(program: str) -> bool:
        imports = [node for node in ast.walk(ast.parse(program)) if isinstance(node, ast.Import | ast.ImportFrom)]
        names = [node.module if isinstance(node, ast.ImportFrom) else node.names[0].name for node in imports]
        return all(find_spec(str(name).partition(".")[0]) for name in names)

    return [program for program in found if runs(program)]


def test_commands_and_programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("OpenEXR")
    pytest.importorskip("fast_simplification")
    monkeypatch.chdir(tmp_path)
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (96, 128, 3), dtype=np.uint8)).save("photo.jpg")
    Path("frames").mkdir()
    Image.open("photo.jpg").save("frames/000001.png")  # as ffmpeg takes them out of a film
    commands = re.findall(r"^zoedepth .*|(?<=`)zoedepth [^`]*--out[^`]*(?=`)", PAGE, flags=re.MULTILINE)
    assert len(commands) == 3
    for command in commands:
        assert main(shlex.split(command.partition("#")[0])[1:]) == 0, command
    assert {path.name for path in Path("depth").glob("000001*")} == {
        "000001_color.png", "000001_depth.png", "000001.json",
    }  # fmt: skip
    names: dict[str, object] = {}
    for program in programs():
        exec(program, names)
    # The command and the program may compute with different runtimes.
    np.testing.assert_allclose(read_depth("depth.exr"), read_depth("depth/photo_depth.exr"), rtol=1e-4)
    assert Path("photo.glb").is_file()
    points, message = names["points"], names["message"]
    assert isinstance(points, np.ndarray)
    trimesh = pytest.importorskip("trimesh")
    main(["predict", "photo.jpg", "--save", "ply", "--out", "depth"])
    np.testing.assert_allclose(points, trimesh.load("depth/photo.ply").vertices, rtol=1e-4, atol=1e-5)
    assert isinstance(message, dict)
    assert len(message["data"]) == message["step"] * message["height"]


def test_every_kind_of_file_is_named() -> None:
    table = PAGE.partition("## Units")[0]
    rows = {line.split("|")[1].strip(): line for line in table.splitlines() if line.startswith("| `")}
    for name, output in OUTPUTS.items():
        row = next(row for first, row in rows.items() if first.startswith(f"`{name}`"))
        assert f"`NAME{output.ending}`" in row
    assert f"{Options().max_triangles:,}" in PAGE
    assert f"{MAX_TEXTURE} pixels" in PAGE
