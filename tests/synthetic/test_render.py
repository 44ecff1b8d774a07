import math

import numpy as np
import pytest

pytest.importorskip("embreex")

from zoedepth.errors import MissingExtraError
from zoedepth.synthetic import trace
from zoedepth.synthetic.pose import Pose, count_parts
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


def test_shapes_fill_the_unit_cube_with_unit_normals() -> None:
    for name, shape in all_shapes().items():
        assert np.abs(shape.vertices).max() == pytest.approx(0.5, abs=1e-5), name
        np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=-1), 1, atol=1e-4, err_msg=name)


def test_pose_inside_a_thing_counts_nothing() -> None:
    scene = Scene()
    scene.at(0, 0).add("box", GRAY, (0.4, 0.4, 0.4), (0, 0, 1.3))
    for i in range(12):
        scene.at(i - 6, 5).add("box", GRAY, (0.8, 1, 4))
    arrays = scene.arrays((0, 0, 1.5))
    inside, outside = (Pose((0, y, 1.5), math.pi / 2, 0, 0, 1.2).view(SIZE) for y in (0, 1))
    tracer = Tracer(arrays)
    assert count_parts(inside, arrays, tracer, nearest=0.45, middle=1) == 0
    assert count_parts(outside, arrays, tracer, nearest=0.45, middle=1) > 3


def test_missing_renderer_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "embreex", None)
    trace._embree.cache_clear()
    with pytest.raises(MissingExtraError, match=r"\[synthetic\]"):
        trace._embree(0)
