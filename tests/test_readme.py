"""The README's commands and programs work as they stand, and the documentation leads to all of its pages."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.pages import blocks
from tests.twins import KITTI, NYU, twin, twin_config

from zoedepth.cli import main
from zoedepth.weights.checkpoint import Checkpoint, write_checkpoint
from zoedepth.weights.layouts import huggingface

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def commands(program: str) -> list[str]:
    lines = [line.split(" #")[0].strip() for block in blocks(README, "bash") for line in block.splitlines()]
    return [line for line in lines if line.startswith(program + " ")]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write everything that the README's commands name, and return the folder."""
    folder = tmp_path_factory.mktemp("readme")
    rng = np.random.default_rng(0)

    def photo(path: Path, height: int, width: int) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(rng.integers(0, 256, (height, width, 3), dtype=np.uint8)).save(path)

    photo(folder / "photo.jpg", 480, 640)
    photo(folder / "photos" / "a.jpg", 120, 160)
    for name, domain in (("nyu", "indoor"), ("kitti", "outdoor"), ("my_photos", "indoor")):
        photo(folder / name / "image" / "0001.jpg", 120, 160)
        depth = rng.integers(1000, 9000, (120, 160)).astype(np.uint16)
        (folder / name / "depth").mkdir()
        Image.fromarray(depth).save(folder / name / "depth" / "0001.png")
        for split in ("train", "test"):
            (folder / name / f"{split}.csv").write_text(
                "image,depth,depth_scale,domain,fx,fy,cx,cy\n"
                + 2 * f"image/0001.jpg,depth/0001.png,1000,{domain},130,130,79.5,59.5\n"
            )
    # The released weights cannot be had here: a small random model in their file's layout.
    small = twin(twin_config(heads=(NYU, KITTI)))
    config, weights, _ = huggingface.read(small.state_dict(), small.config.to_dict(), layout=5)
    write_checkpoint(Checkpoint(config, weights, "", str), folder / "ZoeD_M12_NK.pt", to="original")
    return folder


@pytest.fixture
def workplace(files: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make the folder of ``files`` the current one."""
    monkeypatch.chdir(files)
    return files


def test_python(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    predict, switch = blocks(README, "python")
    exec(predict, {})
    depth, width = map(float, capsys.readouterr().out.split())
    assert depth > 0
    assert width > 0
    assert (workplace / "depth.png").is_file()
    names: dict[str, object] = {}
    exec(switch.replace("path/of/this/checkout", str(ROOT)), names)
    assert names["depth"].shape == (480, 640)


def test_commands(workplace: Path) -> None:
    lines = commands("zoedepth")
    assert {line.split()[1] for line in lines} == {"predict", "view", "serve", "evaluate", "train", "export", "models"}
    for line in lines:
        # One ends by a signal, and one takes long: tests/commands/test_serve.py and test_export.py type them.
        if line.split()[1] in ("serve", "export"):
            continue
        # The commands as they are, except for the length of the training, and the size of what it sees.
        if line.split()[1:3] == ["train", "finetune"]:
            line += " --steps 1 --batch-size 1"
        elif line.split()[1] == "train":
            line += " --config.steps 1 --config.batch-size 2 --config.n-workers 0 --config.model.size 64 96"
        assert main(shlex.split(line)[1:]) == 0, line
    assert (workplace / "depth" / "photo_depth.png").is_file()
    assert (workplace / "photo.html").is_file()
    assert (workplace / "runs/mine/README.md").is_file()
    assert (workplace / "depth" / "a_preview.jpg").is_file()


def test_make_targets_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert commands("make")
    for line in commands("make"):
        assert re.search(rf"^{line.split()[1]}:", makefile, flags=re.MULTILINE), line


def test_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", README)
    local = [link for link in links if not link.startswith("http")]
    assert local
    assert [link for link in local if not (ROOT / link).exists()] == []


def test_every_page_is_reached_from_the_front_page_and_the_menu() -> None:
    pages = {path.name for path in (ROOT / "docs").glob("*.md")} - {"index.md"}
    front = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert {page for page in pages if f"]({page})" not in front} == set()
    assert {page for page in pages if f": {page}\n" not in menu} == set()
    assert {page for page in pages if f"(docs/{page})" not in README} == set()


def test_what_the_python_page_imports_is_there() -> None:
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    imports = re.findall(r"^(?:from|import) .*", text, flags=re.MULTILINE)
    assert len(imports) > 10
    exec("\n".join(imports), {})
