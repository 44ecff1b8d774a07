"""The cloud of a photo as a PCD, the format of the Point Cloud Library and of ROS."""

from pathlib import Path

import numpy as np

from zoedepth.geometry.camera import Camera
from zoedepth.images import OWN_MARK, atomic_path
from zoedepth.outputs.cloud import AXES, Cloud, cloud_of, describe_camera, records
from zoedepth.outputs.output import Maps, Options, Output, Written

_NAMES = {"nx": "normal_x", "ny": "normal_y", "nz": "normal_z"}


def write_pcd(path: str | Path, cloud: Cloud, *, camera: Camera | None = None) -> None:
    """Write a cloud as a binary PCD 0.7: x, y, z, normal_x, normal_y, normal_z and rgb, in float32.

    The Point Cloud Library keeps a colour in the bits of a float32: 0x00RRGGBB.

    Args:
        path: where to write; missing folders are made.
        cloud: the points; columns that it lacks are left out.
        camera: the camera that saw them, for a comment in the header.
    """
    table = records(cloud, {} if cloud.colors is None else {"rgb": "<u4"})
    if cloud.colors is not None:
        red, green, blue = (cloud.colors[:, channel].astype(np.uint32) for channel in range(3))
        table["rgb"] = red << 16 | green << 8 | blue
    names = [_NAMES.get(name, name) for name in table.dtype.names or ()]
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        f"# {OWN_MARK}",
        f"# {AXES}",
        *([] if camera is None else [f"# {describe_camera(camera)}"]),
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join('4' for _ in names)}",
        f"TYPE {' '.join('F' for _ in names)}",
        f"COUNT {' '.join('1' for _ in names)}",
        f"WIDTH {len(table)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(table)}",
        "DATA binary",
    ]
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write("".join(f"{line}\n" for line in header).encode("ascii"))
        file.write(table.data)


def _write(path: Path, maps: Maps, options: Options) -> Written:
    write_pcd(path, cloud_of(maps), camera=maps.camera)
    return Written()


PCD = Output(".pcd", "points with colours and normals for PCL and ROS", _write, suffixes=(".pcd",))
