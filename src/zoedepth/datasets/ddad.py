"""DDAD, exported to photos and lidar depth of the front camera."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.stored import read_npy


class DDAD(PublishedDataset):
    """Streets from a car, front camera, lidar up to 250 m. "test" is the official validation: 50 drives.

    The archive has point clouds, not depth: export it first, with the authors' ``dgp`` package
    (``SynchronizedSceneDataset(..., datum_names=("camera_01", "lidar"), generate_depth_from_datum="lidar")``).
    """

    about = About(
        title="DDAD",
        page="https://github.com/TRI-ML/DDAD",
        licence="CC BY-NC-SA 4.0",
        kind="depth",
        domain="outdoor",
        layout="""
ddad_val/000000_rgb.png      (exported with github.com/TRI-ML/dgp: validation, CAMERA_01, depth from the lidar)
ddad_val/000000_depth.npy
""",
        unit="float metres (.npy), 0 unknown",
        splits={"test": 3950},
        sparse=True,
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        photos = self.find("ddad_val/*_rgb.png")
        return [PairFiles(photo, photo.with_name(f"{photo.stem.removesuffix('_rgb')}_depth.npy")) for photo in photos]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        depth = read_npy(pair.target).astype(np.float32)
        return depth, np.isfinite(depth) & (depth > 0)
