import math

import numpy as np
import pytest

pytest.importorskip("embreex")

from hypothesis import given
from hypothesis import strategies as st
from tests.synthetic.measuring import GRAY

from zoedepth.synthetic.light import (
    Lit,
    bounced_light,
    direct_light,
    incoming,
    offset,
    reflection,
    sky_color,
    unshadowed,
)
from zoedepth.synthetic.scene import Light, Material, Scene, Sky, Sun
from zoedepth.synthetic.surfaces import material_table
from zoedepth.synthetic.trace import Tracer

UP = (0.0, 0.0, 1.0)
SKY = Sky((0.1, 0.2, 0.4), (0.7, 0.8, 0.9), (0.2, 0.15, 0.1), 0.0, 0.0, 0.0)


def lamp(x: float, y: float, z: float, power: float = 1.0, radius: float = 1e-3) -> Light:
    return Light((x, y, z), (power, 2 * power, 3 * power), (radius, 0, 0), (0, radius, 0))


def window(power: float = 1.0) -> Light:
    """A window in the plane y = 0, 2 m wide and 2 m high, that shines along +y."""
    return Light((0, 0, 1), (power, power, power), (1, 0, 0), (0, 0, 1), (0, 1.0, 0))


def rows(points: list, kind: type = np.float32) -> np.ndarray:
    return np.array(points, kind).reshape(-1, 3)


def direct(
    scene: Scene, points: list, normals: list | None = None, views: list | None = None, draw: tuple = (0.5, 0.5, 0.0)
) -> Lit:
    """Return the light at points that look up, seen from above, with one draw for all of them."""
    if not scene.parts:
        scene.at(40, 40, -40).add("box", GRAY, (1, 1, 1))
    n = len(points)
    return direct_light(
        scene, Tracer(scene.arrays((0, 0, 0))), rows(points), rows(normals or [UP] * n),
        rows(views or [(0, 0, -1)] * n), np.zeros(n, np.int32), rows([draw]),
    )  # fmt: skip


@given(st.floats(0.5, 20), st.floats(-5, 5), st.floats(0.1, 5))
def test_lamp_falls_off_with_the_square_and_the_cosine(height: float, x: float, power: float) -> None:
    lit = direct(Scene(lights=[lamp(x, 0, height, power)]), [(0, 0, 0)])
    distance = math.hypot(height, x)
    expected = power / distance**2 * height / distance
    np.testing.assert_allclose(
        lit.diffuse[0], np.array((1, 2, 3)) * (expected if expected * distance / height > 1e-4 else 0), rtol=1e-3
    )


def test_lamp_below_a_surface_does_not_light_it() -> None:
    assert (direct(Scene(lights=[lamp(0, 0, -1)]), [(0, 0, 0)]).diffuse == 0).all()


def test_window_shines_into_the_room_only() -> None:
    scene, normals = Scene(lights=[window()]), [(0.0, -1.0, 0.0), (0.0, 1.0, 0.0)]
    lit = direct(scene, [(0, 2, 1), (0, -2, 1)], normals).diffuse
    np.testing.assert_allclose(lit[0], 1 / 4, rtol=1e-3)
    assert (lit[1] == 0).all()
    aside = direct(Scene(lights=[window()]), [(2, 2, 1)], [(0.0, -1.0, 0.0)]).diffuse
    np.testing.assert_allclose(aside[0], 1 / 8 * 0.5, rtol=1e-3)  # both cosines are those of 45 degrees


@pytest.mark.parametrize(("draw", "x", "z"), [((0, 0, 0), -1, 0), ((0.999999, 0.5, 0), 1, 1), ((0.5, 0.75, 0), 0, 1.5)])
def test_draws_choose_the_place_on_a_window(draw: tuple, x: float, z: float) -> None:
    """A wall with a slit lets the light of one place through, and of no other."""
    lit = direct(Scene(lights=[window()]), [(0, 2, 1)], [(0.0, -1.0, 0.0)], draw=draw).diffuse[0, 0]
    distance = math.sqrt(x * x + 4 + (z - 1) ** 2)
    assert lit == pytest.approx(4 / distance**4, rel=1e-3)


