import numpy as np
import pytest

from zoedepth.synthetic.shapes import CARS, FAR, Shape, all_shapes


def areas(shape: Shape) -> np.ndarray:
    a, b, c = shape.vertices[shape.triangles].astype(float).transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def volume(shape: Shape) -> float:
    """Return the volume inside, by Gauss's theorem with the shape's own normals: a normal turned inward counts less."""
    a, b, c = shape.vertices[shape.triangles].astype(float).transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    outward = np.sign((cross * shape.normals.mean(1)).sum(1))
    return float((((a + b + c) / 3 * cross).sum(1) * outward).sum() / 6)


def test_each_fills_the_unit_cube() -> None:
    for name, shape in all_shapes().items():
        np.testing.assert_allclose(shape.vertices.min(0), -0.5, atol=1e-5, err_msg=name)
        np.testing.assert_allclose(shape.vertices.max(0), 0.5, atol=1e-5, err_msg=name)


def test_normals_are_unit_and_near_those_of_their_triangles() -> None:
    for name, shape in all_shapes().items():
        np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=-1), 1, atol=1e-4, err_msg=name)
        a, b, c = shape.vertices[shape.triangles].astype(float).transpose(1, 0, 2)
        cross = np.cross(b - a, c - a)
        area = np.linalg.norm(cross, axis=1)
        large = area > 1e-5  # at a pole of a round box some are slivers
        lean = (shape.normals[large] * (cross[large] / area[large, None])[:, None]).sum(-1)
        assert np.abs(lean).min() > 0.15, name  # creases are at most 80 degrees


@pytest.mark.parametrize(
    ("name", "expected", "tolerance"),
    [
        ("box", 1.0, 1e-6),
        ("sphere", np.pi / 6, 0.06),
        ("cylinder", np.pi / 4, 0.03),
        ("cone", np.pi / 12, 0.03),
        ("frustum", np.pi / 12 * (1 + 0.65 + 0.65**2), 0.04),
        ("gable", 0.5, 1e-6),
        ("wedge", 0.5, 1e-6),
        ("taper", (1 + 0.7 + 0.49) / 3, 1e-5),
    ],
)
def test_volume_is_that_of_the_formula(name: str, expected: float, tolerance: float) -> None:
    """Flat faces inscribed in a round shape hold a few percent less."""
    assert volume(all_shapes()[name]) == pytest.approx(expected, rel=tolerance)


def test_round_boxes_lie_between_the_ball_and_the_box() -> None:
    shapes = all_shapes()
    assert volume(shapes["sphere"]) < volume(shapes["cushion"]) < volume(shapes["soft"]) < volume(shapes["box"])


def test_box_is_flat_and_nothing_round_is() -> None:
    shapes = all_shapes()
    assert shapes["box"].flat
    assert areas(shapes["box"]).sum() == pytest.approx(6)
    for name, shape in shapes.items():
        along_axes = (np.abs(shape.normals) > 0.999).any(-1).all()
        assert not shape.flat or along_axes, name
    assert not shapes["gable"].flat
    assert not shapes["sphere"].flat


def test_sphere_has_radial_normals_smooth_across_edges() -> None:
    sphere = all_shapes()["sphere"]
    points = sphere.vertices[sphere.triangles]
    np.testing.assert_allclose(np.linalg.norm(points, axis=-1), 0.5, atol=0.01)
    assert (sphere.normals * points).sum(-1).min() > 0.5 * 0.95


def test_ring_is_a_wheel_that_rolls_along_x() -> None:
    ring = all_shapes()["ring"]
    away = np.hypot(ring.vertices[:, 0], ring.vertices[:, 2])
    assert away.min() == pytest.approx(0.5 - 0.12, abs=0.005)  # nothing near the axis
    assert away.max() == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("name", CARS)
def test_nose_of_a_car_is_at_positive_x_and_lower_than_its_tail(name: str) -> None:
    body = all_shapes()[f"{name} body"].vertices
    nose, tail = body[body[:, 0] > 0.499], body[body[:, 0] < -0.499]
    assert nose[:, 2].max() < tail[:, 2].max()
    cabin = all_shapes()[f"{name} cabin"].vertices
    assert cabin[cabin[:, 2] > 0.45][:, 0].mean() < 0  # the windscreen slopes, the rear less


@pytest.mark.parametrize(
    ("name", "top"), [("cone", 0.0), ("frustum", 0.65), ("shade", 0.6), ("bowl", 1.0), ("trunk", 0.4), ("pot", 1.0)]
)
def test_outline_is_from_the_bottom_up(name: str, top: float) -> None:
    vertices = all_shapes()[name].vertices
    radius = np.hypot(vertices[:, 0], vertices[:, 1])
    assert radius[vertices[:, 2] > 0.499].max() == pytest.approx(0.5 * top, abs=0.03)


def test_coarse_versions_have_fewer_triangles() -> None:
    shapes = all_shapes()
    coarse = [name for name in shapes if name.endswith(FAR)]
    assert len(coarse) >= 14
    for name in coarse:
        assert len(shapes[name].triangles) < 0.6 * len(shapes[name.removesuffix(FAR)].triangles), name


def test_made_again_they_are_the_same() -> None:
    first = dict(all_shapes())
    all_shapes.cache_clear()
    for name, shape in all_shapes().items():
        for a, b in zip(first[name], shape, strict=True):
            np.testing.assert_array_equal(a, b, err_msg=name)
