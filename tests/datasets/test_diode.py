from pathlib import Path

import numpy as np
import pytest
from tests.datasets.base import DatasetTester, write_photo

from zoedepth.data.sample import Sample
from zoedepth.datasets import DATASETS
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

SIZE = (4, 5)


def write_diode(root: Path, split: str, kind: str, depth: float) -> None:
    """Rows: masked though measured, not measured, infinite, ``depth``. The files are (height, width, 1) and float."""
    for number in (10, 20):
        stem = root / f"{split}/{kind}/scene_00019/scan_00183/00019_00183_{kind}_000_{number:03d}"
        write_photo(stem.with_name(f"{stem.name}.png"), SIZE)
        stored, mask = np.full((*SIZE, 1), depth, np.float32), np.ones(SIZE)
        mask[0] = 0
        stored[1] = 0
        stored[2] = np.inf
        np.save(f"{stem}_depth.npy", stored)
        np.save(f"{stem}_depth_mask.npy", mask)


class TestIndoor(DatasetTester):
    name = "diode-indoor"
    split = "test"
    written = ("val", "indoors", 2.5)

    def write(self, root: Path) -> None:
        write_diode(root, *self.written)

    def check_first(self, sample: Sample) -> None:
        folder, kind, depth = self.written
        assert sample.name == f"{folder}/{kind}/scene_00019/scan_00183/00019_00183_{kind}_000_010.png"
        assert not sample.mask[0, :3].any()
        assert (sample.target[0, 3] == depth).all()
        assert sample.domain == self.name.removeprefix("diode-")
        assert sample.camera == Intrinsics(886.81, 927.06, 512, 384)


class TestIndoorTrain(TestIndoor):
    split = "train"
    written = ("train", "indoors", 3.5)


class TestOutdoor(TestIndoor):
    name = "diode-outdoor"
    written = ("val", "outdoor", 250.0)


@pytest.mark.parametrize(("name", "kind"), [("diode-indoor", "indoors"), ("diode-outdoor", "outdoor")])
def test_each_takes_its_own_of_a_folder_with_both(tmp_path: Path, name: str, kind: str):
    write_diode(tmp_path, "val", "indoors", 2.5)
    write_diode(tmp_path, "val", "outdoor", 250.0)
    dataset = DATASETS[name](tmp_path, split="test")
    assert [frame.image.parts[-4] for frame in dataset.pairs] == [kind, kind]


def test_masks_can_be_left_out_as_released(tmp_path: Path):
    write_diode(tmp_path, "val", "indoors", 2.5)
    sample = DATASETS["diode-indoor"](tmp_path, split="test", use_masks=False)[0]
    assert sample.mask[0, 0].all()
    assert (sample.target[0, 0] == 2.5).all()
    assert not sample.mask[0, 1:3].any()


def test_a_mask_of_another_size_is_an_error(tmp_path: Path):
    write_diode(tmp_path, "val", "indoors", 2.5)
    dataset = DATASETS["diode-indoor"](tmp_path, split="test")
    np.save(dataset.pairs[0].masks[0], np.ones((2, 2)))
    with pytest.raises(InputError, match=r"_depth_mask\.npy is \(2, 2\)"):
        dataset[0]
