"""DIML/CVL RGB-D: rooms by a Kinect v2 and streets by stereo cameras, as two data sets."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import read_png, read_png16

_SAMPLES = {"train": ("train/HR", "train/LR"), "test": ("test/HR", "test/LR", "HR", "LR")}
"""Split → folders that may hold its photos in the sample release; the first that does is taken, and has the largest.
ZoeDepth's folder is test/ itself."""

_FARTHEST_INDOOR = 65500
_MIN_CONFIDENCE = 0.9


class DIMLIndoor(PublishedDataset):
    """Rooms by a Kinect v2, its depth filled and enlarged to the photo. The full release is all "train".

    It is said to have about 220 000 pairs. The camera is the one that other people's loaders take.
    """

    about = About(
        title="DIML/CVL RGB-D indoor",
        page="https://dimlrgbd.github.io/",
        licence="custom",
        kind="depth",
        domain="indoor",
        layout="""
<scene>/<date>/<batch>/col/<name>_c.png                    (full release)
<scene>/<date>/<batch>/up_png/<name>_<suffix>.png
  or (sample release; split "test": test/, or its HR/ alone)
train/HR/<scene>/color/<name>_c.png                        (or train/LR/...)
train/HR/<scene>/depth_filled/<name>_depth_filled.png
""",
        unit="16-bit PNG, millimetres, unknown where 0 or above 65500",
        splits={"train": None, "test": 503},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        for folder in _SAMPLES[self.split]:
            if photos := sorted(self.root.glob(f"{folder}/*/color/*_c.png")):
                return [
                    PairFiles(
                        photo, photo.parents[1] / "depth_filled" / f"{photo.stem.removesuffix('_c')}_depth_filled.png"
                    )
                    for photo in photos
                ]
        pairs = []
        for folder in self.find("*/*/*/col" if self.split == "train" else "test/HR/*/color/*_c.png"):
            depths = folder.with_name("up_png")
            # A folder has one suffix for all of its files; which one is not documented.
            one = min(depths.glob("*.png"), default=None)
            suffix = one.stem.rpartition("_")[2] if one else "*"
            for photo in sorted(folder.glob("*_c.png")):
                pairs.append(PairFiles(photo, depths / f"{photo.stem.removesuffix('_c')}_{suffix}.png"))
        return pairs

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        stored = read_png16(pair.target)
        return stored.astype(np.float32) / 1000, (stored > 0) & (stored <= _FARTHEST_INDOOR)

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        return Intrinsics(1081, 1081, 704, 396) if size == (792, 1408) else None


class DIMLOutdoor(PublishedDataset):
    """Streets, parks and buildings by stereo cameras, depth by stereo matching. The full release is all "train".

    "test" is the 500 pairs of the sample release, in the layout that ZoeDepth tests on. It is not certain that the
    paper tested on these, in this unit: the released code gives another result on them than the paper's.
    """

    about = About(
        title="DIML/CVL RGB-D outdoor",
        page="https://dimlrgbd.github.io/",
        licence="custom",
        kind="depth",
        domain="outdoor",
        layout="""
<folder>/<batch>/left/<name>_left.png            (full release)
<folder>/<batch>/depth/<name>_depth.png
<folder>/<batch>/conf/<name>_conf.png            (optional)
  or (sample release; split "test": test/, or its HR/ alone, or any folder with these two)
train/HR/outleft/<name>.png                      (or train/LR/...)
train/HR/depthmap/<name>.png
train/HR/confidencemap/<name>.png                (optional; not read for "test")
""",
        unit="16-bit PNG, millimetres, unknown where 0 or where the 8-bit confidence / 255 is not above 0.9",
        splits={"train": None, "test": 500},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        for folder in (*_SAMPLES[self.split], *(["*"] if self.split == "test" else [])):
            if photos := sorted(self.root.glob(f"{folder}/outleft/*.png")):
                return [
                    PairFiles(
                        photo,
                        photo.parents[1] / "depthmap" / photo.name,
                        # The paper's protocol scores all depth.
                        () if self.split == "test" else _optional(photo.parents[1] / "confidencemap" / photo.name),
                    )
                    for photo in photos
                ]
        pairs = []
        for photo in self.find("*/*/left/*_left.png" if self.split == "train" else "test/HR/outleft/*.png"):
            batch, name = photo.parents[1], photo.stem.removesuffix("_left")
            confidence = _optional(batch / "conf" / f"{name}_conf.png")
            pairs.append(PairFiles(photo, batch / "depth" / f"{name}_depth.png", confidence))
        return pairs

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        stored = read_png16(pair.target)
        known = stored > 0
        for path in pair.masks:
            confidence = read_png(path)
            if confidence.shape != stored.shape:
                raise InputError(f"{path} is {confidence.shape} and {pair.target} is {stored.shape}: sizes must agree")
            known &= confidence > 255 * _MIN_CONFIDENCE
        return stored.astype(np.float32) / 1000, known

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        # The ZED's camera at its full size; its principal point is not published, and is taken to be the middle.
        return Intrinsics(1398.4, 1398.4, 959.5, 539.5) if size == (1080, 1920) else None


def _optional(path: Path) -> tuple[Path, ...]:
    """Return the file if its folder exists; then it must exist, too."""
    return (path,) if path.parent.is_dir() else ()
