import math

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.mesh import simplify
from zoedepth.geometry.panorama import (
    View,
    build_panorama_mesh,
    cut_out,
    directions,
    flying_in_panorama,
    merge,
    panorama_normals,
    panorama_points,
    panorama_views,
    resized,
    sharp_height,
    spread,
    turn,
)

SIZE = (64, 128)
HALF = np.array([3.0, 1.4, 2.0])
"""Metres from the camera to the walls of a room, right and left, down and up, ahead and behind."""


def room(rays: np.ndarray) -> np.ndarray:
    """Return the distance of the walls along unit rays."""
    return (HALF / np.maximum(np.abs(rays), 1e-9)).min(axis=-1).astype(np.float32)


def room_depth(view: View) -> np.ndarray:
    """Return the depth of the walls in a view, along its axis."""
    rays = view.camera.rays()
    length = np.linalg.norm(rays, axis=-1)
    return (room(rays / length[..., None] @ view.rotation.T) / length).astype(np.float32)


def test_directions_are_those_of_opencv() -> None:
    rays = directions((180, 360))
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, rtol=1e-6)
    near = {"ahead": (90, 180, (0, 0, 1)), "right": (90, 270, (1, 0, 0)), "below": (179, 7, (0, 1, 0))}
    for row, column, expected in near.values():
        np.testing.assert_allclose(rays[row, column], expected, atol=0.02)


def test_turns_look_up_and_to_the_right() -> None:
    for above, around in ((0.0, 0.0), (0.4, 0.0), (0.0, 1.2), (-0.7, 2.9), (math.pi / 2, 0.0)):
        rotation = turn(above, around)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
        ahead = (math.cos(above) * math.sin(around), -math.sin(above), math.cos(above) * math.cos(around))
        np.testing.assert_allclose(rotation[:, 2], ahead, atol=1e-12)
        assert rotation[1, 0] == pytest.approx(0)  # level


def test_views_see_everything() -> None:
    views = panorama_views((48, 64))
    count = np.zeros(SIZE[0] * SIZE[1], int)
    best = np.zeros(SIZE[0] * SIZE[1])
    for view in views:
        place, values, weight = spread(np.ones(view.camera.size, np.float32), view, SIZE)
        assert len(set(place.tolist())) == len(place)
        np.testing.assert_allclose(values, 1)
        count[place] += 1
        best[place] = np.maximum(best[place], weight)
    assert count.min() >= 1
    assert best.min() > 0.1  # no place is at the border of all its views
    assert count.mean() > 2.5


def test_cut_out_shows_what_lies_in_the_direction() -> None:
    rays = directions((256, 512))
    panorama = ((rays + 1) * 127).astype(np.uint8)  # its colour says its direction
    for view in panorama_views((30, 40)):
        seen = cut_out(panorama, view) / 127 - 1
        expected = view.camera.rays() @ view.rotation.T
        expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
        assert np.abs(seen - expected).max() < 0.03
    assert sharp_height(view) == round(math.pi * view.camera.fx)


def test_resized_panoramas_have_no_border_at_their_sides() -> None:
    wave = np.cos(np.linspace(0, 2 * math.pi, 128, endpoint=False) + 0.4)
    panorama = np.broadcast_to(wave, SIZE).astype(np.float32)
    small = resized(panorama, (16, 32))
    expected = wave.reshape(32, 4).mean(axis=1)
    np.testing.assert_allclose(small, np.broadcast_to(expected, (16, 32)), atol=0.02)
    large = resized(small, SIZE)
    assert np.abs(large - panorama).max() < 0.05
    assert resized(panorama, SIZE) is panorama
    colours = np.zeros((*SIZE, 3), np.uint8)
    assert resized(colours, (10, 20)).shape == (10, 20, 3)


def test_views_of_different_scales_merge_to_the_truth() -> None:
    views = panorama_views((60, 80))
    scales = np.exp(np.random.default_rng(0).normal(0, 0.02, len(views)))
    truth = room(directions(SIZE))
    depths = [room_depth(view) * np.float32(scale) for view, scale in zip(views, scales, strict=True)]
    merged = merge(depths, views, SIZE)
    apart = merged.distance / truth
    assert np.abs(apart / np.median(apart) - 1).mean() < 0.007  # not the 2 % of the views any more
    assert abs(np.median(apart) - 1) < 0.01
    assert np.corrcoef(np.log(merged.scales), np.log(scales))[0, 1] < -0.95
    assert merged.disagreement < 0.006
    unscaled = merge([room_depth(view) for view in views], views, SIZE)
    np.testing.assert_allclose(unscaled.scales, 1, atol=2e-3)
    np.testing.assert_allclose(unscaled.distance, truth, rtol=0.03)


def test_merging_keeps_the_mean_distance_of_the_views() -> None:
    views = panorama_views((30, 40))
    depths = [room_depth(view) * np.float32(2.5) for view in views]
    ratio = merge(depths, views, SIZE).distance / room(directions(SIZE))
    assert np.median(ratio) == pytest.approx(2.5, rel=5e-3)


def test_one_wrong_view_is_outvoted() -> None:
    views = panorama_views((30, 40))
    depths = [room_depth(view) for view in views]
    depths[3] = depths[3] * 3
    truth = room(directions(SIZE))
    merged = merge(depths, views, SIZE)
    assert merged.scales[3] < 0.55
    assert np.abs(merged.distance / truth - 1).mean() < 0.15


