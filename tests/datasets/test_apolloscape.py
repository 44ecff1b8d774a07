from pathlib import Path

import numpy as np
from tests.datasets.base import DatasetTester, write_photo, write_png

from zoedepth.data.sample import Sample

SIZE = (4, 6)


def write_drive(root: Path, part: str, suffix: str) -> None:
    """Rows: nothing (65535), nothing (0), far, near."""
    stored = np.array([[65535], [0], [20], [163]], np.uint16).repeat(SIZE[1], axis=1)
    write_photo(root / f"{part}/camera_5/171206_034559609_Camera_5.{suffix}", SIZE)
    write_photo(root / f"{part}/camera_6/171206_034559609_Camera_6.{suffix}", SIZE)
    write_png(root / f"{part}/disparity/171206_034559609_Camera_5.png", stored)
    write_png(root / f"{part}/fg_mask/171206_034559609_Camera_5.png", (stored == 163).astype(np.uint16) * 65535)


class TestTrain(DatasetTester):
    name = "apolloscape"

    def write(self, root: Path) -> None:
        write_drive(root, "stereo_train_001", "jpg")
        write_drive(root, "stereo_train_003", "png")

    def check_first(self, sample: Sample) -> None:
        assert sample.name == "stereo_train_001/camera_5/171206_034559609_Camera_5.jpg"
        assert not sample.mask[0, :2].any()
        assert sample.mask[0, 2:].all()
        assert (sample.target[0, 2] == 20).all()
        assert (sample.target[0, 3] == 163).all()
        assert sample.kind == "disparity"
        assert sample.domain == "outdoor"
