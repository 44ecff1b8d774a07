import math

import numpy as np
import pytest

pytest.importorskip("embreex")

from zoedepth.synthetic.pose import Pose
from zoedepth.synthetic.render import Rendering, View, render
from zoedepth.synthetic.scene import Light, Material, Scene, Sky, Sun
from zoedepth.synthetic.shapes import all_shapes
from zoedepth.synthetic.textures import PATTERNS
from zoedepth.synthetic.trace import Tracer

GRAY = Material("plain", (0.5, 0.5, 0.5))
SIZE = (60, 80)
POSE = Pose((1.0, -2.0, 1.5), yaw=1.9, pitch=-0.2, roll=0.1, field_of_view=1.2)


def picture(scene: Scene, view: View, seed: int = 0) -> Rendering:
    arrays = scene.arrays(tuple(view.position.tolist()))
    return render(scene, arrays, Tracer(arrays), view, np.random.default_rng(seed))


def test_depth_of_a_plane_is_that_of_the_formula() -> None:
    scene = Scene()
    scene.at(0, 0).add("box", GRAY, (400, 400, 1), (0, 0, -1))  # the top is z = 0
    view = POSE.view(SIZE, (1.5, -0.7))
    depth = picture(scene, view).depth
    rays = view.camera.rays(SIZE) @ view.rotation.T
    expected = -view.position[2] / rays[..., 2]
    below = (rays[..., 2] < 0) & (expected < 150)
    assert below.mean() > 0.5
    np.testing.assert_allclose(depth[below], expected[below], rtol=1e-4)
    assert (depth[rays[..., 2] > 0] == 0).all()


def test_depth_times_rays_lies_on_a_sphere() -> None:
    scene = Scene()
    scene.at(-1.0, 4.0, 0, 0.4).add("sphere", GRAY, (3, 3, 3))
    view = Pose((-1.0, -2.0, 1.5), yaw=math.pi / 2, pitch=0.0, roll=0.3, field_of_view=1.0).view(SIZE)
    depth = picture(scene, view).depth
    points = (view.camera.rays(SIZE) * depth[..., None])[depth > 0] @ view.rotation.T + view.position
    radius = np.linalg.norm(points - (-1.0, 4.0, 1.5), axis=1)
    assert len(points) > 300
    assert radius.max() < 1.5 * 1.02
    assert radius.min() > 1.5 * 0.93  # chords of a ball of flat faces


def test_camera_axes_are_those_of_the_world() -> None:
    """Ahead, to the right and above: each cube is found in its place of the picture."""
    scene = Scene()
    for x, y, z in ((0, 10, 0), (3, 10, 0), (0, 10, 3)):
        scene.at(x, y).add("box", GRAY, (1, 1, 1), (0, 0, z - 0.5))
    view = Pose((0, 0, 0), yaw=math.pi / 2, pitch=0, roll=0, field_of_view=math.pi / 2).view((81, 81))
    seen = picture(scene, view).depth > 0
    assert seen[40, 40]
    assert seen[40, 52]
    assert seen[27, 40]
    assert not seen[40, 28]
    assert not seen[52, 40]


def test_view_without_depth_is_unknown() -> None:
    scene = Scene()
    scene.at(0, 5).add("box", Material("view", (1, 1, 1), known=False), (50, 1, 50), (0, 0, -25))
    assert (picture(scene, Pose((0, 0, 0), math.pi / 2, 0, 0, 1).view(SIZE)).depth == 0).all()


def test_shadow_falls_away_from_the_sun() -> None:
    scene = Scene(sun=Sun((0.6, 0.0, 0.8), (3, 3, 3), 0.001))
    scene.at(0, 0).add("box", GRAY, (100, 100, 1), (0, 0, -1))
    scene.at(0, 0).add("box", GRAY, (1, 1, 3), (0, 0, 0))
    view = Pose((0, 0, 12), yaw=math.pi / 2, pitch=-math.pi / 2 + 1e-4, roll=0, field_of_view=1.0).view((81, 81))
    color = picture(scene, view).color.mean(-1)
    assert color[40, 40 - 10] < 0.6 * color[40, 40 + 10]


