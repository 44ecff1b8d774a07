import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.synthetic.measuring import boxes, numbers

from zoedepth.synthetic import room as rooms
from zoedepth.synthetic.furniture import room_style
from zoedepth.synthetic.room import KINDS, Room, build_room
from zoedepth.synthetic.scene import Frame, Scene

SEEDS = range(25)
HALF = st.floats(0.05, 1.5)


@pytest.fixture(scope="module")
def built() -> list[Room]:
    return [build_room(np.random.default_rng(seed)) for seed in SEEDS]


@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(-2, 2), HALF, HALF), max_size=8))
def test_rectangles_that_were_free_are_in_the_room_and_apart(wanted: list[tuple[float, float, float, float]]) -> None:
    room = Room(Scene(), 6.0, 4.0, 2.5, "living", room_style(np.random.default_rng(0)))
    for x, y, half_x, half_y in wanted:
        if room.free(x, y, half_x, half_y):
            room.take(x, y, half_x, half_y)
            assert not room.free(x, y, 0.01, 0.01)
    for i, (x0, y0, x1, y1) in enumerate(room.taken):
        assert -3 <= x0 <= x1 <= 3
        assert -2 <= y0 <= y1 <= 2
        for a0, b0, a1, b1 in room.taken[:i]:
            assert x1 <= a0 or x0 >= a1 or y1 <= b0 or y0 >= b1


def test_rooms_have_the_sizes_of_rooms(built: list[Room]) -> None:
    for room in built:
        assert room.kind in KINDS
        assert 2.5 <= min(room.width, room.depth) <= max(room.width, room.depth) <= 9
        assert 2.25 <= room.height <= 3.5
        bounds = boxes(room.scene)
        np.testing.assert_allclose(
            bounds[0, 1], (room.width / 2 + 0.2, room.depth / 2 + 0.2, 0), atol=1e-6
        )  # the floor
        assert bounds[1, 0, 2] == pytest.approx(room.height)  # the ceiling
    assert len({room.kind for room in built}) > 5
    assert len({numbers(room.scene) for room in built}) == len(built)
    assert numbers(build_room(np.random.default_rng(3)).scene) == numbers(built[3].scene)


def test_everything_is_between_floor_and_ceiling_and_within_the_walls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of open doors and the rooms behind them nothing is built here. Leaves of plants may go through a wall."""
    monkeypatch.setattr(rooms, "doorway", lambda *args: None)
    for seed in range(40):
        room = build_room(np.random.default_rng(seed))
        bounds = boxes(room.scene)[2:]
        leafy = np.array([part[1].pattern == "foliage" for part in room.scene.parts[2:]])
        assert bounds[:, 0, 2].min() > -0.011
        assert bounds[:, 1, 2].max() < room.height + 0.011
        beyond = np.maximum(
            np.abs(bounds[:, :, 0]).max(1) - room.width / 2, np.abs(bounds[:, :, 1]).max(1) - room.depth / 2
        )
        assert beyond[~leafy].max() < 0.2 + 1e-3
        assert (beyond[leafy] < 0.6).all()


def test_rooms_are_closed_by_four_walls(monkeypatch: pytest.MonkeyPatch) -> None:
    walls = []
    monkeypatch.setattr(rooms, "wall_pieces", lambda frame, material, length, *rest: walls.append((frame, length)))
    room = build_room(np.random.default_rng(1))
    assert len(walls) == 4
    for side, (frame, length) in enumerate(walls):
        assert length == pytest.approx(room.depth if side % 2 else room.width)
        out = np.array(frame.world(0, 1, 0)) - frame.world(0, 0, 0)
        inner = np.array((room.width / 2, room.depth / 2, 0))
        np.testing.assert_allclose(np.array((frame.x, frame.y, 0)), out * inner, atol=1e-9)


def test_doors_have_room_before_them_and_every_room_has_light(built: list[Room]) -> None:
    for room in built:
        assert room.scene.lights
        assert all(light.power[0] > 0 for light in room.scene.lights)
        assert 0.02 < room.scene.ambient[2] <= room.scene.ambient[0] < 0.7
        assert room.scene.near == 100  # nothing in a room is coarse


def test_camera_is_in_free_space_where_a_person_could_hold_it(built: list[Room]) -> None:
    blocked = total = 0
    for room in built:
        rng = np.random.default_rng(0)
        for _ in range(20):
            pose = room.draw_pose(rng)
            x, y, z = pose.position
            assert abs(x) <= room.width / 2 - 0.25
            assert abs(y) <= room.depth / 2 - 0.25
            assert 0.6 <= z <= min(2.2, room.height - 0.3)
            assert 40 < math.degrees(pose.field_of_view) < 91
            assert -1.0 < pose.pitch < 1.0
            blocked += not room.free(x, y, 0.12, 0.12)
            total += 1
    assert blocked < 0.05 * total


def test_camera_looks_across_the_room(built: list[Room]) -> None:
    """There is more of the room before it than behind it."""
    ahead = []
    for room in built:
        rng = np.random.default_rng(1)
        for pose in (room.draw_pose(rng) for _ in range(10)):
            direction = np.array((math.cos(pose.yaw), math.sin(pose.yaw)))
            ahead.append(-direction @ np.array(pose.position[:2]))
    assert np.mean(ahead) > 0.2
    assert np.mean(np.array(ahead) > 0) > 0.6


def test_floor_below_furniture_is_in_use(monkeypatch: pytest.MonkeyPatch) -> None:
    placed: list[Frame] = []
    for name in ("shelf", "bed", "sofa"):
        monkeypatch.setattr(rooms.furniture, name, lambda frame, *args: placed.append(frame))
    count = 0
    for seed in SEEDS:
        placed.clear()
        room = build_room(np.random.default_rng(seed))
        count += len(placed)
        assert not [frame for frame in placed if room.free(frame.x, frame.y, 0.05, 0.05)]
    assert count > 20
