import sys

import numpy as np
import pytest

from zoedepth.errors import InputError, MissingExtraError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.mesh import build_mesh, grid_step, join, simplify, vertex_normals
from zoedepth.geometry.points import unproject

SIZE = (48, 64)
CAMERA = Camera(SIZE, 60.0, 55.0, 30.0, 25.0)


def flat(depth: float = 2.0) -> np.ndarray:
    return np.full(SIZE, depth, np.float32)


def step() -> np.ndarray:
    depth = flat(3.0)
    depth[16:32, 20:44] = 1.0
    return depth


def wavy() -> np.ndarray:
    row, column = np.mgrid[: SIZE[0], : SIZE[1]]
    return (2 + 0.1 * np.sin(row / 6) * np.cos(column / 7)).astype(np.float32)


def faces_towards_camera(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, corner]].astype(np.float64) for corner in range(3))
    return (np.cross(b - a, c - a) * a).sum(axis=1) < 0


def edges(faces: np.ndarray) -> set[tuple[int, int]]:
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return set(map(tuple, pairs.tolist()))


def test_a_wall_is_one_surface_of_its_true_size() -> None:
    mesh = build_mesh(flat(), CAMERA)
    assert mesh.faces.shape == (2 * 47 * 63, 3)
    assert mesh.vertices.shape == (48 * 64, 3)
    assert mesh.camera == CAMERA
    width, height, depth = np.ptp(mesh.vertices, axis=0)
    assert width == pytest.approx(63 / 60 * 2, rel=1e-5)
    assert height == pytest.approx(47 / 55 * 2, rel=1e-5)
    assert depth == 0
    np.testing.assert_allclose(mesh.normals, np.broadcast_to([0, 0, -1], mesh.normals.shape), atol=1e-6)


def test_corners_lie_in_the_photo_where_the_camera_sees_them() -> None:
    for mesh in (build_mesh(wavy(), CAMERA), build_mesh(step(), CAMERA)):
        place = CAMERA.project(mesh.vertices.astype(np.float64)) + 0.5
        np.testing.assert_allclose(mesh.uv, place / (64, 48), atol=1e-6)


def test_triangles_are_counterclockwise_for_the_camera() -> None:
    for depth in (flat(), wavy(), step()):
        mesh = build_mesh(depth, CAMERA)
        assert faces_towards_camera(mesh.vertices, mesh.faces).all()
        assert (mesh.normals * mesh.vertices).sum(axis=1).max() < 0


def test_no_triangle_bridges_a_jump() -> None:
    mesh = build_mesh(step(), CAMERA)
    depths = mesh.vertices[:, 2][mesh.faces]
    assert set(np.unique(depths.min(axis=1))) == {1.0, 3.0}
    assert (np.ptp(depths, axis=1) == 0).all()
    inside, outside = 15 * 23, 47 * 63 - 17 * 25  # squares before and behind, without those of the border between
    assert len(mesh.faces) == 2 * (inside + outside) + 4  # at the corners of the near square


def test_pixels_that_are_not_valid_belong_to_no_triangle() -> None:
    valid = np.ones(SIZE, bool)
    valid[10, 12] = False
    mesh = build_mesh(flat(), CAMERA, valid=valid)
    assert len(mesh.vertices) == 48 * 64 - 1
    assert len(mesh.faces) == 2 * 47 * 63 - 4 * 2 + 4  # of the four squares around, one triangle is left each
    unknown = flat()
    unknown[10, 12] = np.nan
    assert np.array_equal(build_mesh(unknown, CAMERA).vertices, mesh.vertices)
    none = build_mesh(flat(), CAMERA, valid=np.zeros(SIZE, bool))
    assert none.vertices.shape == none.normals.shape == none.faces.shape == (0, 3)


def test_flying_pixels_are_left_out_unless_they_are_wanted() -> None:
    columns = np.arange(64) - 31.5
    depth = np.broadcast_to(2 + np.clip(columns / 6, -1, 1), SIZE).astype(np.float32)
    z = build_mesh(depth, CAMERA).vertices[:, 2]
    assert not ((z > 1.2) & (z < 2.8)).any()
    z = build_mesh(depth, CAMERA, valid=np.ones(SIZE, bool)).vertices[:, 2]
    assert ((z > 1.2) & (z < 2.8)).any()


