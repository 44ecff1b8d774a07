"""Resizing without torch against torch itself."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from zoedepth import pixels
from zoedepth.resizing import Mode, reflect_pad, resize, to_pixels

SIZES = [((31, 40), (64, 96)), ((61, 47), (32, 32)), ((33, 80), (64, 32)), ((1, 5), (32, 64)), ((40, 3), (1, 1))]
"""Sizes before and after: larger, smaller, one of each, of one row, and to one pixel."""


def photo(size: tuple[int, int]) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8)


def tensor(image: np.ndarray) -> torch.Tensor:
    return torch.tensor(image).permute(2, 0, 1)[None]


@pytest.mark.parametrize("antialias", [True, False])
@pytest.mark.parametrize(("before", "after"), SIZES)
def test_pixels_are_those_of_torch(before: tuple[int, int], after: tuple[int, int], antialias: bool) -> None:
    expected = pixels.resize_pixels(tensor(photo(before)) / 255, after, antialias=antialias)[0].numpy()
    found = to_pixels(photo(before), after, antialias=antialias)
    assert (found.dtype, found.flags.c_contiguous) == (np.float32, True)
    np.testing.assert_allclose(found, expected, atol=1e-5)  # torch rounds the weights of its filter


@pytest.mark.parametrize("mode", ["bicubic", "bilinear"])
@pytest.mark.parametrize(("before", "after"), SIZES)
def test_maps_are_those_of_torch(before: tuple[int, int], after: tuple[int, int], mode: Mode) -> None:
    x = 10 * np.random.default_rng(0).random(before, dtype=np.float32)
    aligned = mode == "bilinear"
    expected = F.interpolate(torch.tensor(x)[None, None], after, mode=mode, align_corners=aligned)[0, 0].numpy()
    found = resize(x, after, mode)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=2e-5)  # a few roundings of numbers up to 10


@pytest.mark.parametrize("size", [(5, 7), (2, 3), (1, 4)])
def test_borders_are_those_of_torch(size: tuple[int, int]) -> None:
    """Also where the border is wider than the photo."""
    for vertical, horizontal in ((0, 0), (3, 2), (9, 0)):
        expected = pixels.reflect_pad(tensor(photo(size)), vertical, horizontal)[0].permute(1, 2, 0).numpy()
        np.testing.assert_array_equal(reflect_pad(photo(size), vertical, horizontal), expected)