def test_third_number_chooses_among_the_weaker_lamps_and_makes_up_for_the_others() -> None:
    scene = Scene(lights=[lamp(0, 0, 2, 0.1), lamp(0, 0, 2, 5.0), lamp(0, 0, 2, 0.3), lamp(0, 0, 2, 0.2)])
    found = [float(direct(scene, [(0, 0, 0)], draw=(0.5, 0.5, k)).diffuse[0, 0]) for k in (0.0, 0.4, 0.99)]
    np.testing.assert_allclose(found, [(5 + 3 * weak) / 4 for weak in (0.3, 0.2, 0.1)], rtol=1e-3)


def test_shadow_is_behind_a_thing_and_nowhere_else() -> None:
    scene = Scene(lights=[lamp(0, 0, 4)])
    scene.at(0, 0).add("box", GRAY, (1, 1, 0.1), (0, 0, 2))  # its shadow on the ground is 2 m wide, or slightly more
    lit = direct(scene, [(x, 0, 0) for x in (0, 0.9, -0.9, 1.2, -1.2, 3)]).diffuse[:, 0]
    np.testing.assert_array_equal(lit > 0, [False, False, False, True, True, True])
    above = direct(scene, [(0, 0, 2.2)]).diffuse[0, 0]
    assert above == pytest.approx(1 / 1.8**2, rel=1e-3)


def test_shade_of_a_lamp_does_not_hide_its_own_light() -> None:
    scene = Scene(lights=[lamp(0, 0, 2, radius=0.2)])
    scene.at(0, 0).add("sphere", GRAY, (0.4, 0.4, 0.4), (0, 0, 1.8))
    assert direct(scene, [(0, 0, 0)]).diffuse[0, 0] == pytest.approx(1 / 4, rel=1e-3)


def test_sun_is_parallel_and_shadowed() -> None:
    towards = (0.6, 0.0, 0.8)
    scene = Scene(sun=Sun(towards, (3.0, 2.0, 1.0), 0.0))
    scene.at(0, 0).add("box", GRAY, (1, 1, 2))
    lit = direct(scene, [(5, 0, 0), (-1, 0, 0), (-3, 0, 0), (0, 0, 2.01)]).diffuse
    expected = np.array((3, 2, 1)) * 0.8
    np.testing.assert_allclose(lit, np.array([expected, 0 * expected, expected, expected]), rtol=1e-5)
    assert (direct(scene, [(5, 0, 0)], [(-0.8, 0.0, 0.6)]).diffuse < 1e-6).all()  # it only grazes
    np.testing.assert_allclose(direct(scene, [(5, 0, 0)], [towards]).diffuse[0], (3, 2, 1), rtol=1e-5)


def test_spread_of_the_sun_blurs_its_shadows() -> None:
    towards = (0.6, 0.0, 0.8)
    scene = Scene(sun=Sun(towards, (3.0, 3.0, 3.0), 0.1))
    scene.at(0, 0).add("box", GRAY, (1, 10, 2))
    draws = [(a, b, 0.0) for a in (0.05, 0.5, 0.95) for b in (0.05, 0.5, 0.95)]

    def share(x: float) -> float:
        return float(np.mean([direct(scene, [(x, 0, 0)], draw=draw).diffuse[0, 0] > 0 for draw in draws]))

    assert share(-1.5) == 0  # the shadow's edge is at -2.0
    assert 0 < share(-1.95) < 1
    assert share(-2.5) == 1


