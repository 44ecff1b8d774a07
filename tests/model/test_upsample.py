import itertools

import pytest
import torch
import torch.nn.functional as F

from zoedepth.model.upsample import ConvexWeights, convex_upsample, upsample, upsample_rows


def test_corners_stay_on_corners():
    x = torch.tensor([[[[0.0, 1.0], [2.0, 3.0]]]])
    assert upsample(x, torch.Size([3, 3]))[0, 0].tolist() == [[0.0, 0.5, 1.0], [1.0, 1.5, 2.0], [2.0, 2.5, 3.0]]


def test_maps_of_the_size_are_returned_as_they_are():
    x = torch.rand(1, 2, 3, 4)
    assert upsample(x, torch.Size([3, 4])) is x


@pytest.mark.parametrize("size", [(7, 9), (3, 4), (1, 5), (2, 5), (24, 8)])
def test_rows_are_those_of_the_whole(size: tuple[int, int]):
    x, whole = torch.rand(2, 3, 3, 4, generator=torch.Generator().manual_seed(0)), torch.Size(size)
    expected = upsample(x, whole)
    for start in range(size[0]):
        for stop in (start + 1, size[0]):
            rows = slice(start, stop)
            assert torch.allclose(upsample_rows(x, whole, rows), expected[:, :, rows], atol=1e-6)
    assert torch.equal(upsample_rows(x, whole, slice(None)), expected)


def test_rows_of_half_precision_stay_in_it():
    x = torch.rand(2, 3, 3, 4, generator=torch.Generator().manual_seed(0))
    found = upsample_rows(x.bfloat16(), torch.Size([7, 9]), slice(2, 5))
    assert found.dtype == torch.bfloat16
    # Values below 1 are rounded by at most 2 ** -9, the places between rows once more.
    torch.testing.assert_close(found.float(), upsample(x, torch.Size([7, 9]))[:, :, 2:5], rtol=0, atol=2e-2)


def test_new_convex_weights_upsample_bilinearly():
    x = torch.rand(2, 1, 3, 5, generator=torch.Generator().manual_seed(0))
    weights = ConvexWeights(4)(torch.rand(2, 4, 3, 5), torch.rand(2, 3, 6, 10))
    bilinear = F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
    torch.testing.assert_close(convex_upsample(x, weights), bilinear, rtol=0, atol=1e-2)


def test_convex_weights_see_the_four_pixels_of_each_place_and_sum_to_one():
    convex = ConvexWeights(4)
    torch.nn.init.normal_(convex.conv2.weight)
    last, pixels = torch.rand(1, 4, 8, 8), torch.rand(1, 3, 16, 16)
    weights = convex(last, pixels)
    assert torch.allclose(weights.sum(dim=1), torch.ones(1, 4, 8, 8))
    pixels[..., 7, 6] += 1  # of row 3, column 3
    changed = (convex(last, pixels) != weights).any(dim=2).any(dim=1)[0]
    assert changed.nonzero().min() == 2
    assert changed.nonzero().max() == 4


def test_each_new_pixel_takes_its_own_weights_of_the_values_around_it():
    x = torch.arange(12.0).reshape(1, 1, 3, 4)
    for place, (row, column) in enumerate(itertools.product((-1, 0, 1), repeat=2)):
        for new in range(4):
            weights = F.one_hot(torch.tensor(4), 9).float()[None, :, None, None, None].repeat(1, 1, 4, 3, 4)
            weights[:, :, new] = F.one_hot(torch.tensor(place), 9).float()[:, None, None]
            expected = x.repeat_interleave(2, dim=2).repeat_interleave(2, dim=3)
            rows, columns = (torch.arange(3) + row).clamp(0, 2), (torch.arange(4) + column).clamp(0, 3)
            expected[:, :, new // 2 :: 2, new % 2 :: 2] = x[:, :, rows][:, :, :, columns]
            torch.testing.assert_close(convex_upsample(x, weights), expected)
