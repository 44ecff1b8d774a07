import sys

import numpy as np
import pytest

pytest.importorskip("embreex")

from tests.synthetic.measuring import GRAY

from zoedepth.errors import MissingExtraError
from zoedepth.synthetic import trace
from zoedepth.synthetic.scene import Arrays, Scene
from zoedepth.synthetic.shapes import all_shapes
from zoedepth.synthetic.trace import Tracer


def brute_force(arrays: Arrays, origin: np.ndarray, direction: np.ndarray) -> tuple[float, int]:
    """Return (distance, triangle) of the first triangle that a ray meets, by Cramer's rule for each."""
    a, b, c = arrays.vertices[arrays.triangles].astype(float).transpose(1, 0, 2)
    best = (np.inf, -1)
    for i in range(len(a)):
        matrix = np.stack([b[i] - a[i], c[i] - a[i], -direction], 1)
        if abs(np.linalg.det(matrix)) < 1e-12:
            continue
        u, v, t = np.linalg.solve(matrix, origin - a[i])
        if u >= 0 and v >= 0 and u + v <= 1 and 0 < t < best[0]:
            best = (t, i)
    return best


@pytest.fixture(scope="module")
def arrays() -> Arrays:
    scene = Scene()
    for i, name in enumerate(["box", "cone", "gable", "rod", "hip", "torso", "bowl", "ring"]):
        scene.at(1.5 * (i % 3) - 1.5, 4 + i // 3, 0.2 * i, i).add(
            name, GRAY, (1, 0.8, 1.2), pitch=0.2 * i, roll=0.1 * i
        )
    return scene.arrays((0, 0, 0))


def test_first_hit_is_that_of_a_plain_loop_over_all_triangles(arrays: Arrays) -> None:
    rng = np.random.default_rng(3)
    directions = np.stack([rng.uniform(-0.5, 0.5, 40), np.ones(40), rng.uniform(-0.2, 0.4, 40)], 1).astype(np.float32)
    directions *= rng.uniform(0.5, 2, (40, 1)).astype(np.float32)
    origin = np.array([0.1, 0.2, 0.6], np.float32)
    hits = Tracer(arrays).hits(origin, directions)
    expected = [brute_force(arrays, origin, d) for d in directions.astype(float)]
    assert 8 < (hits.triangle >= 0).sum() < 38  # some meet something, some do not
    for i, (distance, triangle) in enumerate(expected):
        assert hits.distance[i] == pytest.approx(distance, rel=1e-4)
        a, b, c = arrays.vertices[arrays.triangles[triangle]]
        if triangle < 0:
            assert hits.triangle[i] == -1
            continue
        # Two triangles meet at an edge: either is right. The point is on the one that was found.
        a, b, c = arrays.vertices[arrays.triangles[hits.triangle[i]]]
        point = a + hits.first[i] * (b - a) + hits.second[i] * (c - a)
        np.testing.assert_allclose(point, origin + distance * directions[i], atol=1e-4)
        normal = np.cross(b - a, c - a)
        assert abs(normal @ hits.face[i]) == pytest.approx(
            np.linalg.norm(normal) * np.linalg.norm(hits.face[i]), rel=1e-4
        )


def test_blocked_is_true_up_to_the_first_hit_only(arrays: Arrays) -> None:
    directions = np.array([(0, 1, 0), (0.3, 1, 0.1), (-0.3, 1, 0), (0, -1, 0)], np.float32)
    tracer, origin = Tracer(arrays), np.array([0.1, 0.0, 0.5], np.float32)
    first = tracer.hits(origin, directions).distance
    assert np.isfinite(first[:3]).all()
    assert first[3] == np.inf
    far = np.minimum(1.01 * first, 1e6).astype(np.float32)
    given = far.copy()
    assert tracer.blocked(origin, directions, far).tolist() == [True, True, True, False]
    np.testing.assert_array_equal(far, given)  # Embree overwrites what it is given
    assert not tracer.blocked(origin, directions, np.minimum(0.99 * first, 1e6).astype(np.float32)).any()


def test_no_rays_are_no_hits(arrays: Arrays) -> None:
    nothing = np.zeros((0, 3), np.float32)
    assert Tracer(arrays).blocked(nothing, nothing, np.zeros(0, np.float32)).tolist() == []


def test_take_keeps_rays_in_the_order_asked_for(arrays: Arrays) -> None:
    directions = np.array([(0, 1, 0), (0, -1, 0), (0.3, 1, 0.1)], np.float32)
    hits = Tracer(arrays).hits(np.zeros(3, np.float32), directions)
    taken = hits.take(np.array([2, 0]))
    for column, chosen in zip(hits, taken, strict=True):
        np.testing.assert_array_equal(chosen, column[[2, 0]])


@pytest.mark.parametrize("name", sorted(all_shapes()))
def test_closed_and_leafy_shapes_are_met_from_both_sides(name: str) -> None:
    """Rays from either side find the shape inside of its cube, and the same number of triangles' sides are met."""
    scene = Scene()
    scene.at(0, 0).add(name, GRAY, (1, 1, 1))
    tracer = Tracer(scene.arrays((0, 0, 0)))
    grid = np.linspace(-0.47, 0.47, 9)
    x, z = (a.ravel() for a in np.meshgrid(grid, grid))
    ahead = np.broadcast_to(np.array([0, 1, 0], np.float32), (81, 3))
    front, back = (
        tracer.hits(np.stack([x, 0 * x + y, z + 0.5], 1).astype(np.float32), s * ahead) for y, s in ((-3, 1), (3, -1))
    )
    met = front.triangle >= 0
    np.testing.assert_array_equal(met, back.triangle >= 0)
    assert met.any()
    near, far = front.distance[met] - 3, 3 - back.distance[met]
    assert (near > -0.501).all()
    assert (far < 0.501).all()
    assert (near <= far + 1e-3).all()


def test_missing_renderer_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex", None)
    trace._embree.cache_clear()
    with pytest.raises(MissingExtraError, match=r"\[synthetic\]"):
        trace._embree(0)
