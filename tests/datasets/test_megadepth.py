from pathlib import Path

import h5py
import numpy as np
import pytest
from tests.datasets.base import DatasetTester, write_photo

from zoedepth.data.sample import Sample
from zoedepth.datasets.megadepth import MegaDepth

SIZE = (3, 101)


def write_depth(path: Path, depth: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        file["depth"] = depth


def write_megadepth(folder: Path) -> None:
    """The second row is 0.5, 1.0, ... 50.5: of its 101 values the first and the last two are beyond the percentiles."""
    depth = np.zeros(SIZE, np.float32)
    depth[1] = np.arange(1, 102) / 2
    for scene, name in (("0000/dense0", "12_o.jpg"), ("0001/dense1", "34_o.JPG")):
        write_photo(folder / scene / "imgs" / name, SIZE)
        write_depth(folder / scene / "depths" / f"{name[:-4]}.h5", depth)


class TestTrain(DatasetTester):
    name = "megadepth"
    folder = "MegaDepth_v1"

    def write(self, root: Path) -> None:
        write_megadepth(root / self.folder)

    def check_first(self, sample: Sample) -> None:
        assert sample.name == (Path(self.folder) / "0000/dense0/imgs/12_o.jpg").as_posix()
        assert sample.mask[0, 1].tolist() == [False] + 98 * [True] + 2 * [False]
        assert not sample.mask[0, [0, 2]].any()
        assert sample.target[0, 1, 1] == 1
        assert sample.target[0, 1, 3] == 0.5
        assert sample.kind == "disparity"
        assert sample.camera is None


class TestAsUnpacked(TestTrain):
    folder = "phoenix/S6/zl548/MegaDepth_v1"


class TestFolderItself(TestTrain):
    folder = "."


LABELS = np.zeros(SIZE, np.float32)
LABELS[0], LABELS[1] = 1, 2
SIGNED = np.full(SIZE, 1.5, np.float32)
SIGNED[2] = -1
FEW = np.zeros(SIZE, np.float32)
FEW[0, :10] = np.arange(10) + 0.5


@pytest.mark.parametrize("stored", [LABELS, SIGNED, FEW, np.zeros(SIZE, np.float32)])
def test_nothing_is_known_where_the_file_has_no_depth(tmp_path: Path, stored: np.ndarray):
    """Labels of what is nearer, in whole numbers or with negative ones; ten pixels; none."""
    write_megadepth(tmp_path)
    write_depth(tmp_path / "0000/dense0/depths/12_o.h5", stored)
    sample = MegaDepth(tmp_path)[0]
    assert not sample.mask.any()
    assert (sample.target == 0).all()


def test_eleven_pixels_are_enough(tmp_path: Path):
    write_megadepth(tmp_path)
    stored = FEW.copy()
    stored[0, 10] = 10.5
    write_depth(tmp_path / "0000/dense0/depths/12_o.h5", stored)
    assert MegaDepth(tmp_path)[0].mask.sum() == 9, "one is beyond either percentile"
