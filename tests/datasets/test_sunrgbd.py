from pathlib import Path

import numpy as np
import pytest
from tests.datasets.base import DatasetTester, write_photo, write_png

from zoedepth.data.sample import Sample
from zoedepth.datasets.sunrgbd import SUNRGBD
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

SIZE = (4, 5)
LISTS = {"train": "sunrgbd_training_images.txt", "test": "sunrgbd_testing_images.txt"}


def write_official(root: Path, split: str) -> None:
    """Two photos; as in the list in circulation, the path of one has a slash too many."""
    rows = []
    for number, slash in ((63, "/"), (103, "//")):
        folder = f"SUNRGBD/kv2/kinect2data/{number:06d}_2014-05-26-resize"
        stored = np.full(SIZE, 16000, np.uint16)  # 2000 mm * 8
        stored[0] = 0
        stored[1] = 1  # its lowest bit is the highest of 8192 mm
        write_photo(root / folder / f"image/{number:07d}.jpg", SIZE)
        write_png(root / folder / f"depth_bfx/{number:07d}.png", stored)
        (root / folder / "intrinsics.txt").write_text("529.5 0 365\n0 530.5 265\n0 0 1")
        rows.append(f"{folder}{slash}image/{number:07d}.jpg")
    (root / LISTS[split]).write_text("\n".join(rows))


class TestOfficial(DatasetTester):
    name = "sunrgbd"
    split = "test"

    def write(self, root: Path) -> None:
        write_official(root, self.split)

    def check_first(self, sample: Sample) -> None:
        assert sample.name == "SUNRGBD/kv2/kinect2data/000063_2014-05-26-resize/image/0000063.jpg"
        assert not sample.mask[0, 0].any()
        assert sample.mask[0, 1:].all()
        assert (sample.target[0, 1] == 8).all(), "8.192 m, clamped"
        assert (sample.target[0, 2:] == 2).all()
        assert sample.domain == "indoor"
        assert sample.camera == Intrinsics(529.5, 530.5, 365, 265)


class TestOfficialTrain(TestOfficial):
    split = "train"


class TestFlat(DatasetTester):
    name = "sunrgbd"
    split = "test"

    def write(self, root: Path) -> None:
        for number in (2, 10):
            write_photo(root / f"test/rgb/rgb/img-{number:06d}.jpg", SIZE)
            stored = np.full(SIZE, 10000 * number // 4, np.uint16)  # a quarter of its number in metres
            stored[0] = 0
            write_png(root / f"test/gt/gt/{number}.png", stored)

    def check_first(self, sample: Sample) -> None:
        assert sample.name == "test/rgb/rgb/img-000002.jpg"
        assert not sample.mask[0, 0].any()
        assert (sample.target[0, 1:] == 0.5).all()
        assert sample.camera is None

    def test_photos_and_depth_are_paired_by_their_numbers(self, root: Path):
        assert (SUNRGBD(root, split="test")[1].target[0, 1:] == 2.5).all()


def test_official_folders_need_the_list_and_say_where_it_is(tmp_path: Path):
    write_official(tmp_path, "test")
    with pytest.raises(InputError, match=r"sunrgbd_training_images\.txt \(get it from github\.com/ankurhanda"):
        SUNRGBD(tmp_path, split="train")


def test_depth_may_have_another_name_than_its_photo(tmp_path: Path):
    write_official(tmp_path, "test")
    depth = SUNRGBD(tmp_path, split="test").pairs[0].target
    assert depth is not None
    depth.rename(depth.with_name("0000063_abs.png"))
    assert SUNRGBD(tmp_path, split="test").missing_files() == []


def test_a_photo_without_a_number_is_an_error(tmp_path: Path):
    write_photo(tmp_path / "test/rgb/rgb/kitchen.jpg", SIZE)
    with pytest.raises(InputError, match=r"kitchen\.jpg has no number"):
        SUNRGBD(tmp_path, split="test")


def test_depth_of_8_bits_is_an_error(tmp_path: Path):
    write_photo(tmp_path / "test/rgb/rgb/img-000001.jpg", SIZE)
    write_png(tmp_path / "test/gt/gt/1.png", np.ones(SIZE, np.uint8))
    with pytest.raises(InputError, match=r"1\.png must have 16 bits a pixel; it has 8"):
        SUNRGBD(tmp_path, split="test")[0]


def test_a_camera_that_is_no_matrix_is_an_error(tmp_path: Path):
    write_official(tmp_path, "test")
    dataset = SUNRGBD(tmp_path, split="test")
    camera = dataset.pairs[0].camera
    assert camera is not None
    camera.write_text("529.5 530.5 365 265")
    with pytest.raises(InputError, match=r"intrinsics\.txt must hold the 9 numbers"):
        dataset[0]
