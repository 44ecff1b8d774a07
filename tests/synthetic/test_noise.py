import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zoedepth.synthetic.noise import SIZE, Noise, noise

NAMES = ("cloud", "grain", "speckle", "cells", "leaf")


def sharp(name: str, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return noise(name)(u, v, np.full(len(u), 1e-6, np.float32))


def grid(n: int = 64) -> tuple[np.ndarray, np.ndarray]:
    u, v = np.meshgrid(np.arange(n) / n, np.arange(n) / n)
    return u.ravel(), v.ravel()


@pytest.mark.parametrize("name", NAMES)
def test_values_are_around_one_half(name: str) -> None:
    values = sharp(name, *grid())
    assert values.min() >= 0
    assert values.max() <= 1
    assert values.mean() == pytest.approx(0.5, abs=0.03)
    assert 0.1 < values.std() < 0.25


@pytest.mark.parametrize("name", NAMES)
@given(u=st.integers(-40, 40), v=st.integers(-40, 40), level=st.integers(0, 9))
def test_it_repeats_after_one(name: str, u: int, v: int, level: int) -> None:
    x, y = (np.array(values) for values in ((0.125, 0.71875, 0.99609375), (0.5, 0.03125, 0.28515625)))
    footprint = np.full(3, 2.0**level / SIZE)
    np.testing.assert_allclose(noise(name)(x + u, y + v, footprint), noise(name)(x, y, footprint), atol=1e-6)


@pytest.mark.parametrize("name", ["cloud", "leaf", "grain"])
def test_no_seam_shows_where_it_repeats(name: str) -> None:
    """A step across the border of the table is as large as one elsewhere."""
    line, step = np.linspace(0, 1, 200, endpoint=False), 0.5 / SIZE
    for across in (False, True):

        def at(place: float, across: bool = across) -> np.ndarray:
            place_, line_ = np.full(200, place), line
            return sharp(name, line_, place_) if across else sharp(name, place_, line_)

        seam = np.abs(at(1 + step) - at(1 - step)).mean()
        inside = np.mean([np.abs(at(c + step) - at(c - step)).mean() for c in (0.21, 0.37, 0.5, 0.83)])
        assert seam < 2.5 * inside


def test_value_between_texels_is_bilinear() -> None:
    table = np.zeros((SIZE, SIZE))
    table[0, 0], table[0, 1] = 300.0, -300.0
    look = Noise(table)
    u = np.array([0, 0.25, 0.5, 0.75, 1.0]) / SIZE
    values = look(u, np.zeros(5), np.full(5, 1e-9))
    assert values[0] == 1  # clipped
    assert values[4] == 0
    np.testing.assert_allclose(values, [1, 0.75, 0.5, 0.25, 0], atol=1e-5)
    down = look(np.zeros(2), np.array([0, 0.5]) / SIZE, np.full(2, 1e-9))
    assert down[1] == pytest.approx(0.75, abs=1e-3)  # half way to 0.5


@pytest.mark.parametrize("name", NAMES)
def test_large_pixels_see_the_mean(name: str) -> None:
    u, v = grid()
    spread = [noise(name)(u, v, np.full(len(u), 2.0**k / SIZE)).std() for k in (0, 3, 6, 9)]
    assert spread == sorted(spread, reverse=True)
    assert spread[-1] < 0.02
    np.testing.assert_allclose(noise(name)(u, v, np.full(len(u), 10.0)), 0.5, atol=0.05)


def test_grain_runs_along_u() -> None:
    u, v = grid(256)
    values = sharp("grain", u, v).reshape(256, 256)
    assert np.abs(np.diff(values, axis=0)).mean() > 3 * np.abs(np.diff(values, axis=1)).mean()


def test_speckle_is_finer_than_cloud() -> None:
    u, v = grid(256)
    steps = [np.abs(np.diff(sharp(name, u, v).reshape(256, 256))).mean() for name in ("cloud", "speckle")]
    assert steps[1] > 3 * steps[0]


@pytest.mark.parametrize("name", NAMES)
def test_made_again_it_is_the_same(name: str) -> None:
    u, v = grid(16)
    first = sharp(name, u, v)
    noise.cache_clear()
    np.testing.assert_array_equal(sharp(name, u, v), first)
