from pathlib import Path

import numpy as np
import pytest
from tests.datasets.base import DatasetTester, write_photo, write_png

from zoedepth.data.sample import Sample
from zoedepth.datasets.diml import DIMLIndoor, DIMLOutdoor
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

SIZE = (4, 6)
NAMES = ("in_00_160126_155728", "in_00_160126_155801")


def rows(*values: int, dtype: type = np.uint16) -> np.ndarray:
    return np.array(values, dtype)[:, None].repeat(SIZE[1], axis=1)


MILLIMETRES = rows(0, 65501, 65500, 1250)
"""From the top: unknown; more than a Kinect's filled depth may be; 65.5 m; 1.25 m."""


def write_indoor(folder: Path, photos: str, depths: str, suffix: str) -> None:
    for name in NAMES:
        write_photo(folder / f"{photos}/{name}_c.png", SIZE)
        write_png(folder / f"{depths}/{name}_{suffix}.png", MILLIMETRES)


class TestIndoorFull(DatasetTester):
    name = "diml-indoor"

    def write(self, root: Path) -> None:
        write_indoor(root / "16. Billiard Hall/160126/01", "col", "up_png", "ud")

    def check_first(self, sample: Sample) -> None:
        assert sample.name.endswith(f"/{NAMES[0]}_c.png")
        assert sample.mask[0].all(dim=1).tolist() == [False, False, True, True]
        assert not sample.mask[0, :2].any()
        assert (sample.target[0, 2] == 65.5).all()
        assert (sample.target[0, 3] == 1.25).all()
        assert sample.domain == "indoor"
        assert sample.camera is None, "known at the full release's size only"


class TestIndoorSample(TestIndoorFull):
    """Both sizes and both splits are there."""

    def write(self, root: Path) -> None:
        for folder in ("train/LR", "train/HR", "test/LR", "test/HR"):
            write_indoor(root / folder / "12. Livingroom", "color", "depth_filled", "depth_filled")

    def check_first(self, sample: Sample) -> None:
        super().check_first(sample)
        assert sample.name.startswith(f"{self.split}/HR/")


class TestIndoorSampleTest(TestIndoorSample):
    split = "test"


class TestIndoorTestFolder(TestIndoorFull):
    split = "test"

    def write(self, root: Path) -> None:
        write_indoor(root / "LR/12. Livingroom", "color", "depth_filled", "depth_filled")


def test_camera_of_the_full_indoor_release(tmp_path: Path):
    write_indoor(tmp_path / "Cafe/160126/01", "col", "up_png", "ud")
    write_photo(tmp_path / f"Cafe/160126/01/col/{NAMES[0]}_c.png", (792, 1408))
    write_png(tmp_path / f"Cafe/160126/01/up_png/{NAMES[0]}_ud.png", np.full((792, 1408), 1000, np.uint16))
    dataset = DIMLIndoor(tmp_path)
    assert dataset[0].camera == Intrinsics(1081, 1081, 704, 396)
    assert dataset[1].camera is None


def test_the_full_indoor_release_has_no_test_split(tmp_path: Path):
    write_indoor(tmp_path / "Cafe/160126/01", "col", "up_png", "ud")
    with pytest.raises(InputError, match="there is no test/HR/"):
        DIMLIndoor(tmp_path, split="test")


def test_indoor_photos_without_any_depth_are_an_error(tmp_path: Path):
    write_indoor(tmp_path / "Cafe/160126/01", "col", "up", "ud")
    with pytest.raises(InputError, match="2 files that belong to its 2 photos are missing"):
        DIMLIndoor(tmp_path)


def test_depth_of_8_bits_is_an_error(tmp_path: Path):
    write_indoor(tmp_path / "Cafe/160126/01", "col", "up_png", "ud")
    write_png(tmp_path / f"Cafe/160126/01/up_png/{NAMES[0]}_ud.png", np.full(SIZE, 9, np.uint8))
    with pytest.raises(InputError, match=r"_ud\.png must have 16 bits"):
        DIMLIndoor(tmp_path)[0]