def test_sun_falls_through_the_window_onto_its_patch() -> None:
    """The window reaches from x = -1 to 1 and z = 0 to 2 at y = 0; the sun is behind it at 45 degrees."""
    towards = (0.0, -math.sqrt(0.5), math.sqrt(0.5))
    scene = Scene(sun=Sun(towards, (2.0, 2.0, 2.0), 0.0), sunlit=[window()])
    lit = direct(scene, [(0, 1, 0), (0.9, 1.9, 0), (1.1, 1, 0), (0, 2.2, 0), (0, -1, 0)]).diffuse[:, 0]
    np.testing.assert_allclose(lit, [math.sqrt(2), math.sqrt(2), 0, 0, 0], rtol=1e-5)
    scene.at(0, 0.5).add("box", GRAY, (0.4, 0.1, 1))  # on the way, inside
    scene.parts.pop(0)
    assert direct(scene, [(0, 1, 0)]).diffuse[0, 0] == 0


def test_highlight_is_where_a_mirror_would_show_the_lamp() -> None:
    scene, root = Scene(lights=[lamp(1, 0, 1)]), math.sqrt(0.5)
    views = [(root, 0.0, -root), (-root, 0.0, -root), (0.0, 0.0, -1.0)]  # from the left, from the lamp, from above
    found = direct(scene, [(0, 0, 0)] * 3, views=views).highlight[:, 0]
    assert found[0] == pytest.approx(3 * 0.5, rel=1e-3)
    assert found[1] == pytest.approx(3 * 0.5 * math.cos(math.pi / 4) ** 32, rel=0.02)
    assert found[2] == pytest.approx(3 * 0.5 * math.cos(math.pi / 8) ** 32, rel=0.02)


def test_unshadowed_is_direct_light_without_shadows() -> None:
    scene = Scene(lights=[lamp(0.5, 0, 3, 2.0), window(0.7)], sun=Sun((0, 0, 1.0), (1, 1, 1), 0.0))
    points = [(0, 1, 0), (2, 3, 0), (-1, 2, 0.5)]
    expected = sum(direct(Scene(lights=[light]), points).diffuse for light in scene.lights) + 1
    np.testing.assert_allclose(unshadowed(scene, rows(points), rows([UP] * 3)), expected, rtol=1e-3)
    scene.sunlit.append(window())  # under a roof the sun does not count
    np.testing.assert_allclose(unshadowed(scene, rows(points), rows([UP] * 3)), expected - 1, rtol=1e-3)


def test_four_lamps_stand_for_many() -> None:
    scene = Scene(lights=[lamp(0, 0, 2, 1.0) for _ in range(10)])
    found = unshadowed(scene, rows([(0, 0, 0)]), rows([UP]))
    np.testing.assert_allclose(found[0], np.array((1, 2, 3)) * 10 / 4, rtol=1e-5)


def box_of_light(size: float = 4.0) -> Scene:
    """Six gray walls, lit by the ambient light alone."""
    scene = Scene(ambient=(0.5, 0.4, 0.3))
    scene.at(0, 0).add(
        "box", Material("plain", (0.8, 0.8, 0.8), (0.8, 0.8, 0.8)), (size, size, size), (0, 0, -size / 2)
    )
    return scene


def test_bounced_light_is_the_colour_of_what_is_around() -> None:
    scene = box_of_light()
    arrays = scene.arrays((0, 0, 0))
    table, n = material_table(arrays.materials, np.random.default_rng(0)), 64
    draws = np.random.default_rng(1).random((n, 3)).astype(np.float32)
    normals = rows([UP, (1, 0, 0), (0, -1, 0), (0, 0, -1)] * 16)
    points = rows([(0, 0, -1.9)] * n)
    light = bounced_light(scene, arrays, table, Tracer(arrays), points, normals, draws)
    limit = 0.8**2.2 * np.array(scene.ambient)
    assert (light < limit).all()  # what is near is in the shade
    assert light[normals[:, 2] > 0].mean(0) == pytest.approx(0.93 * limit, rel=0.06)
    # Rays leave to the side of the normal: those downwards from 10 cm above the floor see little.
    assert light[normals[:, 2] < 0].mean() < 0.6 * light[normals[:, 2] > 0].mean()


