import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import known_depth, unproject

CAMERA = Camera((4, 6), 5.0, 4.0, 2.0, 1.5)


def test_points_are_those_of_the_rays() -> None:
    depth = np.random.default_rng(0).uniform(1, 9, CAMERA.size).astype(np.float32)
    points = unproject(depth, CAMERA)
    for row in range(4):
        for column in range(6):
            expected = CAMERA.ray(column, row) * depth[row, column]
            np.testing.assert_allclose(points[row, column], expected, rtol=1e-6)
    places = CAMERA.project(points.astype(np.float64))
    np.testing.assert_allclose(places[..., 0], np.tile(np.arange(6), (4, 1)), atol=1e-5)
    np.testing.assert_allclose(places[..., 1], np.tile(np.arange(4)[:, None], (1, 6)), atol=1e-5)


def test_axes_are_those_of_opencv() -> None:
    points = unproject(np.ones(CAMERA.size, np.float32), CAMERA)
    assert points[0, -1, 0] > points[0, 0, 0]  # x to the right
    assert points[-1, 0, 1] > points[0, 0, 1]  # y down
    assert (points[..., 2] == 1).all()  # z forward


@pytest.mark.parametrize("nothing", [0.0, -1.0, np.nan, np.inf])
def test_no_depth_is_no_point(nothing: float) -> None:
    depth = np.ones(CAMERA.size, np.float64)
    depth[1, 2] = nothing
    points = unproject(depth, CAMERA)
    assert points.dtype == np.float32
    assert np.isnan(points[1, 2]).all()
    assert np.isfinite(points).all(axis=-1).sum() == known_depth(depth).sum() == depth.size - 1


def test_the_camera_must_be_that_of_the_depth() -> None:
    with pytest.raises(InputError, match=r"\(6, 4\).*\(4, 6\).*resized"):
        unproject(np.ones((6, 4), np.float32), CAMERA)