def test_every_pattern_and_shape_renders_without_nan() -> None:
    scene = Scene(sky=Sky((0.2, 0.4, 0.8), (0.9, 0.9, 0.9), (0.2, 0.2, 0.2), 0.5, 300, 1))
    scene.lights.append(Light((0, 0, 20), (200, 200, 200), (1, 0, 0), (0, 1, 0)))
    names = list(all_shapes())
    for i, pattern in enumerate(PATTERNS * 2):
        material = Material(pattern, (0.6, 0.3, 0.2), (0.1, 0.5, 0.8), 0.3, 0.2, 0.2, 0.1, grain=i % 2 == 0)
        scene.at(i % 8 - 4, i // 8 + 2).add(names[i % len(names)], material, (0.8, 0.8, 0.8), pitch=0.2, roll=0.3)
    result = picture(scene, Pose((0, -3, 2.5), math.pi / 2, -0.3, 0, 1.2).view(SIZE))
    assert np.isfinite(result.color).all()
    assert (result.color >= 0).all()
    assert np.isfinite(result.depth).all()


def flat_ground(**options: object) -> Scene:
    scene = Scene(**options)
    scene.at(0, 0).add("box", Material("plain", (0.5, 0.5, 0.5)), (100, 100, 1), (0, 0, -1))
    return scene


def from_above(height: float = 12, size: tuple[int, int] = (41, 41)) -> View:
    return Pose((0, 0, height), yaw=math.pi / 2, pitch=-math.pi / 2 + 1e-4, roll=0, field_of_view=1.0).view(size)


def test_light_of_a_lamp_falls_off_with_the_square() -> None:
    near, far = (
        picture(flat_ground(ambient=(0, 0, 0), lights=[Light((0, 0, z), (9, 9, 9), (1e-3, 0, 0), (0, 1e-3, 0))]),
                from_above(4.0)).color[18:23, 18:23].mean()
        for z in (6.0, 12.0)
    )  # fmt: skip
    assert near / far == pytest.approx(4, rel=0.03)


def test_brightness_of_a_lit_surface_is_that_of_the_formula() -> None:
    """The sun's irradiance times the colour, and a quarter of the ambient light; nothing bounces in the open."""
    scene = flat_ground(ambient=(0.2, 0.2, 0.2), sun=Sun((0.0, 0.6, 0.8), (2.0, 1.0, 0.5), 0.0))
    color = picture(scene, from_above()).color.mean((0, 1))
    np.testing.assert_allclose(color, 0.5**2.2 * (0.8 * np.array((2, 1, 0.5)) + 0.05), rtol=0.04)


def test_glowing_surface_shines_in_the_dark() -> None:
    scene = Scene(ambient=(0, 0, 0))
    scene.at(0, 5).add("box", Material("plain", (0.5, 0.2, 0.1), glow=2.0), (50, 1, 50), (0, 0, -25))
    color = picture(scene, Pose((0, 0, 0), math.pi / 2, 0, 0, 1).view(SIZE)).color.mean((0, 1))
    np.testing.assert_allclose(color, 2 * np.array((0.5, 0.2, 0.1)) ** 2.2, rtol=0.06)


def test_mirror_shows_what_is_behind_the_camera_and_has_its_own_depth() -> None:
    scene = Scene(ambient=(0.5, 0.5, 0.5), sky=Sky((0, 0, 0), (0, 0, 0), (0, 0, 0), 0, 0, 0))
    scene.at(0, 5).add("box", Material("plain", (0, 0, 0), mirror=1.0), (50, 1, 50), (0, 0, -25))
    scene.at(0, -5).add("box", Material("plain", (0.9, 0.1, 0.1)), (4, 1, 4), (1, 0, -2))
    result = picture(scene, Pose((0, 0, 0), math.pi / 2, 0, 0, 1).view((41, 41)))
    np.testing.assert_allclose(result.depth, 4.5, rtol=1e-4)
    red = result.color[20, :, 0]
    shown = np.flatnonzero(red > 0.1)
    # The image is 4.5 + 4.5 + 4 = 13.5 m away, from x = -1 to 3; a pixel is tan(0.5) / 20.5 wide.
    pixel = math.tan(0.5) / 20.5
    assert shown[0] == pytest.approx(20 - 1 / 13.5 / pixel, abs=1.1)
    assert shown[-1] == pytest.approx(20 + 3 / 13.5 / pixel, abs=1.1)


def test_haze_takes_its_share_at_its_distance() -> None:
    sky = Sky((0, 0, 0), (0.8, 0.9, 1.0), (0, 0, 0), 0, 20.0, 0)
    scene = Scene(ambient=(0, 0, 0), sky=sky)
    scene.at(0, 20.5).add("box", Material("plain", (0, 0, 0)), (90, 1, 90), (0, 0, -45))
    color = picture(scene, Pose((0, 0, 0), math.pi / 2, 0, 0, 0.2).view((33, 33))).color.mean((0, 1))
    np.testing.assert_allclose(color, (1 - math.exp(-1)) * np.array(sky.horizon), rtol=0.02)


def test_edges_are_smooth_and_depth_is_not() -> None:
    """A pixel on an edge mixes both sides; its depth is that of one of them."""
    scene = Scene(ambient=(0, 0, 0))
    scene.at(-50, 5).add("box", Material("plain", (0.9, 0.9, 0.9), glow=1.0), (100, 1, 50), (0, 0, -25))
    scene.at(0, 30).add("box", Material("plain", (0, 0, 0)), (100, 1, 90), (0, 0, -45))
    result = picture(scene, Pose((0, 0, 0), math.pi / 2, 0, 0.1, 1).view(SIZE))
    color, bright = result.color[..., 0], result.color.max()
    mixed = (color > 0.2 * bright) & (color < 0.8 * bright)
    assert 30 < mixed.sum() < 130
    assert (mixed.sum(1) <= 3).all()
    assert (
        np.isclose(result.depth, 4.5, rtol=1e-4).sum() + np.isclose(result.depth, 29.5, rtol=1e-4).sum()
        == result.depth.size
    )


def test_ground_beside_a_wall_takes_its_colour() -> None:
    scene = flat_ground(ambient=(0, 0, 0), sun=Sun((0.0, -0.6, 0.8), (3.0, 3.0, 3.0), 0.0))
    scene.at(0, 3).add("box", Material("plain", (0.9, 0.1, 0.1), (0.9, 0.1, 0.1)), (40, 1, 20))
    view = Pose((0, -1, 8), math.pi / 2, -math.pi / 2 + 1e-4, 0, 1.0).view((41, 41))
    color = picture(scene, view).color
    redness = color[..., 0] / color[..., 2]
    ground = picture(scene, view).depth > 7.9
    assert redness[ground].max() > 1.1
    assert redness[40].mean() < redness[ground].max()


def test_same_generator_gives_the_same_bits() -> None:
    scene = flat_ground(sun=Sun((0.0, 0.6, 0.8), (2.0, 1.0, 0.5), 0.1))
    first, again, other = (picture(scene, from_above(), seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.color, again.color)
    assert (first.color != other.color).any()
    np.testing.assert_array_equal(first.depth, other.depth)


def test_rays_of_every_nth_pixel_are_spread_over_the_picture() -> None:
    view = POSE.view((48, 64))
    every, some = view.rays().reshape(48, 64, 3), view.rays(4).reshape(12, 16, 3)
    expected = every.reshape(12, 4, 16, 4, 3).mean((1, 3))
    np.testing.assert_allclose(some, expected, atol=1e-5)
