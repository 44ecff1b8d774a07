"""SUN RGB-D, in its official folders or as the flat archives of its test photos and depth."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zoedepth.datasets.published import About, Frame, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import read_numbers, read_png

_LISTS = {"train": "sunrgbd_training_images.txt", "test": "sunrgbd_testing_images.txt"}
_ORIGIN = "github.com/ankurhanda/sunrgbd-meta-data; it is the split of the toolbox's allsplit.mat"

_MAX_DEPTH = 8.0
"""Metres. Farther is clamped to it, as by ``read3dPoints.m`` of the official toolbox; no protocol scores it."""


class SUNRGBD(PublishedDataset):
    """Rooms by four depth cameras, their holes filled by the authors. "test" is the official 5050 photos.

    Two layouts, told apart by the folder SUNRGBD/. In the flat one depth ends at 6.55 m, all that its 16 bits hold, and
    no camera is known. Read it in millimetres, as ZoeDepth's released loader does, and everything is 10 times too far.
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

    def list_frames(self) -> Sequence[Frame]:
        if (self.root / "SUNRGBD").is_dir():
            rows = self.lines(_LISTS[self.split], origin=_ORIGIN)
            return [_official_frame(self.inside(" ".join(row))) for row in rows]
        photos = {self._number(photo): photo for photo in self.find(f"{self.split}/rgb/rgb/*.jpg")}
        folder = self.root / self.split / "gt" / "gt"
        depths = {self._number(path): path for path in sorted(folder.glob("*.png"))}
        return [Frame(photos[number], depths.get(number, folder / f"{number}.png")) for number in sorted(photos)]

    def read_target(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        assert frame.target is not None
        stored = read_png(frame.target)
        if stored.dtype != np.uint16:
            raise InputError(f"{frame.target} must have 16 bits; it has {8 * stored.dtype.itemsize}")
        if frame.camera is None:
            depth = stored.astype(np.float32) / 10000
        else:
            depth = (stored >> 3 | stored << 13).astype(np.float32) / 1000
        return np.minimum(depth, _MAX_DEPTH), depth > 0

    def read_camera(self, frame: Frame, size: tuple[int, int]) -> Intrinsics | None:
        if frame.camera is None:
            return None
        matrix = read_numbers(frame.camera)
        if len(matrix) != 9:
            raise InputError(f"{frame.camera} must hold the 9 numbers of a camera matrix; it holds {len(matrix)}")
        return Intrinsics(matrix[0], matrix[4], matrix[2], matrix[5])

    def _number(self, path: Path) -> int:
        """img-000012.jpg and 12.png are the twelfth."""
        found = re.search(r"(\d+)$", path.stem)
        if found is None:
            raise InputError(self.explain(f"{path} has no number"))
        return int(found[1])


def _official_frame(photo: Path) -> Frame:
    folder = photo.parent.parent
    # The one file of its folder: some cameras' depth is not called as the photo is.
    depth = min((folder / "depth_bfx").glob("*.png"), default=folder / "depth_bfx" / f"{photo.stem}.png")
    return Frame(photo, depth, camera=folder / "intrinsics.txt")
