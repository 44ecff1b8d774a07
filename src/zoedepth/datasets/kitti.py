"""KITTI raw with the depth of its depth-prediction benchmark, in the layout of the Eigen split."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, Frame, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import read_png


class KITTI(PublishedDataset):
    """Streets from a car, with accumulated lidar. Eigen's split; 45 of its 697 test photos have no depth."""

    about = About(
        title="KITTI (Eigen split)",
        page="https://www.cvlibs.net/datasets/kitti/",
        licence="CC BY-NC-SA 3.0",
        kind="depth",
        domain="outdoor",
        layout="""
kitti_eigen_train_files_with_gt.txt, kitti_eigen_test_files_with_gt.txt     (from github.com/cleinc/bts)
2011_09_26/2011_09_26_drive_0002_sync/image_02/data/0000000069.png          (raw data)
2011_09_26/calib_cam_to_cam.txt                                             (raw data; not needed for training)
2011_09_26_drive_0002_sync/proj_depth/groundtruth/image_02/0000000069.png   (annotated depth, train and val merged;
                                                                             may lie in a subfolder gt/)
""",
        unit="16-bit PNG, metres = value / 256, 0 unknown",
        splits={"train": 23158, "test": 697},
        sparse=True,
    )

    def list_frames(self) -> Sequence[Frame]:
        rows = self.lines(f"kitti_eigen_{self.split}_files_with_gt.txt", origin="from github.com/cleinc/bts")
        folder = "gt" if (self.root / "gt").is_dir() else ""
        frames = []
        for number, row in enumerate(rows, start=1):
            if len(row) < 2:
                raise InputError(self.explain(f"line {number} of the list must name a photo and its depth"))
            target = None if row[1] == "None" else self.inside(f"{folder}/{row[1]}")
            frames.append(Frame(self.inside(row[0]), target))
        return frames

    def read_target(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        assert frame.target is not None
        depth = read_png(frame.target).astype(np.float32) / 256
        return depth, depth > 0

    def read_camera(self, frame: Frame, size: tuple[int, int]) -> Intrinsics | None:
        # <date>/<drive>/image_02/data/<frame>.png
        calibration = frame.image.parents[3] / "calib_cam_to_cam.txt"
        if not calibration.is_file():
            return None
        for line in calibration.read_text(encoding="utf-8").splitlines():
            if line.startswith(f"P_rect_{frame.image.parents[1].name.removeprefix('image_')}:"):
                row = [float(word) for word in line.split()[1:]]
                return Intrinsics(row[0], row[5], row[2], row[6])
        raise InputError(f"{calibration} has no P_rect of {frame.image.parents[1].name}")
