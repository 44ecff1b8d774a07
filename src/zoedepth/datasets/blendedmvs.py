"""BlendedMVS: reconstructed scenes, in the layout of its archives."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import read_pfm, read_text

_LISTS = {"train": ("BlendedMVS_training.txt", "training_list.txt"), "val": ("validation_list.txt",)}
"""Split → names of its list of scenes; older downloads have the second name."""


class BlendedMVS(PublishedDataset):
    """Buildings, sculptures and things from many sides, photo and depth rendered from a reconstruction.

    The depth of each scene has a scale of its own, so the target is disparity: 1 / depth. A few maps are empty, because
    the reconstruction has holes. 106 of the 113 scenes are "train".
    """

    about = About(
        title="BlendedMVS",
        page="https://github.com/YoYo000/BlendedMVS",
        licence="CC BY 4.0",
        kind="disparity",
        domain="",
        layout="""
BlendedMVS_training.txt, validation_list.txt                  (else from project_lists/ of the page)
5c1f33f1d33e1f2e4aa6dda4/blended_images/00000000.jpg          (either resolution; *_masked.jpg is not needed)
5c1f33f1d33e1f2e4aa6dda4/rendered_depth_maps/00000000.pfm
5c1f33f1d33e1f2e4aa6dda4/cams/00000000_cam.txt
""",
        unit="float PFM, depth up to a scale of each scene, 0 unknown",
        splits={"train": None, "val": None},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        names = _LISTS[self.split]
        name = next((name for name in names if (self.root / name).is_file()), names[0])
        pairs = []
        for scene, *_ in self.lines(name, origin="from project_lists/ of github.com/YoYo000/BlendedMVS"):
            folder = self.inside(scene)
            for photo in self.find(f"{folder.relative_to(self.root)}/blended_images/*.jpg"):
                if not photo.stem.endswith("_masked"):
                    target = folder / "rendered_depth_maps" / f"{photo.stem}.pfm"
                    pairs.append(PairFiles(photo, target, camera=folder / "cams" / f"{photo.stem}_cam.txt"))
        return pairs

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        depth = read_pfm(pair.target)
        known = np.isfinite(depth) & (depth > 0)
        return 1 / np.where(known, depth, 1), known

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        # The words "extrinsic", 16 numbers, "intrinsic", 9 numbers, and the range of depth.
        assert pair.camera is not None
        try:
            words = read_text(pair.camera).split()
            start = words.index("intrinsic") + 1
            matrix = [float(word) for word in words[start : start + 9]]
            return Intrinsics(matrix[0], matrix[4], matrix[2], matrix[5])
        except (ValueError, IndexError) as error:
            raise InputError(f"{pair.camera} is not a camera file of MVSNet ({error})") from error
