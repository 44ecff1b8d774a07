"""ApolloScape: the stereo half, in the layout of its archives."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.images import PICTURE_SUFFIXES
from zoedepth.stored import read_png

_NOTHING = 65535
"""The value in the ground truth of the official evaluation wherever its masks are empty; 0 does not occur there."""


class ApolloScape(PublishedDataset):
    """Streets from a car, left camera, disparity from lidar and models of the cars.

    ApolloScape's other half, for scene parsing, has depth of things that do not move. Which half the paper trained on
    is not documented; later work took this one. It is not documented either whether the camera file describes the
    rectified pictures, so the file is not read.
    """

    about = About(
        title="ApolloScape stereo",
        page="https://github.com/ApolloScapeAuto/dataset-api",
        licence="non-commercial, educational",
        kind="disparity",
        domain="outdoor",
        layout="""
stereo_train_001/camera_5/171206_034559609_Camera_5.jpg      (also 002, 003)
stereo_train_001/disparity/171206_034559609_Camera_5.png
""",
        unit="16-bit PNG, disparity without a unit, unknown where 0 or 65535",
        splits={"train": None},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        return [
            PairFiles(photo, photo.parents[1] / "disparity" / f"{photo.stem}.png")
            for photo in self.find("stereo_train_*/camera_5/*")
            if photo.suffix.lower() in PICTURE_SUFFIXES
        ]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        stored = read_png(pair.target)
        return stored.astype(np.float32), (stored > 0) & (stored < _NOTHING)
