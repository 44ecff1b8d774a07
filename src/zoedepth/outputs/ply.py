"""The cloud of a photo as a PLY: points with colours and normals."""

from pathlib import Path

from zoedepth.geometry.camera import Camera
from zoedepth.images import OWN_MARK, atomic_path
from zoedepth.outputs.cloud import AXES, Cloud, cloud_of, describe_camera, records
from zoedepth.outputs.output import Maps, Options, Output, Written

_COLORS = ("red", "green", "blue")


def write_ply(path: str | Path, cloud: Cloud, *, camera: Camera | None = None) -> None:
    """Write a cloud as a binary little-endian PLY: x, y, z, nx, ny, nz in float32, and red, green, blue in 8 bits.

    Args:
        path: where to write; missing folders are made.
        cloud: the points; columns that it lacks are left out.
        camera: the camera that saw them, for a comment in the header.
    """
    table = records(cloud, {} if cloud.colors is None else dict.fromkeys(_COLORS, "u1"))
    if cloud.colors is not None:
        for channel, name in enumerate(_COLORS):
            table[name] = cloud.colors[:, channel]
    types = {name: "uchar" if name in _COLORS else "float" for name in table.dtype.names or ()}
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {OWN_MARK}",
        f"comment {AXES}",
        *([] if camera is None else [f"comment {describe_camera(camera)}"]),
        f"element vertex {len(table)}",
        *(f"property {kind} {name}" for name, kind in types.items()),
        "end_header",
    ]
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write("".join(f"{line}\n" for line in header).encode("ascii"))
        file.write(table.data)


def _write(path: Path, maps: Maps, options: Options) -> Written:
    write_ply(path, cloud_of(maps), camera=maps.camera)
    return Written()


PLY = Output(".ply", "points with colours and normals", _write, suffixes=(".ply",))
