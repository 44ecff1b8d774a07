"""Hypersim: rendered rooms, in the layout of its scene archives."""

import csv
import math
from collections.abc import Sequence

import numpy as np

from zoedepth.datasets.published import About, Frame, PublishedDataset
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics, depth_of_distance
from zoedepth.stored import read_hdf5

_LIST = "metadata_images_split_scene_v1.csv"
_COLUMNS = ("scene_name", "camera_name", "frame_id", "included_in_public_release", "split_partition_name")


class Hypersim(PublishedDataset):
    """Rooms modelled by artists, 1024x768, with the official split by scenes. Only the scenes of the split are needed.

    The files hold the distance from the camera; here it is depth along the optical axis. The camera is the nominal one
    of 60 degrees: the lens shift of some scenes is left out, as by everyone who is compared on this set.
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

    def list_frames(self) -> Sequence[Frame]:
        path = self.root / _LIST
        try:
            with path.open(newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise InputError(self.explain(f"cannot read the list {path}")) from error
        frames = []
        for line, row in enumerate(rows, start=2):
            if any(row.get(column) is None for column in _COLUMNS) or not row["frame_id"].isdecimal():
                raise InputError(f"{path}, line {line}: needs {', '.join(_COLUMNS)}")
            if row["split_partition_name"] != self.split or row["included_in_public_release"] != "True":
                continue
            start = f"{row['scene_name']}/images/scene_{row['camera_name']}"
            name = f"frame.{int(row['frame_id']):04d}"
            photo = self.inside(f"{start}_final_preview/{name}.tonemap.jpg")
            frames.append(Frame(photo, self.inside(f"{start}_geometry_hdf5/{name}.depth_meters.hdf5")))
        return frames

    def read_target(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        assert frame.target is not None
        distance = read_hdf5(frame.target, "dataset").astype(np.float32)
        known = np.isfinite(distance) & (distance > 0)
        return depth_of_distance(distance, _camera(distance.shape)), known

    def read_camera(self, frame: Frame, size: tuple[int, int]) -> Intrinsics | None:
        return _camera(size)


def _camera(size: tuple[int, ...]) -> Intrinsics:
    """60 degrees from left to right: 886.81 pixels of focal length at a width of 1024."""
    focal = size[1] / 2 / math.tan(math.radians(30))
    return Intrinsics(focal, focal, (size[1] - 1) / 2, (size[0] - 1) / 2)
