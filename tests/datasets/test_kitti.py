from pathlib import Path

import numpy as np
import pytest
from tests.datasets.base import DatasetTester, write_photo, write_png

from zoedepth.data.sample import Sample
from zoedepth.datasets.kitti import KITTI
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

SIZE = (37, 124)
CALIBRATION = """calib_time: 09-Jan-2012 13:57:47
P_rect_02: 7.215377e+02 0.000000e+00 6.095593e+02 4.485728e+01 0.000000e+00 7.215377e+02 1.728540e+02 2.163791e-01 \
0.000000e+00 0.000000e+00 1.000000e+00 2.745884e-03
P_rect_03: 1 0 3 0 0 2 4 0 0 0 1 0
"""


def write_kitti(root: Path, split: str, *, gt: str = "") -> None:
    """Three photos, of which the last has no truth in the test list."""
    drive = "2011_09_26_drive_0002_sync"
    rows = []
    for frame in ("0000000005", "0000000010", "0000000069"):
        photo = f"2011_09_26/{drive}/image_02/data/{frame}.png"
        depth = f"{drive}/proj_depth/groundtruth/image_02/{frame}.png"
        write_photo(root / photo, SIZE)
        if split == "test" and frame == "0000000069":
            rows.append(f"{photo} None 721.5377")
            continue
        stored = np.zeros(SIZE, np.uint16)
        stored[20:30:3, ::4] = 256 * 12 + 64
        write_png(root / gt / depth, stored)
        rows.append(f"{photo} {depth} 721.5377")
    (root / f"kitti_eigen_{split}_files_with_gt.txt").write_text("\n".join(rows) + "\n")
    (root / "2011_09_26/calib_cam_to_cam.txt").write_text(CALIBRATION)


class TestTrain(DatasetTester):
    name = "kitti"
    n_frames = 3

    def write(self, root: Path) -> None:
        write_kitti(root, self.split)

    def check_first(self, sample: Sample) -> None:
        assert sample.mask.sum() == 4 * 31
        assert sample.mask[0, 20, 4]
        assert not sample.mask[0, 21, 4]
        assert (sample.target[sample.mask] == 12.25).all()
        assert sample.domain == "outdoor"
        assert sample.camera == Intrinsics(721.5377, 721.5377, 609.5593, 172.854)


class TestTest(TestTrain):
    split = "test"
    n_frames = 2

    def test_photos_without_truth_stay_where_allowed(self, root: Path):
        dataset = KITTI(root, split="test", allow_missing=True)
        assert len(dataset) == 3
        assert dataset.missing_files() == []
        assert not dataset[2].mask.any()


def test_depth_may_lie_in_a_folder_of_its_own(tmp_path: Path):
    write_kitti(tmp_path, "train", gt="gt")
    assert KITTI(tmp_path)[0].mask.any()


@pytest.mark.parametrize(
    ("word", "known"), [(" 100.5", True), ("", False), (" 0", False), (" 2", False), (" x", False)]
)
def test_without_calibration_the_list_says_the_focal_length(tmp_path: Path, word: str, known: bool):
    write_kitti(tmp_path, "train")
    (tmp_path / "2011_09_26/calib_cam_to_cam.txt").unlink()
    path = tmp_path / "kitti_eigen_train_files_with_gt.txt"
    path.write_text(path.read_text().replace(" 721.5377", word))
    assert KITTI(tmp_path)[0].camera == (Intrinsics(100.5, 100.5, 61.5, 18.0) if known else None)


@pytest.mark.parametrize("line", ["photo.png", "../../etc/passwd None 1"])
def test_a_bad_list_is_an_error(tmp_path: Path, line: str):
    write_kitti(tmp_path, "train")
    (tmp_path / "kitti_eigen_train_files_with_gt.txt").write_text(line + "\n")
    with pytest.raises(InputError, match=r"line 1 of .* must name a photo and its depth|leads out of"):
        KITTI(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("P_rect_02", "P_02", "calib_cam_to_cam.txt has no P_rect of image_02: unpack the calibration again"),
        ("6.095593e+02", "right", "P_rect_02 is not a matrix of 12 numbers .*right"),
        (
            CALIBRATION.partition("P_rect_02: ")[2].partition("\n")[0],
            "1 0 3",
            "P_rect_02 is not a matrix of 12 numbers",
        ),
    ],
    ids=["missing", "a word", "cut off"],
)
def test_a_calibration_that_does_not_say_the_camera_is_an_error(tmp_path: Path, old: str, new: str, message: str):
    write_kitti(tmp_path, "train")
    assert old in CALIBRATION
    (tmp_path / "2011_09_26/calib_cam_to_cam.txt").write_text(CALIBRATION.replace(old, new))
    with pytest.raises(InputError, match=message):
        KITTI(tmp_path)[0]