def test_squares_are_cut_along_the_shorter_diagonal() -> None:
    depth = np.array([[1, 1], [1, 1.02]], np.float32)
    gaps = np.zeros((2, 1), bool), np.zeros((1, 2), bool)
    assert (1, 2) in edges(join(depth, np.ones((2, 2), bool), *gaps))
    assert (0, 3) in edges(join(depth[::-1], np.ones((2, 2), bool), *gaps))


@pytest.mark.parametrize("missing", range(4))
def test_three_corners_of_a_square_are_one_triangle(missing: int) -> None:
    taken = np.ones(4, bool)
    taken[missing] = False
    taken = taken.reshape(2, 2)
    across, along = ~(taken[:, :1] & taken[:, 1:]), ~(taken[:1] & taken[1:])
    faces = join(np.where(taken, 1, np.nan), taken, across, along)
    assert {frozenset(face) for face in faces.tolist()} == {frozenset({0, 1, 2, 3} - {missing})}


def test_simplified_meshes_keep_their_shape_and_place() -> None:
    pytest.importorskip("fast_simplification")
    mesh = build_mesh(wavy(), CAMERA)
    fewer = simplify(mesh, 800)
    assert 700 < len(fewer.faces) <= 800
    assert fewer.vertices.dtype == fewer.uv.dtype == fewer.normals.dtype == np.float32
    assert fewer.faces.dtype == np.int32
    np.testing.assert_allclose(np.ptp(fewer.vertices, axis=0), np.ptp(mesh.vertices, axis=0), rtol=0.02)
    assert faces_towards_camera(fewer.vertices, fewer.faces).all()
    np.testing.assert_allclose(np.linalg.norm(fewer.normals, axis=1), 1, rtol=1e-4)
    place = CAMERA.project(fewer.vertices.astype(np.float64))
    np.testing.assert_allclose(fewer.uv, (place + 0.5) / (64, 48), atol=1e-6)
    row, column = np.clip(np.rint(place[:, 1]).astype(int), 0, 47), np.clip(np.rint(place[:, 0]).astype(int), 0, 63)
    assert np.abs(fewer.vertices[:, 2] - wavy()[row, column]).max() < 0.02
    assert simplify(mesh, len(mesh.faces)) is mesh


def test_large_depth_is_taken_at_every_so_many_pixels_first() -> None:
    assert grid_step((3000, 4000), None) == 1
    assert grid_step((3000, 4000), 500_000) == 4
    assert grid_step((3000, 4000), 10**8) == 1
    assert grid_step((40, 4000), 1) == 1  # something is left
    with pytest.raises(InputError, match="at least 1 triangle"):
        grid_step((30, 40), 0)
    pytest.importorskip("fast_simplification")
    size = (200, 300)
    camera = Camera.from_fov(size, horizontal=70)
    depth = np.full(size, 2.0, np.float32)
    mesh = build_mesh(depth, camera, max_triangles=1500)
    assert 1000 < len(mesh.faces) <= 1500
    whole = unproject(depth, camera).reshape(-1, 3)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0)[:2], np.ptp(whole, axis=0)[:2], rtol=0.04)
    place = camera.project(mesh.vertices.astype(np.float64)) + 0.5
    np.testing.assert_allclose(mesh.uv, place / (300, 200), atol=1e-5)


def test_normals_of_vertices_are_the_mean_of_the_triangles_around() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [5, 5, 5]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)  # towards z, and towards x
    normals = vertex_normals(vertices, faces)
    np.testing.assert_allclose(normals[1], [0, 0, 1])
    np.testing.assert_allclose(normals[3], [1, 0, 0])
    np.testing.assert_allclose(normals[0], np.array([1, 0, 1]) / np.sqrt(2), rtol=1e-6)
    assert (normals[4] == 0).all()  # belongs to none


def test_what_cannot_be_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="camera"):
        build_mesh(np.ones((3, 3)), CAMERA)
    with pytest.raises(InputError, match="valid"):
        build_mesh(flat(), CAMERA, valid=np.ones((3, 3), bool))
    mesh = build_mesh(flat(), CAMERA)
    with pytest.raises(InputError, match="at least 1 triangle"):
        simplify(mesh, 0)
    monkeypatch.setitem(sys.modules, "fast_simplification", None)
    with pytest.raises(MissingExtraError, match=r"zoedepth\[mesh\]"):
        simplify(mesh, 10)