def test_merge_refuses_what_leaves_gaps() -> None:
    views = panorama_views((30, 40))
    depths = [room_depth(view) for view in views]
    with pytest.raises(InputError, match="see all of it"):
        merge(depths[:8], views[:8], SIZE)
    with pytest.raises(InputError, match="above 0"):
        merge([depths[0] * 0, *depths[1:]], views, SIZE)
    with pytest.raises(InputError, match="shape"):
        merge([depths[0][1:], *depths[1:]], views, SIZE)


def test_points_lie_on_the_walls() -> None:
    points = panorama_points(room(directions(SIZE)))
    np.testing.assert_allclose((np.abs(points) / HALF).max(axis=-1), 1, rtol=1e-5)
    distance = np.full(SIZE, 2.0)
    distance[3, 4] = np.nan
    assert np.isnan(panorama_points(distance)[3, 4]).all()


def test_normals_are_those_of_the_walls_across_the_border_too() -> None:
    normals = panorama_normals(room(directions((128, 256))))
    points = panorama_points(room(directions((128, 256))))
    flat = np.sort(np.abs(points) / HALF, axis=-1)[..., 1] < 0.9  # not at an edge of the room
    wall = (np.abs(points) / HALF).argmax(axis=-1)
    expected = -np.eye(3)[wall] * np.sign(points)
    assert (normals * expected).sum(-1)[flat].min() > 0.999
    assert flat[:, [0, -1]].any()


def pillar(size: tuple[int, int] = (128, 256), around: float = math.pi) -> np.ndarray:
    """Return the distance of a ball of 4 m around the camera, and of a round pillar 1.5 m away in one direction."""
    rays = directions(size)
    level = np.arctan2(rays[..., 0], rays[..., 2])
    apart = np.abs((level - around + math.pi) % (2 * math.pi) - math.pi)
    return np.where(apart < 0.3, np.minimum(1.5 / np.hypot(rays[..., 0], rays[..., 2]), 4), 4).astype(np.float32)


def test_nothing_flies_in_a_room_or_at_a_sharp_border() -> None:
    assert not flying_in_panorama(room(directions((128, 256)))).any()
    assert flying_in_panorama(pillar()).mean() < 0.01


def test_flying_pixels_are_found_across_the_border_of_the_photo() -> None:
    small = pillar((32, 64))
    behind = resized(small, (128, 256))  # smeared, and at the left and right border of the photo
    flying = flying_in_panorama(behind)
    ahead = flying_in_panorama(np.roll(behind, 128, axis=1))
    middle = np.s_[40:90]
    assert np.array_equal(np.roll(ahead, -128, axis=1)[middle], flying[middle])
    assert flying[middle].mean() > 0.01


@pytest.mark.parametrize("max_triangles", [None, 3000])
def test_the_mesh_of_a_room_is_closed_and_of_its_true_size(max_triangles: int | None) -> None:
    trimesh = pytest.importorskip("trimesh")
    if max_triangles:
        pytest.importorskip("fast_simplification")
    mesh = build_panorama_mesh(room(directions(SIZE)), max_triangles=max_triangles)
    assert mesh.camera is None
    assert len(mesh.faces) == (max_triangles or 2 * 64 * 128)
    merged = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    assert merged.is_watertight
    assert -merged.volume == pytest.approx(8 * HALF.prod(), rel=0.02)  # it is seen from inside
    np.testing.assert_allclose(np.abs(mesh.vertices).max(axis=0), HALF, rtol=0.01)
    with pytest.raises(InputError, match="max_triangles"):
        simplify(mesh, 10)


def test_corners_lie_in_the_photo_in_their_direction() -> None:
    mesh = build_panorama_mesh(room(directions(SIZE)))
    longitude, latitude = (mesh.uv[:, 0] - 0.5) * 2 * math.pi, (0.5 - mesh.uv[:, 1]) * math.pi
    level = np.cos(latitude)
    rays = np.stack([level * np.sin(longitude), -np.sin(latitude), level * np.cos(longitude)], axis=1)
    expected = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    assert np.abs(rays - expected).max() < 1e-5
    corners = mesh.uv[mesh.faces][..., 0]
    assert np.ptp(corners, axis=1).max() < 2 / 128  # no triangle runs back through the whole photo
    assert mesh.uv[:, 0].max() <= 1 + 1 / 128
    assert mesh.uv[:, 1].min() == 0
    assert mesh.uv[:, 1].max() == 1


def test_no_triangle_of_a_panorama_bridges_a_jump() -> None:
    mesh = build_panorama_mesh(pillar())
    away = np.linalg.norm(mesh.vertices, axis=1)[mesh.faces]
    assert (np.ptp(away, axis=1) < 0.3).mean() > 0.999
    assert {True, False} == set((away.min(axis=1) > 3.9).tolist())


def test_valid_leaves_pixels_out_of_the_mesh() -> None:
    valid = np.ones(SIZE, bool)
    valid[:10] = False
    mesh = build_panorama_mesh(room(directions(SIZE)), valid=valid)
    assert mesh.uv[:, 1].min() > 10 / 64
    with pytest.raises(InputError, match="valid"):
        build_panorama_mesh(room(directions(SIZE)), valid=valid[1:])


def test_other_shapes_are_no_panoramas() -> None:
    flat = np.ones((50, 80), np.float32)
    view = View(Camera.from_fov((10, 10), horizontal=90), np.eye(3))
    for refused in (
        lambda: build_panorama_mesh(flat),
        lambda: panorama_points(flat),
        lambda: panorama_normals(flat),
        lambda: flying_in_panorama(flat),
        lambda: resized(flat, (10, 20)),
        lambda: cut_out(np.zeros((50, 80, 3), np.uint8), view),
        lambda: merge([], [], (50, 80)),
    ):
        with pytest.raises(InputError, match=r"twice as wide as high.*80 x 50"):
            refused()
