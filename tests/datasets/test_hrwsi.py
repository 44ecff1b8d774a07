from pathlib import Path

import numpy as np
import pytest
from tests.datasets.base import DatasetTester, write_photo, write_png

from zoedepth.data.sample import Sample
from zoedepth.datasets.hrwsi import HRWSI
from zoedepth.errors import InputError

SIZE = (4, 6)


def write_split(root: Path, split: str, disparity: int) -> None:
    """Columns: disparity 0, then ``disparity``. The first row is not valid."""
    for name in ("boat_1", "cat_2"):
        write_photo(root / f"{split}/imgs/{name}.jpg", SIZE)
        stored, valid = np.full(SIZE, disparity, np.uint8), np.full(SIZE, 255, np.uint8)
        stored[:, 0] = 0
        valid[0] = 0
        write_png(root / f"{split}/gts/{name}.png", stored)
        write_png(root / f"{split}/valid_masks/{name}.png", valid)


class TestTrain(DatasetTester):
    name = "hrwsi"
    disparity = 200

    def write(self, root: Path) -> None:
        write_split(root, "train", 200)
        write_split(root, "val", 100)

    def check_first(self, sample: Sample) -> None:
        assert sample.name == f"{self.split}/imgs/boat_1.jpg"
        assert not sample.mask[0, 0].any()
        assert sample.mask[0, 1:].all(), "0 is the farthest, not unknown"
        assert (sample.target[0, 1:, 0] == 0).all()
        assert (sample.target[0, 1:, 1:] == self.disparity).all()
        assert sample.kind == "disparity"
        assert sample.camera is None


class TestVal(TestTrain):
    split = "val"
    disparity = 100


def test_a_mask_of_another_size_is_an_error(tmp_path: Path):
    write_split(tmp_path, "train", 200)
    dataset = HRWSI(tmp_path)
    write_png(dataset.pairs[0].masks[0], np.full((2, 2), 255, np.uint8))
    with pytest.raises(InputError, match=r"valid_masks/boat_1\.png is \(2, 2\)"):
        dataset[0]


def test_a_missing_mask_is_an_error(tmp_path: Path):
    write_split(tmp_path, "train", 200)
    (tmp_path / "train/valid_masks/cat_2.png").unlink()
    with pytest.raises(InputError, match=r"train/valid_masks/cat_2\.png"):
        HRWSI(tmp_path)
