"""What the README tells people to type works as it stands."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.twins import KITTI, NYU, twin, twin_config

from zoedepth.cli import main
from zoedepth.weights.checkpoint import Checkpoint, write_checkpoint
from zoedepth.weights.layouts import huggingface

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def commands(program: str) -> list[str]:
    lines = [line.split(" #")[0].strip() for block in blocks("bash") for line in block.splitlines()]
    return [line for line in lines if line.startswith(program + " ")]


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with everything that the README's commands name."""
    rng = np.random.default_rng(0)

    def photo(path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(rng.integers(0, 256, (480, 640, 3), dtype=np.uint8)).save(path)

    photo(tmp_path / "photo.jpg")
    photo(tmp_path / "photos" / "a.jpg")
    for folder, domain in (("nyu", "indoor"), ("kitti", "outdoor"), ("my_photos", "indoor")):
        photo(tmp_path / folder / "image" / "0001.jpg")
        depth = rng.integers(1000, 9000, (480, 640)).astype(np.uint16)
        (tmp_path / folder / "depth").mkdir()
        Image.fromarray(depth).save(tmp_path / folder / "depth" / "0001.png")
        for split in ("train", "test"):
            (tmp_path / folder / f"{split}.csv").write_text(
                "image,depth,depth_scale,domain\n" + 2 * f"image/0001.jpg,depth/0001.png,1000,{domain}\n"
            )
    # The released weights cannot be had here: a small random model in their file's layout.
    small = twin(twin_config(heads=(NYU, KITTI)))
    config, weights, _ = huggingface.read(small.state_dict(), small.config.to_dict(), layout=5)
    write_checkpoint(Checkpoint(config, weights, "", str), tmp_path / "ZoeD_M12_NK.pt", to="original")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_python(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    predict, switch = blocks("python")
    exec(predict, {})
    assert float(capsys.readouterr().out) > 0
    assert (workplace / "depth.png").is_file()
    names: dict[str, object] = {}
    exec(switch.replace("path/of/this/checkout", str(ROOT)), names)
    assert names["depth"].shape == (480, 640)


def test_commands(workplace: Path) -> None:
    lines = commands("zoedepth")
    assert {line.split()[1] for line in lines} == {"predict", "evaluate", "train", "export", "models"}
    for line in lines:
        # The commands as they are, but for the length of the training.
        if line.split()[1:3] == ["train", "finetune"]:
            line += " --steps 1 --batch-size 1"
        elif line.split()[1] == "train":
            line += " --config.steps 1 --config.batch-size 2 --config.n-workers 0"
        assert main(shlex.split(line)[1:]) == 0, line
    assert (workplace / "depth" / "photo_depth.png").is_file()
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
