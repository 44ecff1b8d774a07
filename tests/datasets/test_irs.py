from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from tests.datasets.base import DatasetTester, write_photo

from zoedepth.data.sample import Sample
from zoedepth.datasets.irs import IRS
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

SIZE = (4, 6)
SCENE = "Home/ArchVizInterior03Data"


def write_frame(root: Path, number: str, disparity: float) -> str:
    """Rows: 0, infinite, ``disparity``, twice that. Returns the line of the list."""
    stored = np.array([[0], [np.inf], [disparity], [2 * disparity]], np.float32).repeat(SIZE[1], axis=1)
    names = [
        f"{SCENE}/{kind}_{number}.{suffix}" for kind, suffix in zip("lrdn", ("png", "png", "exr", "exr"), strict=True)
    ]
    for name in names[:2]:
        write_photo(root / "IRSDataset" / name, SIZE)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"G": stored}).write(str(root / "IRSDataset" / names[2]))
    return " ".join(names)


def write_irs(root: Path) -> None:
    (root / "lists").mkdir()
    train = [write_frame(root, "00002", 8), write_frame(root, "00003", 8)]
    test = [write_frame(root, "00001", 16), write_frame(root, "00008", 16)]
    (root / "lists/irs_train.list").write_text("\n".join(train) + "\n")
    (root / "lists/irs_test.list").write_text("\n".join(test) + "\n")


class TestTrain(DatasetTester):
    name = "irs"
    number, disparity = "00002", 8

    def write(self, root: Path) -> None:
        write_irs(root)

    def check_first(self, sample: Sample) -> None:
        assert sample.name == f"IRSDataset/{SCENE}/l_{self.number}.png"
        assert not sample.mask[0, :2].any()
        assert (sample.target[0, 2] == self.disparity).all()
        assert (sample.target[0, 3] == 2 * self.disparity).all()
        assert sample.kind == "disparity"
        assert sample.camera == Intrinsics(480, 480, 2.5, 1.5)


class TestTest(TestTrain):
    split = "test"
    number, disparity = "00001", 16


def test_lists_may_begin_with_the_folder(tmp_path: Path):
    write_irs(tmp_path)
    path = tmp_path / "lists/irs_train.list"
    rows = [" ".join(f"IRSDataset/{word}" for word in line.split()) for line in path.read_text().splitlines()]
    path.write_text("\n".join(rows) + "\t\n")
    assert IRS(tmp_path)[0].name == f"IRSDataset/{SCENE}/l_00002.png"


@pytest.mark.parametrize("line", ["l.png r.png", "../../l.png r.png ../../d.exr"])
def test_a_bad_list_is_an_error(tmp_path: Path, line: str):
    write_irs(tmp_path)
    (tmp_path / "lists/irs_train.list").write_text(line + "\n")
    with pytest.raises(InputError, match=r"line 1 of lists/irs_train\.list must name|leads out of"):
        IRS(tmp_path)
