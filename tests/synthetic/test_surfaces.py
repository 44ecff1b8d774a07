import math

import numpy as np
import pytest
from numpy.typing import ArrayLike

pytest.importorskip("embreex")

from tests.synthetic.measuring import GRAY

from zoedepth.synthetic import surfaces
from zoedepth.synthetic.scene import Arrays, Material, Scene
from zoedepth.synthetic.surfaces import Met, albedo, cross, dot, linear, material_table, meet, norm, turn
from zoedepth.synthetic.textures import Surface
from zoedepth.synthetic.trace import Tracer


def some_numbers() -> np.random.Generator:
    """Return a generator that draws the same numbers in every test."""
    return np.random.default_rng(5)


def met_along(scene: Scene, origins: ArrayLike, directions: ArrayLike, *, smooth: bool = True) -> tuple[Arrays, Met]:
    arrays = scene.arrays((0, 0, 0))
    starts, rays = np.array(origins, np.float32), np.array(directions, np.float32)
    hits = Tracer(arrays).hits(starts, rays)
    assert (hits.triangle >= 0).all()
    return arrays, meet(arrays, hits, starts, rays, smooth=smooth)


def test_products_are_those_of_numpy() -> None:
    rng = some_numbers()
    a, b, m = rng.normal(size=(7, 3)), rng.normal(size=(7, 3)), rng.normal(size=(7, 3, 3))
    np.testing.assert_allclose(dot(a, b), np.einsum("ij,ij->i", a, b))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b))
    np.testing.assert_allclose(norm(a), np.linalg.norm(a, axis=1))
    np.testing.assert_allclose(turn(m, a), np.einsum("nij,nj->ni", m, a))


def test_linear_is_a_power_of_the_clipped_colour() -> None:
    np.testing.assert_allclose(linear(np.array([-1, 0, 0.5, 1, 2])), [0, 0, 0.5**2.2, 1, 1], rtol=1e-6)


@pytest.mark.parametrize("smooth", [True, False])
def test_normals_point_to_the_viewer_from_either_side(smooth: bool) -> None:
    scene = Scene()
    scene.at(0, 5).add("box", GRAY, (4, 1, 4), (0, 0, -2))
    directions = [(0, 1, 0), (0.1, 2, 0.1), (0, -3, 0)]
    _, met = met_along(scene, [(0, 0, 0), (0, 0, 0), (0, 9, 0)], directions, smooth=smooth)
    np.testing.assert_allclose(met.face, [(0, -1, 0), (0, -1, 0), (0, 1, 0)], atol=1e-6)
    np.testing.assert_allclose(met.normal, met.face, atol=1e-6)
    np.testing.assert_allclose(met.distance, [4.5, 2.25, 3.5 / 3], rtol=1e-6)
    np.testing.assert_allclose(met.point, [(0, 4.5, 0), (0.225, 4.5, 0.225), (0, 5.5, 0)], atol=1e-5)


def test_normals_of_a_stretched_and_turned_ball_are_those_of_the_ellipsoid() -> None:
    scene, size, yaw = Scene(), np.array([1.0, 2.0, 3.0]), 0.7
    scene.at(0, 0, 0, yaw).add("sphere", GRAY, tuple(size.tolist()), (0, 0, -1.5))
    angle = np.linspace(0.3, 6.3, 24)
    origins = np.stack([5 * np.cos(angle), 5 * np.sin(angle), np.sin(3 * angle)], 1)
    _, met = met_along(scene, origins, -origins)
    c, s = math.cos(yaw), math.sin(yaw)
    rotation = np.array([(c, -s, 0), (s, c, 0), (0, 0, 1)])
    gradient = (met.point @ rotation / size**2) @ rotation.T
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(met.normal, axis=1), 1, atol=1e-5)
    assert dot(met.normal, gradient).min() > math.cos(math.radians(8))
    # Smooth normals are nearer to the truth than those of the flat faces.
    assert dot(met.normal, gradient).mean() > dot(met.face, gradient).mean()


