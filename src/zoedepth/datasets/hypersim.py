"""Hypersim: rendered rooms, in the layout of its scene archives."""

import csv
import math
from collections.abc import Sequence
from io import StringIO

import numpy as np

from zoedepth.datasets.published import MAX_LIST, About, PairFiles, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics, depth_of_distance
from zoedepth.stored import read_hdf5, read_text

_LIST = "metadata_images_split_scene_v1.csv"
_COLUMNS = ("scene_name", "camera_name", "frame_id", "included_in_public_release", "split_partition_name")


class Hypersim(PublishedDataset):
    """Rooms modelled by artists, 1024x768, with the official split by scenes. Only the scenes of the split are needed.

    The files hold the distance from the camera, which becomes depth along the optical axis here. The camera is the
    nominal one of 60 degrees: like everyone who is compared on this set, we ignore the lens shift of some scenes.
    """

    about = About(
        title="Hypersim",
        page="https://github.com/apple/ml-hypersim",
        licence="CC BY-SA 3.0",
        kind="depth",
        domain="indoor",
        layout="""
metadata_images_split_scene_v1.csv     (from evermotion_dataset/analysis/ of github.com/apple/ml-hypersim)
ai_001_001/images/scene_cam_00_final_preview/frame.0000.tonemap.jpg
ai_001_001/images/scene_cam_00_geometry_hdf5/frame.0000.depth_meters.hdf5
""",
        unit="HDF5 'dataset', metres from the camera along the ray, NaN unknown",
        splits={"train": 59543, "val": 7386, "test": 7690},
    )

    def list_pairs(self) -> Sequence[PairFiles]:
        path = self.root / _LIST
        try:
            rows = list(csv.DictReader(StringIO(read_text(path, max_bytes=MAX_LIST), newline="")))
        except (InputError, csv.Error) as error:
            raise InputError(self.explain(f"cannot read the list {path}: {error}")) from error
        pairs = []
        for line, row in enumerate(rows, start=2):
            if any(row.get(column) is None for column in _COLUMNS) or not row["frame_id"].isdecimal():
                raise InputError(f"{path}, line {line}: needs the columns {', '.join(_COLUMNS)}; get the list again")
            if row["split_partition_name"] != self.split or row["included_in_public_release"] != "True":
                continue
            start = f"{row['scene_name']}/images/scene_{row['camera_name']}"
            name = f"frame.{int(row['frame_id']):04d}"
            photo = self.inside(f"{start}_final_preview/{name}.tonemap.jpg")
            pairs.append(PairFiles(photo, self.inside(f"{start}_geometry_hdf5/{name}.depth_meters.hdf5")))
        return pairs

    def read_target(self, pair: PairFiles) -> tuple[np.ndarray, np.ndarray]:
        assert pair.target is not None
        distance = read_hdf5(pair.target, "dataset").astype(np.float32)
        known = np.isfinite(distance) & (distance > 0)
        return depth_of_distance(distance, _camera(distance.shape)), known

    def read_camera(self, pair: PairFiles, size: tuple[int, int]) -> Intrinsics | None:
        return _camera(size)


def _camera(size: tuple[int, ...]) -> Intrinsics:
    """Return the camera that sees 60 degrees from left to right: a focal length of 886.81 pixels at a width of 1024."""
    focal = size[1] / 2 / math.tan(math.radians(30))
    return Intrinsics(focal, focal, (size[1] - 1) / 2, (size[0] - 1) / 2)
