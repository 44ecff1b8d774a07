"""SUN RGB-D, in its official folders or as the flat archives of its test photos and depth."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import read_numbers, read_png16

_LISTS = {"train": "sunrgbd_training_images.txt", "test": "sunrgbd_testing_images.txt"}
_ORIGIN = "from github.com/ankurhanda/sunrgbd-meta-data; it is the split of the toolbox's allsplit.mat"

_MAX_DEPTH = 8.0
"""Metres. Larger depth is set to this, as by ``read3dPoints.m`` of the official toolbox; no protocol scores it."""


class SUNRGBD(PublishedDataset):
    """Rooms by four depth cameras, their holes filled by the authors. "test" is the official 5050 photos.

    There are two layouts, told apart by the folder SUNRGBD/. In the flat one depth ends at 6.55 m, the most that its 16
    bits hold, and no camera is known. ZoeDepth's released loader reads it in millimetres: everything is 10 times too
    far.
    """

    about = About(
        title="SUN RGB-D",
        page="https://rgbd.cs.princeton.edu/",
        licence="custom",
        kind="depth",
        domain="indoor",
        layout="""
sunrgbd_testing_images.txt, sunrgbd_training_images.txt      (from github.com/ankurhanda/sunrgbd-meta-data)
SUNRGBD/kv2/kinect2data/<photo>/image/0000103.jpg            (SUNRGBD.zip; also kv1, realsense, xtion)
SUNRGBD/kv2/kinect2data/<photo>/depth_bfx/0000103.png
SUNRGBD/kv2/kinect2data/<photo>/intrinsics.txt
  or flat (SUNRGBD-test_images.tgz and sunrgb_test_depth.tgz, linked at github.com/ankurhanda/sunrgbd-meta-data)
test/rgb/rgb/img-000001.jpg
test/gt/gt/1.png
""",
        unit="16-bit PNG, bits rotated right by 3 are millimetres, 0 unknown; flat: metres = value / 10000, 0 unknown",
        splits={"train": 5285, "test": 5050},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        if (self.root / "SUNRGBD").is_dir():
            rows = self.lines(_LISTS[self.split], origin=_ORIGIN)
            return [_official_pair(self.inside(" ".join(row))) for row in rows]
        photos = {self._number(photo): photo for photo in self.find(f"{self.split}/rgb/rgb/*.jpg")}
        folder = self.root / self.split / "gt" / "gt"
        depths = {self._number(path): path for path in sorted(folder.glob("*.png"))}
        return [PairFiles(photos[number], depths.get(number, folder / f"{number}.png")) for number in sorted(photos)]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        stored = read_png16(pair.target)
        if pair.camera is None:
            depth = stored.astype(np.float32) / 10000
        else:
            depth = (stored >> 3 | stored << 13).astype(np.float32) / 1000
        return np.minimum(depth, _MAX_DEPTH), depth > 0

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        if pair.camera is None:
            return None
        matrix = read_numbers(pair.camera)
        if len(matrix) != 9:
            raise InputError(f"{pair.camera} must hold the 9 numbers of a camera matrix; it holds {len(matrix)}")
        return Intrinsics(matrix[0], matrix[4], matrix[2], matrix[5])

    def _number(self, path: Path) -> int:
        """Return the number in a file's name: 12 for img-000012.jpg and for 12.png."""
        found = re.search(r"(\d+)$", path.stem)
        if found is None:
            raise InputError(self.explain(f"{path} has no number at the end of its name"))
        return int(found[1])


def _official_pair(photo: Path) -> PairFiles:
    folder = photo.parent.parent
    # The folder has one file; with some cameras it is not named after the photo.
    depth = min((folder / "depth_bfx").glob("*.png"), default=folder / "depth_bfx" / f"{photo.stem}.png")
    return PairFiles(photo, depth, camera=folder / "intrinsics.txt")
