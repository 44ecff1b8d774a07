import math

import numpy as np
import pytest

pytest.importorskip("embreex")

from hypothesis import given
from hypothesis import strategies as st
from tests.synthetic.measuring import GRAY, pose

from zoedepth.synthetic.pose import Pose, count_parts
from zoedepth.synthetic.render import View
from zoedepth.synthetic.scene import Scene
from zoedepth.synthetic.trace import Tracer

SIZE = (48, 64)


def project(view: View, point: tuple[float, float, float]) -> tuple[float, float]:
    """Return the (column, row) at which a point of the world is seen."""
    x, y, z = view.rotation.T.astype(float) @ (np.array(point) - view.position)
    assert z > 0
    return view.camera.fx * x / z + view.camera.cx, view.camera.fy * y / z + view.camera.cy


@given(yaw=st.floats(-3, 3), pitch=st.floats(-1.4, 1.4), roll=st.floats(-1, 1))
def test_axes_are_right_down_and_ahead(yaw: float, pitch: float, roll: float) -> None:
    rotation = Pose((0, 0, 0), yaw, pitch, roll, 1.0).view(SIZE).rotation
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-6)
    assert np.linalg.det(rotation) == pytest.approx(1, abs=1e-5)
    ahead = (math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), math.sin(pitch))
    np.testing.assert_allclose(rotation[:, 2], ahead, atol=1e-6)
    # Rolled to the right: its right side goes down, by the sine of the roll, and its own down leaves the vertical.
    assert rotation[2, 0] == pytest.approx(-math.sin(roll) * math.cos(pitch), abs=1e-6)
    assert rotation[2, 1] == pytest.approx(-math.cos(roll) * math.cos(pitch), abs=1e-6)


def test_middle_edge_and_shift_of_the_picture() -> None:
    view = Pose((1, 2, 3), math.pi / 2, 0, 0, math.pi / 2).view(SIZE)
    assert project(view, (1, 12, 3)) == pytest.approx((31.5, 23.5))
    assert project(view, (11, 12, 3))[0] == pytest.approx(63.5)  # 45 degrees to the right: the border of the last pixel
    assert project(view, (1, 12, 4))[1] < 23.5  # what is higher is farther up
    moved = Pose((1, 2, 3), math.pi / 2, 0, 0, math.pi / 2).view(SIZE, (4.0, -2.0))
    assert project(moved, (1, 12, 3)) == pytest.approx((35.5, 21.5))


def scene_of_posts(*, wall: float = 5) -> Scene:
    scene = Scene()
    for i in range(12):
        scene.at(i - 6, wall).add("box", GRAY, (0.8, 1, 4))
    return scene


def count(scene: Scene, place: Pose, *, nearest: float = 0.45, middle: float = 1.0) -> int:
    arrays = scene.arrays(place.position)
    return count_parts(place.view(SIZE), arrays, Tracer(arrays), nearest=nearest, middle=middle)


def test_parts_in_sight_are_counted() -> None:
    posts = count(scene_of_posts(), pose(0, 0, 1.5))
    assert posts in (4, 5, 6)  # a width of 4.5 m at 4.5 m away
    behind = scene_of_posts()
    behind.at(0, -5).add("box", GRAY, (1, 1, 1))
    assert count(behind, pose(0, 0, 1.5)) == posts


def test_inside_of_a_thing_nothing_is_counted() -> None:
    scene = scene_of_posts()
    scene.at(0, 0).add("box", GRAY, (0.4, 0.4, 0.4), (0, 0, 1.3))
    assert count(scene, pose(0, 0, 1.5)) == 0
    assert count(scene, pose(0, 1, 1.5)) > 3


def test_too_near_or_too_close_a_view_is_not_worth_taking() -> None:
    scene = scene_of_posts()
    assert count(scene, pose(0, 0, 1.5), middle=4.0) > 0
    assert count(scene, pose(0, 0, 1.5), middle=5.0) == 0  # the posts start at 4.5 m
    assert count(scene, pose(0, 0, 1.5), nearest=4.6) == 0


def test_sky_or_a_single_surface_is_not_worth_taking() -> None:
    assert count(scene_of_posts(), Pose((0, 0, 1.5), math.pi / 2, 1.0, 0, 0.9)) == 0
    scene = scene_of_posts(wall=9)
    assert count(scene, pose(0, 0, 1.5)) > 0
    scene.at(0, 4).add("box", GRAY, (2.8, 0.1, 9))  # covers 70 % of the width
    assert count(scene, pose(0, 0, 1.5)) == 0
