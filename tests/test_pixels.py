"""Padding is NumPy's reflection; resizing is torch's, with corners aligned or with a filter."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from zoedepth.pixels import reflect_pad, resize_pixels


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (2, 3), (5, 4), (30, 40)])
@pytest.mark.parametrize("padding", [(0, 0), (3, 0), (0, 5), (11, 9)])
def test_reflect_pad_is_numpys(size: tuple[int, int], padding: tuple[int, int]) -> None:
    x = torch.rand(2, 3, *size)
    expected = np.pad(x.numpy(), ((0, 0), (0, 0), (padding[0],) * 2, (padding[1],) * 2), mode="reflect")
    assert np.array_equal(reflect_pad(x, *padding).numpy(), expected)


def test_resizing_keeps_the_corners_or_filters() -> None:
    pixels = torch.rand(1, 3, 40, 60, generator=torch.Generator().manual_seed(0))
    small = resize_pixels(pixels, (10, 15), antialias=False)
    torch.testing.assert_close(small[..., [0, 0, -1, -1], [0, -1, 0, -1]], pixels[..., [0, 0, -1, -1], [0, -1, 0, -1]])
    # Alternating columns are a grey that only a filter sees; a slope is the mean of each 4x4 inside of the borders.
    stripes = (torch.arange(60) % 2).float().expand(1, 3, 40, 60)
    torch.testing.assert_close(
        resize_pixels(stripes, (10, 15), antialias=True), torch.full((1, 3, 10, 15), 0.5), atol=0.08, rtol=0
    )
    assert resize_pixels(stripes, (10, 15), antialias=False).std() > 0.2
    slope = torch.linspace(0, 1, 60).expand(1, 3, 40, 60)
    filtered = resize_pixels(slope, (10, 15), antialias=True)[..., 1:-1]
    torch.testing.assert_close(filtered, F.avg_pool2d(slope, 4)[..., 1:-1])


def test_a_filtered_photo_stays_in_its_range() -> None:
    edge = torch.zeros(1, 3, 40, 60)
    edge[..., 30:] = 1
    for size in ((10, 15), (80, 120)):
        resized = resize_pixels(edge, size, antialias=True)
        assert resized.min() >= 0
        assert resized.max() <= 1