def write_outdoor(folder: Path, *, confidence: bool = True) -> None:
    """Rows: unknown, unsure (229 / 255 < 0.9), 65.535 m, 20 m."""
    for name in NAMES:
        write_photo(folder / f"left/{name}_left.png", SIZE)
        write_png(folder / f"depth/{name}_depth.png", rows(0, 5000, 65535, 20000))
        if confidence:
            write_png(folder / f"conf/{name}_conf.png", rows(255, 229, 230, 255, dtype=np.uint8))


def write_outdoor_sample(folder: Path) -> None:
    for name in NAMES:
        write_photo(folder / f"outleft/{name}.png", SIZE)
        write_png(folder / f"depthmap/{name}.png", rows(0, 5000, 65535, 20000))
        write_png(folder / f"confidencemap/{name}.png", rows(255, 229, 230, 255, dtype=np.uint8))


class TestOutdoorFull(DatasetTester):
    name = "diml-outdoor"
    known = (False, False, True, True)

    def write(self, root: Path) -> None:
        write_outdoor(root / "170721_C0/A")

    def check_first(self, sample: Sample) -> None:
        assert sample.mask[0].all(dim=1).tolist() == list(self.known)
        assert sample.mask[0].any(dim=1).tolist() == list(self.known)
        assert np.allclose(sample.target[0, 2:, 0], [65.535, 20])
        assert sample.domain == "outdoor"
        assert sample.camera is None, "known at the ZED's full size only"


class TestOutdoorFullWithoutConfidence(TestOutdoorFull):
    known = (False, True, True, True)

    def write(self, root: Path) -> None:
        write_outdoor(root / "170721_C0/A", confidence=False)


class TestOutdoorSample(TestOutdoorFull):
    def write(self, root: Path) -> None:
        for folder in ("train/LR", "train/HR", "test/LR", "test/HR"):
            write_outdoor_sample(root / folder)

    def check_first(self, sample: Sample) -> None:
        super().check_first(sample)
        assert sample.name == f"{self.split}/HR/outleft/{NAMES[0]}.png"


class TestOutdoorSampleTest(TestOutdoorSample):
    split = "test"
    known = (False, True, True, True)


class TestOutdoorTestFolder(TestOutdoorFull):
    """As ZoeDepth reads it: any folders with outleft/ and depthmap/."""

    split = "test"
    known = (False, True, True, True)

    def write(self, root: Path) -> None:
        write_outdoor_sample(root / "park")


def test_two_sizes_of_the_outdoor_test_photos_are_not_mixed(tmp_path: Path):
    write_outdoor_sample(tmp_path / "HR")
    write_outdoor_sample(tmp_path / "LR")
    assert [frame.image.parts[-3] for frame in DIMLOutdoor(tmp_path, split="test").pairs] == ["HR", "HR"]


def test_outdoor_test_photos_are_not_for_training(tmp_path: Path):
    write_outdoor_sample(tmp_path / "HR")
    with pytest.raises(InputError, match=r"there is no \*/\*/left/"):
        DIMLOutdoor(tmp_path)


def test_camera_of_the_zed(tmp_path: Path):
    write_outdoor_sample(tmp_path / "HR")
    write_photo(tmp_path / f"HR/outleft/{NAMES[0]}.png", (1080, 1920))
    camera = DIMLOutdoor(tmp_path, split="test")[0].camera
    # Of the photo at the depth's size, 4x6.
    assert camera is not None
    assert camera.fx == pytest.approx(1398.4 * 6 / 1920)
    assert camera.cx == pytest.approx(2.5)
    assert camera.cy == pytest.approx(1.5)


def test_confidence_of_another_size_is_an_error(tmp_path: Path):
    write_outdoor(tmp_path / "170721_C0/A")
    write_png(tmp_path / f"170721_C0/A/conf/{NAMES[0]}_conf.png", np.full((2, 2), 255, np.uint8))
    with pytest.raises(InputError, match=r"_conf\.png is \(2, 2\)"):
        DIMLOutdoor(tmp_path)[0]
