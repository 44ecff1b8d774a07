from pathlib import Path

import numpy as np
import pytest
from tests.datasets.base import DatasetTester, write_photo

from zoedepth.data.sample import Sample
from zoedepth.datasets.tartanair import TartanAir
from zoedepth.geometry.camera import Intrinsics

SIZE = (4, 6)


def write_flight(root: Path, flight: str, depth: float) -> None:
    """Rows: sky, ``depth``, not a number, 0."""
    stored = np.array([[10000], [depth], [np.nan], [0]], np.float32).repeat(SIZE[1], axis=1)
    write_photo(root / flight / "image_left/000007_left.png", SIZE)
    write_photo(root / flight / "image_right/000007_right.png", SIZE)
    (root / flight / "depth_left").mkdir()
    np.save(root / flight / "depth_left/000007_left_depth.npy", stored)
    (root / flight / "pose_left.txt").write_text("0 0 0 0 0 0 1\n")


class TestTrain(DatasetTester):
    name = "tartanair"
    above = ""

    def write(self, root: Path) -> None:
        write_flight(root, f"{self.above}abandonedfactory/Easy/P001", 7.5)
        write_flight(root, f"{self.above.replace('abandonedfactory', 'office')}office/Hard/P010", 2.5)

    def check_first(self, sample: Sample) -> None:
        assert sample.name == f"{self.above}abandonedfactory/Easy/P001/image_left/000007_left.png"
        assert sample.mask[0].all(dim=1).tolist() == [True, True, False, False]
        assert not sample.mask[0, 2:].any()
        assert (sample.target[0, 0] == 10000).all(), "the sky is known"
        assert (sample.target[0, 1] == 7.5).all()
        assert sample.camera == Intrinsics(320, 320, 320, 240)


class TestAsUnpacked(TestTrain):
    above = "abandonedfactory/"


@pytest.mark.parametrize("tester", [TestTrain, TestAsUnpacked])
def test_the_place_says_the_domain(tmp_path: Path, tester: type[TestTrain]):
    tester().write(tmp_path)
    dataset = TartanAir(tmp_path)
    assert [sample.domain for sample in (dataset[0], dataset[1])] == ["outdoor", "indoor"]
    assert dataset.domains == ["indoor", "outdoor"]
