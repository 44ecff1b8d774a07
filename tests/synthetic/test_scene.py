import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.synthetic.measuring import GRAY, boxes, corners, turned

from zoedepth.synthetic.scene import Scene
from zoedepth.synthetic.shapes import FAR, all_shapes

METRES = st.floats(-50, 50)
ANGLES = st.floats(-7, 7)
PLACES = st.tuples(METRES, METRES, METRES)
Point = tuple[float, float, float]


@given(first=PLACES, second=PLACES, point=PLACES, one=ANGLES, other=ANGLES)
def test_frames_within_frames_turn_and_shift(
    first: Point, second: Point, point: Point, one: float, other: float
) -> None:
    frame = Scene().at(*first, one).at(*second, other)
    inner = turned(other, 0, 0) @ np.array(point) + second
    expected = turned(one, 0, 0) @ inner + first
    np.testing.assert_allclose(frame.world(*point), expected, atol=1e-9)
    assert frame.yaw == one + other


def test_part_stands_on_its_point() -> None:
    scene = Scene()
    scene.at(1, 2, 3).add("box", GRAY, (0.4, 0.6, 0.8), (0.1, 0.2, 0.3))
    np.testing.assert_allclose(boxes(scene)[0], [(0.9, 1.9, 3.3), (1.3, 2.5, 4.1)])


@given(yaw=ANGLES, pitch=ANGLES, roll=ANGLES)
def test_vertices_are_those_of_each_part_turned_and_placed(yaw: float, pitch: float, roll: float) -> None:
    scene = Scene()
    scene.at(1, 2, 0.5, 0.3).add("cone", GRAY, (1, 2, 3), (0.5, 0, 0), yaw=yaw, pitch=pitch, roll=roll)
    scene.at(-1, 0).add("box", GRAY, (1, 1, 1), yaw=yaw)
    scene.at(-3, 0).add("cone", GRAY, (2, 1, 1), roll=roll)
    arrays = scene.arrays((0, 0, 0))
    # Parts come in the order of their shapes' names: box, cone, cone.
    expected = [corners(scene)[i] for i in (1, 0, 2)]
    np.testing.assert_allclose(arrays.vertices, np.concatenate(expected), atol=1e-5)
    np.testing.assert_allclose(
        arrays.rotation @ arrays.rotation.transpose(0, 2, 1), np.eye(3)[None].repeat(3, 0), atol=1e-5
    )
    np.testing.assert_allclose(arrays.centre, [scene.parts[i][2][:3] for i in (1, 0, 2)], rtol=1e-6)
    np.testing.assert_allclose(arrays.size, [(1, 1, 1), (1, 2, 3), (2, 1, 1)])
    assert arrays.flat.tolist() == [True, False, False]


def test_triangles_belong_to_their_parts_and_corner_normals() -> None:
    scene = Scene()
    for i, name in enumerate(["sphere", "box", "gable", "box", "sphere", "rod"]):
        scene.at(3.0 * i, 0).add(name, GRAY._replace(scale=i + 1.0), (1, 1, 1), pitch=0.3 * i)
    arrays = scene.arrays((0, 0, 0))
    middle = arrays.vertices[arrays.triangles].mean(1)
    nearest = np.linalg.norm(middle[:, None] - arrays.centre, axis=-1).argmin(1)
    np.testing.assert_array_equal(arrays.owner, nearest)
    assert [m.scale for m in arrays.materials] == [
        scene.parts[i][1].scale for i in np.round(arrays.centre[:, 0] / 3).astype(int)
    ]
    a, b, c = arrays.vertices[arrays.triangles].astype(float).transpose(1, 0, 2)
    face = np.cross(b - a, c - a)
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    corner = arrays.corner_normals[arrays.normal_row].mean(1)
    world = (arrays.rotation[arrays.owner] @ corner[..., None])[..., 0]  # all sizes are 1: no stretch
    assert (np.abs((face * world).sum(1)) > 0.85).all()


@given(start=PLACES, end=PLACES, yaw=ANGLES)
def test_rod_goes_from_point_to_point(start, end, yaw: float) -> None:
    length = math.dist(start, end)
    if length < 0.1:
        return
    scene = Scene()
    frame = scene.at(2, -1, 0.5, yaw)
    frame.rod(GRAY, start, end, 0.05, shape="cylinder")
    a, b = np.array(frame.world(*start)), np.array(frame.world(*end))
    points = corners(scene)[0]
    along = (points - a) @ (b - a) / length
    away = np.linalg.norm(points - a - along[:, None] * (b - a) / length, axis=1)
    assert along.min() == pytest.approx(0, abs=1e-4)
    assert along.max() == pytest.approx(length, abs=1e-4)
    assert away.max() == pytest.approx(0.05, abs=1e-4)


def test_parts_far_away_are_coarse_and_tiny_ones_left_out() -> None:
    """The angle is the longest side over the distance beyond ``near``, here 10 m."""
    scene = Scene(near=10)
    expected: dict[int, str] = {}
    for x, (y, name, size, kept) in enumerate([
        (9, "cylinder", 0.2, "cylinder"),  # near: as it is
        (60, "box", 0.2, None),  # 0.2 / 50 is below 0.005
        (60, "box", 0.3, "box"),
        (20, "cylinder", 1.0, "cylinder"),  # 0.1
        (30, "cylinder", 1.0, f"cylinder{FAR}"),  # 0.05 is below 0.07
        (410, "cone", 20.0, "cone"),  # 0.05, but there is no coarse cone
        (12, "sphere", 1.0, "sphere"),  # 0.29
        (18, "sphere", 1.0, f"sphere{FAR}"),  # 0.125 is below 0.2
    ]):  # fmt: skip
        scene.at(x, y).add(name, GRAY, (size, 0.9 * size, 0.8 * size))
        if kept is not None:
            expected[x] = kept
    arrays = scene.arrays((0, 0, 0))
    found = {round(float(x)): int((arrays.owner == i).sum()) for i, x in enumerate(arrays.centre[:, 0])}
    assert found == {x: len(all_shapes()[name].triangles) for x, name in expected.items()}
