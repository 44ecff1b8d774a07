"""TartanAir v1: flights through rendered places, in the layout of its archives."""

from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import read_npy

_INDOOR = ("carwelding", "hospital", "office", "office2")


class TartanAir(PublishedDataset):
    """A camera's flights through 18 rendered places, four of them indoors, left camera.

    The sky is known and about 10000 m away. Its disparity is practically 0, as training on relative depth needs it;
    bound the depth to train on metres.
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

    def list_pairs(self) -> Sequence[PairFiles]:
        pattern = "*/*/P*/image_left/*_left.png"
        photos = self.find(pattern if any(self.root.glob(pattern)) else f"*/{pattern}")
        return [PairFiles(photo, photo.parents[1] / "depth_left" / f"{photo.stem}_depth.npy") for photo in photos]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        depth = read_npy(pair.target).astype(np.float32)
        return depth, np.isfinite(depth) & (depth > 0)

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        # The camera of the photos, 640x480, given by the authors.
        return Intrinsics(320, 320, 320, 240)

    def domain_of(self, pair: PairFiles) -> str:
        # <place>/Easy/P001/image_left/000000_left.png
        return "indoor" if pair.image.parents[3].name in _INDOOR else "outdoor"
