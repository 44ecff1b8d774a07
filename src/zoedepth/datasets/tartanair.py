"""TartanAir v1: flights through rendered places, in the layout of its archives."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, Frame, PublishedDataset
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import read_npy

_INDOOR = ("carwelding", "hospital", "office", "office2")


class TartanAir(PublishedDataset):
    """A camera's flights through 18 rendered places, four of them indoors, left camera.

    The sky is known and about 10000 m away: as disparity it is practically 0, which is what training on relative depth
    wants. Those who train on metres have to bound the depth.
    """

    about = About(
        title="TartanAir v1",
        page="https://theairlab.org/tartanair-dataset/",
        licence="CC BY 4.0",
        kind="depth",
        domain="",
        layout="""
abandonedfactory/Easy/P001/image_left/000000_left.png            (also Hard; also abandonedfactory/abandonedfactory/
abandonedfactory/Easy/P001/depth_left/000000_left_depth.npy       Easy/..., as the archives unpack where they lie)
""",
        unit="float32 metres (.npy), sky about 10000",
        splits={"train": None},
    )

    def list_frames(self) -> Sequence[Frame]:
        pattern = "*/*/P*/image_left/*_left.png"
        photos = self.find(pattern if any(self.root.glob(pattern)) else f"*/{pattern}")
        return [Frame(photo, photo.parents[1] / "depth_left" / f"{photo.stem}_depth.npy") for photo in photos]

    def read_target(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        assert frame.target is not None
        depth = read_npy(frame.target).astype(np.float32)
        return depth, np.isfinite(depth) & (depth > 0)

    def read_camera(self, frame: Frame, size: tuple[int, int]) -> Intrinsics | None:
        # Of the 640x480 photos; given by the authors.
        return Intrinsics(320, 320, 320, 240)

    def domain_of(self, frame: Frame) -> str:
        # <place>/Easy/P001/image_left/000000_left.png
        return "indoor" if frame.image.parents[3].name in _INDOOR else "outdoor"