def test_bounced_rays_follow_the_cosine() -> None:
    """Under a sky of one colour above and another below, the share of light from the top half is known."""
    sky = Sky((1, 1, 1), (1, 1, 1), (0, 0, 0), 0, 0, 0)
    scene = Scene(sky=sky)
    scene.at(40, 40, -40).add("box", GRAY, (1, 1, 1))
    arrays = scene.arrays((0, 0, 0))
    table, line = material_table(arrays.materials, np.random.default_rng(0)), (np.arange(40) + 0.5) / 40
    draws = np.stack([a.ravel() for a in np.meshgrid(line, line)] + [np.zeros(1600)], 1).astype(np.float32)
    for normal, expected in (
        (UP, 1.0),
        ((0, 0, -1), 0.0),
        ((1, 0, 0), 0.5),
        ((0.6, 0, 0.8), 0.9),
        ((0.6, 0, -0.8), 0.1),
    ):
        normals, points = rows([normal] * 1600), rows([(0, 0, 0)] * 1600)
        light = bounced_light(scene, arrays, table, Tracer(arrays), points, normals, draws)
        assert light.mean() == pytest.approx(expected, abs=0.01)  # (1 + cos) / 2 of the tilt


def test_rays_into_the_open_bring_the_sky() -> None:
    scene = box_of_light(1.0)
    scene.sky = SKY
    arrays = scene.arrays((0, 0, 0))
    table = material_table(arrays.materials, np.random.default_rng(0))
    directions = rows([(0, 1, 0.2), (0, -1, 0)])
    light = incoming(scene, arrays, table, Tracer(arrays), rows([(0, 3, 0)] * 2), directions)
    np.testing.assert_allclose(light[0], sky_color(SKY, directions[:1])[0])
    np.testing.assert_allclose(light[1], 0.8**2.2 * np.array(scene.ambient) * 2.5 / 2.75, rtol=1e-4)
    image = reflection(scene, arrays, table, Tracer(arrays), rows([(0, 3, 0)] * 2), directions, 100.0)
    np.testing.assert_allclose(image[0], sky_color(SKY, directions[:1])[0])
    np.testing.assert_allclose(image[1], 1.3 * 0.8**2.2 * np.array(scene.ambient), rtol=0.09)


def test_sky_goes_from_horizon_to_zenith_and_ground() -> None:
    directions = rows([(0, 0, 3), (5, 0, 0), (1, 0, 1), (0, 2, -0.1)])
    found = sky_color(SKY, directions)
    np.testing.assert_allclose(found[[0, 1, 3]], [SKY.zenith, SKY.horizon, SKY.ground], rtol=1e-6)
    share = math.sqrt(0.5) ** 0.6
    np.testing.assert_allclose(found[2], (1 - share) * np.array(SKY.horizon) + share * np.array(SKY.zenith), rtol=1e-5)
    np.testing.assert_allclose(sky_color(SKY, 7 * directions), found, rtol=1e-5)


def test_clouds_cover_the_upper_sky_as_much_as_asked_for() -> None:
    turn = np.linspace(0, 6.2, 400)
    up = np.stack([np.cos(turn), np.sin(turn), np.linspace(0.2, 2, 400)], 1).astype(np.float32)
    clear = sky_color(SKY, up)
    changed = [np.abs(sky_color(SKY._replace(clouds=c, seed=0.3), up) - clear).max(1) for c in (0.1, 0.5, 1.0)]
    shares = [(change > 0.05).mean() for change in changed]
    assert shares[0] < shares[1] < shares[2]
    assert shares[2] > 0.8
    overcast = SKY._replace(clouds=1.0)
    np.testing.assert_array_equal(sky_color(overcast, up, clouds=False), clear)
    down = up * (1, 1, -1)
    np.testing.assert_array_equal(sky_color(overcast, down.astype(np.float32)), sky_color(SKY, down.astype(np.float32)))


def test_offset_leaves_the_surface_by_more_the_farther_from_the_origin() -> None:
    points, faces = rows([(0, 0, 0), (300, -5, 2)]), rows([UP, (1, 0, 0)])
    moved = offset(points, faces) - points
    np.testing.assert_allclose(moved, [(0, 0, 1e-4), (3.1e-3, 0, 0)], rtol=0.02, atol=1e-6)
