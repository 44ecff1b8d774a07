"""NYU Depth v2, in the layout that BTS, AdaBins and ZoeDepth train and test on."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import read_png


class NYU(PublishedDataset):
    """Kinect photos of rooms. "train" is BTS's sampling of the raw sequences, "test" the official 654."""

    about = About(
        title="NYU Depth v2",
        page="https://cs.nyu.edu/~fergus/datasets/nyu_depth_v2.html",
        licence="custom, research",
        kind="depth",
        domain="indoor",
        layout="""
nyudepthv2_train_files_with_gt.txt    (from github.com/cleinc/bts; without it, all of sync/)
sync/<scene>/rgb_00000.jpg, sync_depth_00000.png
nyudepthv2_test_files_with_gt.txt     (likewise)
official_splits/test/<scene>/rgb_00045.jpg, sync_depth_00045.png
""",
        unit="16-bit PNG, metres = value / 1000, 0 unknown",
        splits={"train": 24231, "test": 654},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        folder = "sync" if self.split == "train" else "official_splits/test"
        name = f"nyudepthv2_{self.split}_files_with_gt.txt"
        if (self.root / name).is_file():
            rows = self.lines(name, origin="from github.com/cleinc/bts", files=("a photo", "its depth"))
            # The paths of the lists in circulation are relative to the folder itself.
            base = folder if not self.inside(rows[0][0]).is_file() else ""
            return [PairFiles(self.inside(f"{base}/{row[0]}"), self.inside(f"{base}/{row[1]}")) for row in rows]
        photos = self.find(f"{folder}/*/rgb_*.jpg")
        return [
            PairFiles(photo, photo.with_name(f"sync_depth_{photo.stem.removeprefix('rgb_')}.png")) for photo in photos
        ]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        depth = read_png(pair.target).astype(np.float32) / 1000
        return depth, depth > 0

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        # The camera of the photos, 640x480, from the authors' toolbox.
        return Intrinsics(518.8579, 519.4696, 325.5824, 253.7362)
