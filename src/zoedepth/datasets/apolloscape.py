"""ApolloScape: the stereo half, in the layout of its archives."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, Frame, PublishedDataset
from zoedepth.images import PICTURE_SUFFIXES
from zoedepth.stored import read_png

_NOTHING = 65535
"""As in the ground truth that comes with the official evaluation, wherever its masks are empty; 0 there is none."""


class ApolloScape(PublishedDataset):
    """Streets from a car, left camera, disparity from lidar and models of the cars.

    ApolloScape's other half, for scene parsing, has depth of what does not move; which half the paper trained on is not
    documented, and later work took this one. Nor is it documented whether the file of the camera is about the rectified
    pictures: it is not read.
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

    def list_frames(self) -> Sequence[Frame]:
        return [
            Frame(photo, photo.parents[1] / "disparity" / f"{photo.stem}.png")
            for photo in self.find("stereo_train_*/camera_5/*")
            if photo.suffix.lower() in PICTURE_SUFFIXES
        ]

    def read_target(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        assert frame.target is not None
        stored = read_png(frame.target)
        return stored.astype(np.float32), (stored > 0) & (stored < _NOTHING)
