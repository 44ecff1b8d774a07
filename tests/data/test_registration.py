"""Depth that lies on its photos, and depth of another camera beside them."""

import numpy as np
import pytest

from zoedepth.data.registration import Edges, edges, register

HEIGHT, WIDTH = 240, 320


def scene(seed: int, *, scale: float = 1.0, right: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A photo and depth of boxes before a wall; the depth is enlarged about the middle, and moved to the right."""
    rng = np.random.default_rng(seed)
    image, depth = np.full((HEIGHT, WIDTH), 0.5), np.full((HEIGHT, WIDTH), 5.0)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    seen_rows = (rows - (HEIGHT - 1) / 2) / scale + (HEIGHT - 1) / 2
    seen_columns = (columns - right * HEIGHT - (WIDTH - 1) / 2) / scale + (WIDTH - 1) / 2
    for grey, metres in zip(rng.uniform(0, 1, 8), np.linspace(4, 1, 8), strict=True):
        top, left = rng.uniform(10, HEIGHT - 70), rng.uniform(10, WIDTH - 90)
        height, width = rng.uniform(20, 50, 2)
        for values, value, y, x in ((image, grey, rows, columns), (depth, metres, seen_rows, seen_columns)):
            values[(y >= top) & (y < top + height) & (x >= left) & (x < left + width)] = value
    noise = rng.normal(0, 0.02, image.shape)
    return np.repeat((image + noise).clip(0, 1)[None], 3, axis=0).astype(np.float32), depth.astype(np.float32)


def edges_of(n: int, *, scale: float = 1.0, right: float = 0.0) -> list[Edges]:
    found = [edges(*scene(seed, scale=scale, right=right)) for seed in range(n)]
    return [each for each in found if each is not None]


def test_depth_that_lies_on_its_photos_fits() -> None:
    found = register(edges_of(4))
    assert found is not None
    assert found.fits
    assert found.scale == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(("scale", "right"), [(1.11, 0.0), (0.9, 0.0), (1.0, 0.03)])
def test_depth_of_another_camera_is_found_and_the_way_back_told(scale: float, right: float) -> None:
    found = register(edges_of(4, scale=scale, right=right))
    assert found is not None
    assert not found.fits
    assert found.scale == pytest.approx(1 / scale, abs=0.012)
    assert found.shift == pytest.approx((0, -right / scale), abs=0.01)
    assert f"{found.scale:.2f} times as large" in str(found)
    assert ("% of the height left" in str(found)) == bool(right)


def test_little_is_nothing_to_judge_by() -> None:
    assert register(edges_of(3)) is None
    image, depth = scene(0)
    assert edges(image, np.full_like(depth, 3.0)) is None, "no jump"
    scattered = np.zeros_like(depth)
    scattered[::7, ::7] = depth[::7, ::7]
    assert edges(image, scattered) is None, "points without neighbours"
    assert edges(np.zeros_like(image), depth) is None, "a black photo"
    assert edges(image[:, :100], depth[:100]) is None, "a small map"


def test_a_best_place_at_the_end_of_all_that_were_tried_is_none() -> None:
    found = register(edges_of(4, right=0.3))
    assert found is not None
    assert found.fits
