"""Points of maps: one for each pixel that has one, with its colour."""

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.outputs import Maps
from zoedepth.outputs.cloud import Cloud, cloud_of, describe_camera, records

SIZE = (6, 8)
CAMERA = Camera.from_focal(10.0, SIZE, source="assumed")
IMAGE = np.arange(144, dtype=np.uint8).reshape(*SIZE, 3)


def test_points_lie_on_the_rays_of_their_pixels() -> None:
    depth = np.full(SIZE, 2, np.float32)
    cloud = cloud_of(Maps(depth=depth, image=IMAGE, camera=CAMERA))
    np.testing.assert_allclose(cloud.points, (CAMERA.rays() * 2).reshape(-1, 3), rtol=1e-6)
    np.testing.assert_array_equal(cloud.colors, IMAGE.reshape(-1, 3))
    np.testing.assert_allclose(cloud.normals, np.tile([0, 0, -1], (48, 1)), atol=1e-6)


def test_pixels_that_are_not_valid_make_no_point() -> None:
    depth = np.full(SIZE, 2, np.float32)
    depth[0, 0], depth[5, 7] = np.nan, 0
    maps = Maps(depth=depth, image=IMAGE, camera=CAMERA)
    cloud = cloud_of(maps)
    assert len(cloud.points) == maps.valid.sum() < 48
    np.testing.assert_array_equal(cloud.colors, IMAGE[maps.valid])
    assert all(np.isfinite(values).all() for values in (cloud.points, cloud.normals))


def test_needs_a_camera_and_a_point() -> None:
    with pytest.raises(InputError, match="'camera'"):
        cloud_of(Maps(depth=np.ones(SIZE, np.float32)))
    with pytest.raises(InputError, match="no pixel"):
        cloud_of(Maps(depth=np.zeros(SIZE, np.float32), camera=CAMERA))
    assert cloud_of(Maps(depth=np.ones(SIZE, np.float32), camera=CAMERA)).colors is None


def test_records_are_columns_by_name() -> None:
    cloud = Cloud(np.float32([[1, 2, 3], [4, 5, 6]]), None, np.float32([[0, 0, -1], [1, 0, 0]]))
    table = records(cloud, {"rgb": "<u4"})
    assert table.dtype.names == ("x", "y", "z", "nx", "ny", "nz", "rgb")
    assert table.dtype.itemsize == 28
    assert (table["y"].tolist(), table["nz"].tolist()) == ([2, 5], [-1, 0])
    assert records(cloud._replace(normals=None), {}).dtype.names == ("x", "y", "z")


def test_camera_in_words() -> None:
    assert describe_camera(CAMERA) == "camera of the photo of 8 x 6 pixels, assumed: fx 10 fy 10 cx 3.5 cy 2.5"
