import math

import numpy as np
import pytest
from tests.synthetic.measuring import GRAY, boxes, built, extent

from zoedepth.synthetic.furniture import room_style
from zoedepth.synthetic.interior import THICK, Opening, doorway, hang_on_wall, radiator, wall_pieces, window
from zoedepth.synthetic.palette import Material
from zoedepth.synthetic.scene import Scene

SEEDS = range(40)
WINDOW = Opening(-0.5, 0.9, 0.9, 2.2, "window")


def test_wall_fills_all_but_its_openings() -> None:
    door, hatch = Opening(1.4, 2.2, 0, 2.05, "door"), Opening(-1.0, 0.4, 0.9, 2.2, "window")
    scene = built(
        lambda frame, rng: wall_pieces(frame, GRAY, 5.0, 2.5, [hatch, door], Material("wood", (0.5, 0.4, 0.3))), 0
    )
    bounds = boxes(scene)
    pieces = bounds[[i for i, part in enumerate(scene.parts) if part[1] == GRAY]]
    boards = bounds[[i for i, part in enumerate(scene.parts) if part[1] != GRAY]]
    assert (pieces[:, 0, 1] == 0).all()
    np.testing.assert_allclose(pieces[:, 1, 1], THICK)
    x, z = (a.ravel() for a in np.meshgrid(np.arange(-2.49, 2.5, 0.07), np.arange(0.01, 2.5, 0.07)))
    solid = ((pieces[:, 0, ::2, None] < (x, z)) & ((x, z) < pieces[:, 1, ::2, None])).all(1).sum(0)
    in_hole = [(x > o.left) & (x < o.right) & (z > o.bottom) & (z < o.top) for o in (hatch, door)]
    np.testing.assert_array_equal(solid, ~(in_hole[0] | in_hole[1]))  # one piece thick, never two
    # Skirting boards run along the floor on the inner side, below windows, but not before doors.
    assert (boards[:, 0, 2] == 0).all()
    assert boards[:, 1, 1].max() <= 1e-9
    np.testing.assert_allclose(boards[:, :, 0], [(-2.5, 1.34), (2.26, 2.5)])


def test_windows_fit_into_their_wall() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        opening = Opening.window(rng, -1.0, 1.3, 2.4)
        assert -1 < opening.right <= 0.3 + 1e-9
        assert 0 < opening.bottom < opening.top <= 2.25
        assert opening.top - opening.bottom > 0.9


def test_window_has_a_pane_without_depth_and_lights_the_room() -> None:
    clear = 0
    for seed in SEEDS:
        scene = Scene()
        frame = scene.at(1, 2, 0, math.pi / 2)  # out of the room is the world's -x
        window(frame, np.random.default_rng(seed), WINDOW, 2.5)
        (light,) = scene.lights
        assert light.facing == pytest.approx((1, 0, 0))
        np.testing.assert_allclose(light.half_u, (0, 0.7, 0), atol=1e-9)
        assert light.half_v == (0, 0, pytest.approx(0.65))
        assert light.centre == pytest.approx((0.96, 2.2, 1.55))
        pane = scene.parts[0]
        size = boxes(scene)[0]
        np.testing.assert_allclose(size[1] - size[0], (0.01, 1.4, 1.3), atol=1e-9)
        assert pane[1].known == (pane[1].pattern != "view")
        assert (scene.sunlit == [light]) == (not pane[1].known)
        clear += not pane[1].known
        low, high = extent(scene)
        assert low[2] > -0.01
        assert high[2] < 2.5
        assert sum(light.power) > 0
    assert 20 < clear < 38


def test_curtains_take_light_away() -> None:
    def powers(shape: str) -> list[float]:
        found = []
        for seed in range(150):
            scene = built(lambda frame, rng: window(frame, rng, WINDOW, 2.5), seed)
            if any(part[0].startswith(shape) for part in scene.parts):
                pane = scene.parts[0][1]
                bright = pane.glow / (0.5 if pane.known else 0.7)
                found.append(scene.lights[0].power[2] / (0.32 * bright * 1.4 * 1.3))
        return found

    curtains = powers("curtain") + powers("folds")
    assert len(curtains) > 30
    np.testing.assert_allclose(curtains, 0.8)
    shares = powers("box")
    assert min(shares) < 0.6
    assert max(shares) == pytest.approx(1)


@pytest.mark.parametrize("kind", ["door", "doorway"])
def test_door_fills_its_opening_and_an_open_one_shows_the_next_room(kind: str) -> None:
    opening = Opening(0.2, 1.1, 0, 2.05, kind)
    for seed in SEEDS:
        scene = built(lambda frame, rng: doorway(frame, rng, opening, room_style(rng), GRAY), seed)
        low, high = extent(scene)
        assert low[1] > -0.06  # the frame stands out by 3 cm, a handle by a little more
        assert low[2] >= (-0.2 if kind == "doorway" else 0) - 1e-6
        if kind == "door":
            assert high[1] < 0.25
            leaf = boxes(scene)[3]
            np.testing.assert_allclose(leaf[:, 0], (0.2, 1.1), atol=1e-6)
            np.testing.assert_allclose(leaf[:, 2], (0, 2.05), atol=1e-6)
        else:
            assert 1.3 < high[1] < 5
            assert len(scene.lights) <= 1
            assert all(light.centre[1] > THICK for light in scene.lights)


def test_radiator_hangs_below_its_window() -> None:
    low, high = extent(built(lambda frame, rng: radiator(frame, rng, WINDOW), 0))
    assert high[2] < WINDOW.bottom - 0.1
    assert low[2] > 0.1
    assert -0.11 < low[1] < high[1] < 0
    assert WINDOW.left - 0.01 <= low[0]
    assert high[0] <= WINDOW.right + 0.03


def test_pictures_hang_on_the_wall_clear_of_openings() -> None:
    hung = 0
    for seed in SEEDS:
        scene = built(lambda frame, rng: hang_on_wall(frame, rng, 5.0, 2.5, [WINDOW], room_style(rng)), seed)
        if not scene.parts:
            continue
        bounds = boxes(scene)
        hung += len(bounds)
        assert (bounds[:, 0, 0] > -2.5).all()
        assert (bounds[:, 1, 0] < 2.6).all()
        assert (bounds[:, 0, 2] > 0.8).all()
        assert (bounds[:, 1, 2] < 2.5).all()
        assert bounds[:, 1, 1].max() < 0.1  # things on a small shelf may reach into the wall
        thin = (bounds[:, 1, 1] - bounds[:, 0, 1]) < 0.05
        clear = (bounds[:, 1, 0] < WINDOW.left - 0.05) | (bounds[:, 0, 0] > WINDOW.right + 0.05)
        assert clear[thin].all()
    assert hung > 40