def test_table_has_the_materials_in_linear_colours() -> None:
    materials = [Material("plain", (0.5, 0.2, 1.0), (0.1, 0.1, 0.1), 0.4, 0.1, 0.2, 0.3, known=False, grain=True),
                 Material("tiles", (0, 0, 0), world=True), Material("tiles", (0, 0, 0), world=True)]  # fmt: skip
    table = material_table(materials, np.random.default_rng(0))
    np.testing.assert_allclose(table.color[0], np.array((0.5, 0.2, 1.0)) ** 2.2, rtol=1e-5)
    np.testing.assert_allclose(table.mean[0], 0.7 * table.color[0] + 0.3 * 0.1**2.2, rtol=1e-5)
    columns = (table.scale, table.gloss, table.mirror, table.glow)
    np.testing.assert_allclose([column[0] for column in columns], [0.4, 0.1, 0.2, 0.3], rtol=1e-6)
    assert table.known.tolist() == [False, True, True]
    assert table.grain.tolist() == [True, False, False]
    assert table.origin.tolist() == [1, 0, 0]  # the world's pattern starts at the world's origin
    assert table.random[1] == table.random[2]
    assert table.random[0] not in (table.random[1], material_table(materials, np.random.default_rng(1)).random[0])
    assert [surfaces.PATTERNS[k] for k in table.pattern] == ["plain", "tiles", "tiles"]


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[Surface]:
    """Return the surfaces whose colour was asked for."""
    found: list[Surface] = []

    def pattern_albedo(pattern: str, surface: Surface) -> np.ndarray:
        found.append(surface)
        return surface.color

    monkeypatch.setattr(surfaces, "pattern_albedo", pattern_albedo)
    return found


def places(seen: list[Surface], material: Material, origins: list, directions: list) -> Surface:
    scene = Scene()
    scene.at(1, 5, 2, math.pi / 2).add("box", material, (4, 2, 1), (0, 0, 0))  # x 0 to 2, y 3 to 7, z 2 to 3
    arrays, met = met_along(scene, np.array(origins), np.array(directions))
    albedo(arrays, material_table(arrays.materials, some_numbers()), met, np.full(len(origins), 0.01, np.float32))
    return seen.pop()


SIDES = ([(0.3, 0, 2.8), (-5, 6, 2.8), (0.3, 6, 9)], [(0, 1, 0), (1, 0, 0), (0, 0, -1)])
"""Rays to the short side, the long side and the top of the box of ``places``."""


def test_place_on_a_face_is_in_metres_from_the_middle_of_the_part(seen: list[Surface]) -> None:
    found = places(seen, GRAY, *SIDES)
    # Within the part: x (4 m long) is the world's y, y (2 m) the world's -x, z (1 m) is up.
    np.testing.assert_allclose(found.u, [0.7, 1.0, 1.0], atol=1e-5)
    np.testing.assert_allclose(found.v, [0.3, 0.3, 0.7], atol=1e-5)
    np.testing.assert_allclose(found.half_u, [1, 2, 2])
    np.testing.assert_allclose(found.half_v, [0.5, 0.5, 1])


def test_grain_runs_along_the_longer_side(seen: list[Surface]) -> None:
    tall = Material("wood", (0.5, 0.5, 0.5), grain=True)
    scene = Scene()
    scene.at(0, 5).add("box", tall, (1, 1, 3), (0, 0, -1.5))
    arrays, met = met_along(scene, np.zeros((1, 3)), np.array([(0.05, 1, 0.2)]))
    albedo(arrays, material_table(arrays.materials, some_numbers()), met, np.full(1, 0.01, np.float32))
    found = seen.pop()
    np.testing.assert_allclose([found.u[0], found.v[0]], [0.9, 0.225], atol=1e-5)
    np.testing.assert_allclose([found.half_u[0], found.half_v[0]], [1.5, 0.5])
    found = places(seen, tall, *SIDES)  # wider than high: as without
    np.testing.assert_allclose(found.half_u, [1, 2, 2])


def test_pattern_of_the_world_starts_at_its_origin(seen: list[Surface]) -> None:
    found = places(seen, GRAY._replace(world=True), *SIDES)
    np.testing.assert_allclose(np.abs(found.u), [0.3, 6, 6], atol=1e-5)
    np.testing.assert_allclose(np.abs(found.v), [2.8, 2.8, 0.3], atol=1e-5)


def test_each_hit_gets_the_colour_of_its_part() -> None:
    scene = Scene()
    colors = [(0.2, 0.4, 0.6), (0.8, 0.1, 0.3)]
    for x, color in zip((-1, 1), colors, strict=True):
        scene.at(x, 5).add("box", Material("plain", color, mirror=0.2 * (x + 1)), (1, 1, 4), (0, 0, -2))
    arrays, met = met_along(scene, np.zeros((2, 3)), np.array([(0.2, 1, 0), (-0.2, 1, 0)]))
    found, mirror = albedo(arrays, material_table(arrays.materials, some_numbers()), met, np.full(2, 0.01, np.float32))
    expected = linear(np.array(colors[::-1]))
    np.testing.assert_allclose(found, expected, rtol=0.15)  # plain varies from 0.92 to 1.08
    np.testing.assert_allclose(mirror, [0.4, 0], atol=1e-6)
