from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.datasets.base import DatasetTester, write_photo, write_png

from zoedepth.data.sample import Sample
from zoedepth.datasets.ibims import IBims
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

SIZE = (4, 5)


def write_ibims(folder: Path, listed: Path) -> None:
    """Rows: not measured, invalid, transparent, 10 m."""
    for name in ("corridor_01", "lab_02"):
        stored = np.full(SIZE, 13107, np.uint16)  # 65535 / 5
        stored[0] = 0
        write_photo(folder / f"rgb/{name}.png", SIZE)
        write_png(folder / f"depth/{name}.png", stored)
        for row, kind in ((1, "mask_invalid"), (2, "mask_transp")):
            write_mask(folder / f"{kind}/{name}.png", row)
        (folder / "calib").mkdir(exist_ok=True)
        (folder / f"calib/{name}.txt").write_text("555.1,555.2,321.5,243.5\n")
    listed.write_text("corridor_01\nlab_02\n")


def write_mask(path: Path, row: int) -> None:
    """1 bit, 0 in one row."""
    mask = np.ones(SIZE, bool)
    mask[row] = False
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(mask).save(path)
    with Image.open(path) as written:
        assert written.mode == "1"


class TestIBims(DatasetTester):
    name = "ibims"
    split = "test"

    def write(self, root: Path) -> None:
        write_ibims(root / "ibims1_core_raw", root / "imagelist.txt")

    def check_first(self, sample: Sample) -> None:
        assert sample.name == "ibims1_core_raw/rgb/corridor_01.png"
        assert not sample.mask[0, :3].any()
        assert sample.mask[0, 3].all()
        assert sample.target[0, 3].numpy() == pytest.approx(10)
        assert sample.domain == "indoor"
        assert sample.camera == Intrinsics(555.1, 555.2, 321.5, 243.5)


class TestInsideTheArchive(TestIBims):
    """The archive's own folder, with the list in it."""

    def write(self, root: Path) -> None:
        write_ibims(root, root / "imagelist.txt")

    def check_first(self, sample: Sample) -> None:
        assert sample.name == "rgb/corridor_01.png"
        assert sample.target[0, 3].numpy() == pytest.approx(10)


def test_the_list_may_lie_in_the_archives_folder(tmp_path: Path):
    write_ibims(tmp_path / "ibims1_core_raw", tmp_path / "ibims1_core_raw/imagelist.txt")
    assert len(IBims(tmp_path, split="test")) == 2


def test_masks_of_another_size_are_an_error(tmp_path: Path):
    write_ibims(tmp_path, tmp_path / "imagelist.txt")
    write_png(tmp_path / "mask_transp/lab_02.png", np.ones((2, 2), np.uint8))
    with pytest.raises(InputError, match=r"lab_02\.png is \(2, 2\)"):
        IBims(tmp_path, split="test")[1]


def test_a_camera_of_other_numbers_is_an_error(tmp_path: Path):
    write_ibims(tmp_path, tmp_path / "imagelist.txt")
    (tmp_path / "calib/lab_02.txt").write_text("555.1,555.2")
    with pytest.raises(InputError, match=r"lab_02\.txt must hold four numbers, fx, fy, cx, cy; it holds 2"):
        IBims(tmp_path, split="test")[1]
