import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.normals import estimate_normals

CAMERA = Camera((40, 60), 50.0, 45.0, 28.0, 22.0)


def plane(normal: tuple[float, float, float], distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (the depth of a plane in front of ``CAMERA``, its unit normal towards the camera)."""
    unit = np.array(normal) / np.linalg.norm(normal)
    depth = distance / (CAMERA.rays() @ unit)
    assert (depth > 0).all()
    return depth.astype(np.float32), -unit


@pytest.mark.parametrize("normal", [(0, 0, 1), (0.5, 0, 1), (-0.3, 0.4, 1), (0.0, -1.0, 0.9)])
def test_normals_of_planes_are_exact_up_to_the_border(normal: tuple[float, float, float]) -> None:
    depth, expected = plane(normal, 2.0)
    np.testing.assert_allclose(estimate_normals(depth, CAMERA), np.broadcast_to(expected, (40, 60, 3)), atol=2e-3)


def test_normals_of_a_ball_point_away_from_its_middle() -> None:
    rays, middle, radius = CAMERA.rays().astype(np.float64), np.array([0.1, -0.1, 3.0]), 0.8
    a, b, c = (rays**2).sum(-1), rays @ middle, middle @ middle - radius**2
    root = b**2 - a * c
    hit = root > 0.15  # not at its rim, where a pixel sees much of it
    depth = np.where(hit, (b - np.sqrt(np.maximum(root, 0))) / a, np.nan)
    normals = estimate_normals(depth, CAMERA)
    expected = (rays * depth[..., None] - middle) / radius
    assert hit.sum() > 200
    assert (normals * expected).sum(-1)[hit].min() > 0.99
    assert np.isnan(normals[~hit]).all()


def test_normals_at_a_jump_are_those_of_either_surface() -> None:
    (near, near_normal), (far, far_normal) = plane((0, 0.3, 1), 1.0), plane((0.4, 0, 1), 3.0)
    here = np.zeros(CAMERA.size, bool)
    here[10:30, 20:40] = True
    normals = estimate_normals(np.where(here, near, far), CAMERA)
    np.testing.assert_allclose(normals[here], np.broadcast_to(near_normal, (here.sum(), 3)), atol=3e-3)
    np.testing.assert_allclose(normals[~here], np.broadcast_to(far_normal, ((~here).sum(), 3)), atol=3e-3)


def test_a_pixel_without_neighbours_faces_the_camera() -> None:
    depth = np.full(CAMERA.size, np.nan)
    depth[5, 7] = 2.0
    normal = estimate_normals(depth, CAMERA)[5, 7]
    ray = CAMERA.ray(7, 5)
    np.testing.assert_allclose(np.linalg.norm(normal), 1, rtol=1e-5)
    assert normal @ ray / np.linalg.norm(ray) < -0.85


def test_the_camera_must_be_that_of_the_depth() -> None:
    with pytest.raises(InputError, match="camera"):
        estimate_normals(np.ones((3, 3)), CAMERA)
