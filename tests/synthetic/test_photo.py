import numpy as np
import pytest

from zoedepth.synthetic.photo import photograph

SEEDS = range(12)


def scene(n: int = 48) -> np.ndarray:
    """Return light that grows from left to right and, less, from top to bottom, redder than blue."""
    x, y = np.meshgrid(np.linspace(0.05, 1, n), np.linspace(0.8, 1, n))
    return ((x * y)[..., None] * np.array((1.0, 0.7, 0.4))).astype(np.float32)


def test_photo_is_of_the_same_size_upright_and_of_the_same_colours() -> None:
    for seed in SEEDS:
        photo = photograph(scene()[:40], np.random.default_rng(seed)).astype(float)
        assert photo.shape == (40, 48, 3)
        brightness = photo.mean(-1)
        assert brightness[:, 30:40].mean() > 1.3 * brightness[:, 8:18].mean()
        red, _, blue = photo[15:25, 10:30].mean((0, 1))
        assert red > blue


def test_exposure_takes_the_brightness_of_the_scene_away() -> None:
    for seed in SEEDS:
        dim, bright = (photograph(k * scene(), np.random.default_rng(seed)).mean() for k in (0.1, 30.0))
        assert dim == pytest.approx(bright, rel=0.06)
        assert 50 < dim < 200


def test_same_generator_gives_the_same_bits_and_others_do_not() -> None:
    photos = [photograph(scene(), np.random.default_rng(seed)) for seed in (3, 3, 4)]
    assert photos[0].dtype == np.uint8
    np.testing.assert_array_equal(photos[0], photos[1])
    assert np.abs(photos[0].astype(int) - photos[2]).max() > 5


def test_darkness_and_glare_give_a_photo() -> None:
    for light in (np.zeros((32, 40, 3)), np.full((32, 40, 3), 1e4)):
        for seed in SEEDS:
            photo = photograph(light.astype(np.float32), np.random.default_rng(seed))
            assert photo.std() < 60
    spot = np.full((64, 64, 3), 0.05, np.float32)
    spot[30:34, 30:34] = 50  # burns out, and nothing wraps around
    for seed in SEEDS:
        assert photograph(spot, np.random.default_rng(seed))[31:33, 31:33].min() > 120


def test_cameras_darken_the_corners_or_leave_them() -> None:
    even = np.full((64, 64, 3), 0.3, np.float32)
    photos = [photograph(even, np.random.default_rng(seed)).astype(float) for seed in range(30)]
    falls = [photo[24:40, 24:40].mean() - photo[[0, 0, -1, -1], [0, -1, 0, -1]].mean() for photo in photos]
    assert min(falls) > -8
    assert max(falls) > 15
