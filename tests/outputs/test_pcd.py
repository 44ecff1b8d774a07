"""PCD, read by pypcd4."""

from pathlib import Path

import numpy as np
import pytest

from zoedepth.outputs import Options
from zoedepth.outputs.cloud import Cloud
from zoedepth.outputs.pcd import PCD, write_pcd

PointCloud = pytest.importorskip("pypcd4").PointCloud


def test_room_has_its_true_size_and_is_not_mirrored(tmp_path: Path) -> None:
    pytest.importorskip("embreex")
    from tests.outputs.room import assert_true, rendered_room

    PCD.write(tmp_path / "room.pcd", rendered_room(), Options())
    found = PointCloud.from_path(tmp_path / "room.pcd")
    points = found.numpy(("x", "y", "z"))
    assert_true(points, PointCloud.decode_rgb(found.numpy(("rgb",))))
    normals = found.numpy(("normal_x", "normal_y", "normal_z"))
    assert ((normals * points).sum(axis=1) < 0).all()  # towards the camera
    assert found.metadata.viewpoint == (0, 0, 0, 1, 0, 0, 0)


def test_colours_are_packed_as_the_library_of_the_format_does(tmp_path: Path) -> None:
    """Red in the third byte, green in the second, blue in the first of a float32's bits."""
    write_pcd(tmp_path / "a.pcd", Cloud(np.float32([[1, 2, 3]]), np.uint8([[10, 20, 30]])))
    header, _, content = (tmp_path / "a.pcd").read_bytes().partition(b"DATA binary\n")
    assert b"FIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\n" in header
    assert content == np.array([1, 2, 3], "<f4").tobytes() + bytes([30, 20, 10, 0])


def test_columns_that_a_cloud_lacks_are_left_out(tmp_path: Path) -> None:
    write_pcd(tmp_path / "folder" / "a.pcd", Cloud(np.float32([[1, 2, 3], [4, 5, 6]])))
    found = PointCloud.from_path(tmp_path / "folder" / "a.pcd")
    assert found.fields == ("x", "y", "z")
    assert found.numpy().tolist() == [[1, 2, 3], [4, 5, 6]]
