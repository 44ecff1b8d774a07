from pathlib import Path

import numpy as np
import pytest
from tests.datasets.base import DatasetTester, write_photo, write_png

from zoedepth.data.sample import Sample
from zoedepth.datasets.vkitti2 import VKITTI2
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

SIZE = (3, 5)


def write_vkitti(root: Path, photos: str = "vkitti_2.0.3_rgb", depth: str = "vkitti_2.0.3_depth") -> None:
    """25 photos of the left camera, one of the right. Rows: sky, 0.07 m, 12.34 m."""
    stored = np.array([[65535], [7], [1234]], np.uint16).repeat(SIZE[1], axis=1)
    frames = [("Scene01/clone", number) for number in range(20)] + [("Scene20/fog", number) for number in range(5)]
    for scene, number in frames:
        write_photo(root / photos / scene / f"frames/rgb/Camera_0/rgb_{number:05d}.jpg", SIZE)
        write_png(root / depth / scene / f"frames/depth/Camera_0/depth_{number:05d}.png", stored)
    write_photo(root / photos / "Scene01/clone/frames/rgb/Camera_1/rgb_00000.jpg", SIZE)


class TestTrain(DatasetTester):
    name = "vkitti2"
    n_frames = 23

    def write(self, root: Path) -> None:
        write_vkitti(root)

    def check_first(self, sample: Sample) -> None:
        assert sample.name.startswith("vkitti_2.0.3_rgb/Scene")
        assert not sample.mask[0, 0].any()
        assert sample.target[0, 1].numpy() == pytest.approx(0.07)
        assert sample.target[0, 2].numpy() == pytest.approx(12.34)
        assert sample.domain == "outdoor"
        assert sample.camera == Intrinsics(725.0087, 725.0087, 620.5, 187)


class TestTest(TestTrain):
    split = "test"
    n_frames = 2  # 8 % of 25


def test_splits_share_nothing_and_leave_nothing_out(tmp_path: Path):
    write_vkitti(tmp_path)
    train, test = ({frame.image for frame in VKITTI2(tmp_path, split=split).pairs} for split in ("train", "test"))
    assert not train & test
    assert len(train | test) == 25


@pytest.mark.parametrize(("photos", "depth"), [("rgb", "depth"), (".", ".")])
def test_other_layouts_have_the_same_split(tmp_path: Path, photos: str, depth: str):
    write_vkitti(tmp_path / "a")
    write_vkitti(tmp_path / "b", photos, depth)
    names = [
        [frame.image.relative_to(dataset.root).parts[-6:] for frame in dataset.pairs]
        for dataset in (VKITTI2(tmp_path / folder, split="test") for folder in ("a", "b"))
    ]
    assert names[0] == names[1]
    assert (VKITTI2(tmp_path / "b", split="test")[0].target[0, 2] > 12).all()


def test_the_split_never_changes(tmp_path: Path):
    """The two of 25 whose names' SHA-256 is smallest, by sha256sum."""
    write_vkitti(tmp_path)
    folder = tmp_path / "vkitti_2.0.3_rgb/Scene01/clone/frames/rgb/Camera_0"
    found = [frame.image for frame in VKITTI2(tmp_path, split="test").pairs]
    assert found == [folder / "rgb_00008.jpg", folder / "rgb_00009.jpg"]


def test_depth_of_8_bits_is_an_error(tmp_path: Path):
    write_vkitti(tmp_path)
    dataset = VKITTI2(tmp_path)
    target = dataset.pairs[0].target
    assert target is not None
    write_png(target, np.ones(SIZE, np.uint8))
    with pytest.raises(InputError, match=r"must have 16 bits a pixel; it has 8"):
        dataset[0]
