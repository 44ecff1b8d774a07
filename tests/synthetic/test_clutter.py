import numpy as np
import pytest
from tests.synthetic.measuring import boxes, built, extent, loose, numbers

from zoedepth.synthetic import clutter
from zoedepth.synthetic.clutter import book_pile, book_row, computer, plant, scatter, shelf_content, thing

SEEDS = range(60)


@pytest.mark.parametrize("radius", [0.06, 0.15])
def test_thing_stands_on_its_place_and_about_fits_its_circle(radius: float) -> None:
    firsts = set()
    for seed in SEEDS:
        scene = built(lambda frame, rng: thing(frame, rng, radius), seed)
        low, high = extent(scene)
        assert -0.002 < low[2] < 0.002
        assert max(np.abs(low[:2]).max(), high[:2].max()) < max(1.3 * radius, 0.18)  # books are as large as books
        assert 0.01 < high[2] < max(5 * radius, 0.33)
        assert not loose(scene, gap=0.02)
        firsts.add(scene.parts[0][0])
    assert firsts == {"vase", "bottle", "bowl", "cup", "box", "sphere", "pot", "jar"}


def test_scattered_things_keep_apart_and_on_the_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    places = []
    monkeypatch.setattr(clutter, "thing", lambda frame, rng, radius: places.append((frame.x, frame.y, frame.z, radius)))
    counts = []
    for seed in SEEDS:
        places.clear()
        built(lambda frame, rng: scatter(frame.at(0, 0, 0.7), rng, 1.0, 0.5, 6), seed)
        counts.append(len(places))
        x, y, z, radius = np.array(places).T
        assert (z == 0.7).all()
        assert (np.abs(x) + radius <= 0.5).all()
        assert (np.abs(y) + radius <= 0.25).all()
        for i in range(len(x)):
            others = np.arange(len(x)) != i
            assert (np.hypot(x - x[i], y - y[i])[others] > (radius + radius[i])[others]).all()
    assert min(counts) >= 2
    assert max(counts) <= 6
    places.clear()
    built(lambda frame, rng: scatter(frame, rng, 0.08, 0.5, 6), 0)  # too narrow
    assert not places


def test_piled_books_lie_on_each_other() -> None:
    bounds = boxes(built(lambda frame, rng: book_pile(frame, rng, 7), 3))
    assert len(bounds) == 7
    assert bounds[0, 0, 2] == pytest.approx(0)
    np.testing.assert_allclose(bounds[1:, 0, 2], bounds[:-1, 1, 2], atol=1e-9)
    assert ((bounds[:, 1] - bounds[:, 0])[:, 2] < 0.06).all()


def test_books_stand_side_by_side_from_the_left_in_front_of_the_back() -> None:
    for seed in SEEDS:
        bounds = boxes(built(lambda frame, rng: book_row(frame, rng, 0.8, 0.3, 0.25), seed))
        assert bounds[0, 0, 0] == pytest.approx(-0.4, abs=0.01)
        assert (bounds[:, 1, 0] < 0.4).all()
        assert (np.diff(bounds[:, :, 0].mean(1)) > 0.01).all()
        assert (bounds[1:, 0, 0] - bounds[:-1, 1, 0] > -0.04).all()  # a leaning one may touch its neighbour
        assert (bounds[:, 1, 1] <= -0.009).all()
        assert (bounds[:, 0, 1] > -0.25).all()
        assert (bounds[:, 1, 2] < 0.3).all()
        assert (np.abs(bounds[:, 0, 2]) < 0.01).all()


def test_content_of_a_compartment_stays_within_it() -> None:
    counts = []
    for seed in SEEDS:
        scene = built(lambda frame, rng: shelf_content(frame, rng, 0.8, 0.3, 0.3), seed)
        counts.append(len(scene.parts))
        if scene.parts:
            low, high = extent(scene)
            assert low[0] > -0.42
            assert high[0] < 0.42
            assert -0.34 < low[1] < high[1] < 0.03
            assert -0.005 < low[2] < 0.005
            assert high[2] < 0.42
    assert 0 < sum(count == 0 for count in counts) < 15


def test_screen_stands_behind_the_keyboard_and_looks_at_the_user() -> None:
    for seed in SEEDS:
        scene = built(computer, seed)
        low, high = extent(scene)
        assert -0.001 < low[2] < 0.001
        assert 0.2 < high[2] < 0.57
        bounds = boxes(scene)
        if len(scene.parts) == 6:  # a monitor: its picture is before its case
            case, picture, keyboard = bounds[2], bounds[3], bounds[4]
            assert picture[0, 1] < case[0, 1]
            assert keyboard[1, 1] < picture[0, 1]
        assert not loose(scene, gap=0.02) or len(scene.parts) == 6


def test_plant_is_about_as_high_as_asked_for() -> None:
    for seed in SEEDS:
        for height in (0.7, 1.9):
            low, high = extent(built(lambda frame, rng, height=height: plant(frame, rng, height), seed))
            assert low[2] == pytest.approx(0, abs=1e-3)
            assert 0.7 * height < high[2] < 1.2 * height


def test_seed_decides() -> None:
    scenes = [numbers(built(lambda frame, rng: thing(frame, rng, 0.1), seed)) for seed in (1, 1, 2)]
    assert scenes[0] == scenes[1] != scenes[2]
