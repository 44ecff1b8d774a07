"""KITTI raw with the depth of its depth-prediction benchmark, in the layout of the Eigen split."""

from collections.abc import Sequence

import numpy as np

from zoedepth.data.facts import camera_of_photo
from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.geometry.lens import Lens
from zoedepth.stored import read_png, read_text


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

    def list_pairs(self) -> Sequence[PairFiles]:
        name = f"kitti_eigen_{self.split}_files_with_gt.txt"
        rows = self.lines(name, origin="from github.com/cleinc/bts", files=("a photo", "its depth"))
        folder = "gt" if (self.root / "gt").is_dir() else ""
        pairs = []
        for row in rows:
            target = None if row[1] == "None" else self.inside(f"{folder}/{row[1]}")
            pairs.append(PairFiles(self.inside(row[0]), target, lens=_lens(row[2:])))
        return pairs

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        depth = read_png(pair.target).astype(np.float32) / 256
        return depth, depth > 0

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        # <date>/<drive>/image_02/data/<frame>.png
        calibration = pair.image.parents[3] / "calib_cam_to_cam.txt"
        if not calibration.is_file():  # BTS's list has the focal lengths of the calibrations
            return camera_of_photo(pair.lens, size)
        for line in read_text(calibration).splitlines():
            if line.startswith(f"P_rect_{pair.image.parents[1].name.removeprefix('image_')}:"):
                try:
                    row = [float(word) for word in line.split()[1:]]
                    return Intrinsics(row[0], row[5], row[2], row[6])
                except (ValueError, IndexError) as error:
                    raise InputError(f"{calibration}: {line[:9]} is not a matrix of 12 numbers ({error})") from error
        raise InputError(f"{calibration} has no P_rect of {pair.image.parents[1].name}: unpack the calibration again")


def _lens(words: list[str]) -> Lens | None:
    """Return the lens of the third word of a line of the list, where it is one."""
    try:
        return Lens(focal_px=float(words[0]))
    except (IndexError, ValueError, InputError):
        return None
