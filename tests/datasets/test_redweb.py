from pathlib import Path

import numpy as np
from PIL import Image
from tests.datasets.base import DatasetTester, write_photo, write_png

from zoedepth.data.sample import Sample
from zoedepth.datasets.redweb import ReDWeb

SIZE = (4, 6)
ROWS = np.array([[255], [204], [51], [0]], np.uint8)
"""From the top: sky, far, near, nearest."""


def write_redweb(folder: Path) -> None:
    for name in ("0001", "0002"):
        write_photo(folder / f"Imgs/{name}.jpg", SIZE)
        write_png(folder / f"RDs/{name}.png", ROWS.repeat(SIZE[1], axis=1))


class TestTrain(DatasetTester):
    name = "redweb"

    def write(self, root: Path) -> None:
        write_redweb(root / "ReDWeb_V1")

    def check_first(self, sample: Sample) -> None:
        assert sample.name == "ReDWeb_V1/Imgs/0001.jpg"
        assert sample.mask.all(), "the sky is known"
        assert np.allclose(sample.target[0, :, 0], [0, 0.2, 0.8, 1])
        assert (sample.target[0, 0] == sample.target.min()).all(), "the sky is the farthest"
        assert sample.kind == "disparity"


def test_the_folder_itself_will_do(tmp_path: Path):
    write_redweb(tmp_path)
    assert ReDWeb(tmp_path)[0].name == "Imgs/0001.jpg"


def test_grey_may_be_stored_as_colours(tmp_path: Path):
    write_redweb(tmp_path)
    for path in (tmp_path / "RDs").iterdir():
        Image.open(path).convert("RGB").save(path)
    assert np.allclose(ReDWeb(tmp_path)[0].target[0, :, 0], [0, 0.2, 0.8, 1])
