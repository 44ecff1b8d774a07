"""Virtual KITTI 2, in the layout of its archives of photos and depth."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import read_png16

_FOLDERS = (("vkitti_2.0.3_rgb", "vkitti_2.0.3_depth"), ("rgb", "depth"), (".", "."))
"""(photos, depth): a folder for each archive, named after it or as ZoeDepth wants it, or one folder for both."""

_SKY = 65535
_TEST_SHARE = 0.08


class VKITTI2(PublishedDataset):
    """Rendered drives of KITTI, left camera, in ten kinds of weather and view.

    There is no official split. The paper's 8 % for testing were drawn without a seed and are lost. "test" is our own
    8 %: the photos whose names below Scene*/ have the smallest SHA-256. They are as many as the
    paper's, but not the same.
    """

    about = About(
        title="Virtual KITTI 2",
        page="https://europe.naverlabs.com/research/computer-vision/proxy-virtual-worlds-vkitti-2/",
        licence="CC BY-NC-SA 3.0",
        kind="depth",
        domain="outdoor",
        layout="""
vkitti_2.0.3_rgb/Scene01/clone/frames/rgb/Camera_0/rgb_00000.jpg          (or rgb/Scene01/..., or Scene01/...)
vkitti_2.0.3_depth/Scene01/clone/frames/depth/Camera_0/depth_00000.png    (or depth/Scene01/..., or Scene01/...)
""",
        unit="16-bit PNG, centimetres, 65535 is sky",
        splits={"train": 19559, "test": 1701},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        photos_in, depth_in = next(both for both in _FOLDERS if (self.root / both[0]).is_dir())
        base = self.root / photos_in
        photos = {
            path.relative_to(base).as_posix(): path
            for path in self.find(f"{photos_in}/Scene*/*/frames/rgb/Camera_0/rgb_*.jpg")
        }
        drawn = sorted(photos, key=lambda name: hashlib.sha256(name.encode()).digest())
        n_test = round(_TEST_SHARE * len(drawn))
        chosen = sorted(drawn[:n_test] if self.split == "test" else drawn[n_test:])
        return [PairFiles(photos[name], self.root / depth_in / _depth_name(name)) for name in chosen]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        stored = read_png16(pair.target)
        return stored.astype(np.float32) / 100, (stored > 0) & (stored < _SKY)

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        # The camera of all photos, 1242x375: intrinsic.txt of the archive textgt.
        return Intrinsics(725.0087, 725.0087, 620.5, 187.0)


def _depth_name(photo: str) -> Path:
    """Return the name of a photo's depth: Scene01/clone/frames/depth/Camera_0/depth_00000.png for …/rgb_00000.jpg."""
    scene, variant, frames, _, camera, name = photo.split("/")
    number = Path(name).stem.removeprefix("rgb_")
    return Path(scene, variant, frames, "depth", camera, f"depth_{number}.png")
