import numpy as np
import pytest

from zoedepth.geometry.panorama import cut_out, panorama_points, panorama_views
from zoedepth.synthetic.panorama import make_panorama

HEIGHT = 48


@pytest.fixture(scope="module")
def panorama() -> tuple[np.ndarray, np.ndarray]:
    return make_panorama("indoor", HEIGHT, np.random.default_rng(2))


def test_panoramas_are_photos_with_distances_all_around(panorama: tuple[np.ndarray, np.ndarray]) -> None:
    image, distance = panorama
    assert image.shape == (HEIGHT, 2 * HEIGHT, 3)
    assert image.dtype == np.uint8
    assert image.std() > 20
    assert distance.shape == (HEIGHT, 2 * HEIGHT)
    assert distance.dtype == np.float32
    known = distance > 0
    assert known.mean() > 0.8
    assert 0.1 < distance[known].min() < distance.max() < 20


def test_the_floor_is_level_and_below(panorama: tuple[np.ndarray, np.ndarray]) -> None:
    _, distance = panorama
    down = panorama_points(distance)[..., 1]
    lowest = np.nanmax(down)
    assert 0.8 < lowest < 2.5  # the camera is held at about the height of the eyes
    assert (np.abs(down - lowest) < 0.01).sum() > 30
    assert (np.abs(down - lowest) < 0.01)[: HEIGHT // 2].sum() == 0


def test_the_borders_are_neighbours(panorama: tuple[np.ndarray, np.ndarray]) -> None:
    image, _ = panorama
    steps = np.abs(np.diff(image.astype(float), axis=1, append=image[:, :1])).mean(axis=(0, 2))
    assert steps[-1] < 2 * np.median(steps) + 5
    ahead = cut_out(image, panorama_views((30, 40))[0])
    middle = image[HEIGHT // 2 - 2 : HEIGHT // 2 + 2, HEIGHT - 2 : HEIGHT + 2].mean((0, 1))
    assert np.abs(ahead[13:17, 18:22].mean((0, 1)) - middle).max() < 25


def test_the_same_seed_gives_the_same_panorama() -> None:
    one, other = (make_panorama("outdoor", 16, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(one[0], other[0])
    assert np.array_equal(one[1], other[1])
    assert (one[1] == 0).any()  # the sky
