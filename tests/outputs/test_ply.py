"""PLY, read by plyfile."""

from pathlib import Path

import numpy as np
import pytest

from zoedepth.geometry.camera import Camera
from zoedepth.outputs import Options
from zoedepth.outputs.cloud import Cloud
from zoedepth.outputs.ply import PLY, write_ply

PlyData = pytest.importorskip("plyfile").PlyData


def test_room_has_its_true_size_and_is_not_mirrored(tmp_path: Path) -> None:
    pytest.importorskip("embreex")
    from tests.outputs.room import assert_true, rendered_room

    PLY.write(tmp_path / "room.ply", rendered_room(), Options())
    found = PlyData.read(tmp_path / "room.ply")
    assert (found.text, found.byte_order) == (False, "<")
    vertex = found["vertex"]
    points = np.stack([vertex[name] for name in "xyz"], axis=1)
    assert_true(points, np.stack([vertex[name] for name in ("red", "green", "blue")], axis=1))
    normals = np.stack([vertex[f"n{name}"] for name in "xyz"], axis=1)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    assert ((normals * points).sum(axis=1) < 0).all()  # towards the camera
    assert any("y down" in comment for comment in found.comments)


def test_columns_that_a_cloud_lacks_are_left_out(tmp_path: Path) -> None:
    points = np.float32([[1, 2, 3], [4, 5, 6]])
    camera = Camera.from_focal(10.0, (6, 8), source="exif")
    write_ply(tmp_path / "folder" / "a.ply", Cloud(points), camera=camera)
    found = PlyData.read(tmp_path / "folder" / "a.ply")
    assert [element.name for element in found["vertex"].properties] == ["x", "y", "z"]
    assert [tuple(row) for row in found["vertex"].data] == [(1, 2, 3), (4, 5, 6)]
    assert any("8 x 6 pixels, exif" in comment for comment in found.comments)
