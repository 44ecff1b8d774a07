"""DIODE: one scanner indoors and outdoors, here as two data sets, as in the paper."""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from zoedepth.datasets.published import About, PairFiles, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import read_npy


class DIODEIndoor(PublishedDataset):
    """Rooms with a laser scanner's dense depth. "test" is the official validation: the test photos have no depth.

    All photos in the folder are taken: the devkit's JSON lists only two thirds of the indoor ones.
    """

    about = About(
        title="DIODE indoor",
        page="https://diode-dataset.org/",
        licence="MIT",
        kind="depth",
        domain="indoor",
        layout="""
val/indoors/scene_00019/scan_00183/00019_00183_indoors_000_010.png          (split "test"; "train" is train/)
val/indoors/scene_00019/scan_00183/00019_00183_indoors_000_010_depth.npy
val/indoors/scene_00019/scan_00183/00019_00183_indoors_000_010_depth_mask.npy
""",
        unit="float32 metres (.npy), unknown where the mask is 0",
        splits={"train": 8574, "test": 325},
    )
    folder: ClassVar[str] = "indoors"
    """The folder below that of the split."""

    def list_pairs(self) -> Sequence[PairFiles]:
        photos = self.find(f"{'val' if self.split == 'test' else self.split}/{self.folder}/scene_*/scan_*/*.png")
        return [
            PairFiles(
                photo,
                photo.with_name(f"{photo.stem}_depth.npy"),
                masks=(photo.with_name(f"{photo.stem}_depth_mask.npy"),),
            )
            for photo in photos
        ]

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        depth, mask = read_npy(pair.target).astype(np.float32), read_npy(pair.masks[0])
        if mask.shape != depth.shape:
            raise InputError(f"{pair.masks[0]} is {mask.shape} and {pair.target} is {depth.shape}: sizes must agree")
        valid = mask > 0 if self.use_masks else np.ones(depth.shape, bool)
        return depth, valid & np.isfinite(depth) & (depth > 0)

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        # The camera of the photos, 1024x768: intrinsics.txt of the devkit.
        return Intrinsics(886.81, 927.06, 512.0, 384.0)


class DIODEOutdoor(DIODEIndoor):
    """Parks, streets and houses by DIODE's scanner, up to 300 m away. "test" is the official validation."""

    about = replace(
        DIODEIndoor.about,
        title="DIODE outdoor",
        domain="outdoor",
        layout=DIODEIndoor.about.layout.replace("val/indoors", "val/outdoor").replace("_indoors_", "_outdoor_"),
        splits={"train": 16884, "test": 446},
    )
    folder = "outdoor"
