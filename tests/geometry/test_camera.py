"""Cropping, resizing and mirroring a photo, with its camera, commute with projection."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zoedepth.geometry.camera import Intrinsics, depth_of_distance

CAMERA = Intrinsics(fx=500.0, fy=520.0, cx=310.5, cy=247.0)
OFFSETS = st.floats(-200, 200)
FACTORS = st.floats(0.1, 10)
POINTS = st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(0.1, 80))


def project(camera: Intrinsics, point: tuple[float, float, float]) -> np.ndarray:
    """Column and row at which a camera sees a point (x right, y down, z forward, metres)."""
    x, y, z = point
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


@given(point=POINTS, top=OFFSETS, left=OFFSETS)
def test_a_window_sees_the_point_at_its_own_rows_and_columns(
    point: tuple[float, float, float], top: float, left: float
) -> None:
    expected = project(CAMERA, point) - (left, top)
    np.testing.assert_allclose(project(CAMERA.cropped(top, left), point), expected, atol=1e-6)


@given(point=POINTS, vertical=FACTORS, horizontal=FACTORS)
def test_resizing_scales_distances_from_the_corner_of_the_photo(
    point: tuple[float, float, float], vertical: float, horizontal: float
) -> None:
    """The corner is half a pixel outside the centre of the first pixel."""
    expected = (project(CAMERA, point) + 0.5) * (horizontal, vertical) - 0.5
    np.testing.assert_allclose(project(CAMERA.scaled(vertical, horizontal), point), expected, rtol=1e-9, atol=1e-6)


@given(point=POINTS, width=st.integers(1, 5000))
def test_the_mirrored_photo_shows_the_mirrored_point(point: tuple[float, float, float], width: int) -> None:
    x, y, z = point
    column, row = project(CAMERA, point)
    np.testing.assert_allclose(project(CAMERA.mirrored(width), (-x, y, z)), (width - 1 - column, row), atol=1e-6)


@given(top=OFFSETS, left=OFFSETS, vertical=FACTORS, horizontal=FACTORS)
def test_the_order_of_cropping_and_resizing_does_not_matter(
    top: float, left: float, vertical: float, horizontal: float
) -> None:
    one = CAMERA.cropped(top, left).scaled(vertical, horizontal)
    other = CAMERA.scaled(vertical, horizontal).cropped(top * vertical, left * horizontal)
    np.testing.assert_allclose(list(vars(one).values()), list(vars(other).values()), rtol=1e-9, atol=1e-6)


def test_the_middle_of_the_photo_stays_the_middle() -> None:
    middle = Intrinsics(fx=500.0, fy=500.0, cx=(640 - 1) / 2, cy=(480 - 1) / 2)
    assert middle.mirrored(640) == middle
    half = middle.scaled(0.5, 0.5)
    assert (half.fx, half.cx, half.cy) == (250, (320 - 1) / 2, (240 - 1) / 2)


def test_rays_are_what_each_pixel_sees() -> None:
    rays = CAMERA.rays((3, 4))
    assert rays.shape == (3, 4, 3)
    assert rays.dtype == np.float32
    assert (rays[..., 2] == 1).all()
    for row in range(3):
        for column in range(4):
            np.testing.assert_allclose(project(CAMERA, tuple(7 * rays[row, column])), (column, row), atol=1e-3)


@pytest.mark.parametrize("size", [(1, 1), (30, 40)])
def test_depth_of_a_wall_is_the_same_everywhere_though_its_corners_are_farther(size: tuple[int, int]) -> None:
    camera = Intrinsics(fx=20.0, fy=20.0, cx=(size[1] - 1) / 2, cy=(size[0] - 1) / 2)
    wall = 3 * camera.rays(size)
    depth = depth_of_distance(np.linalg.norm(wall, axis=-1).astype(np.float32), camera)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, 3, rtol=1e-5)
