import pytest
import torch

from zoedepth.model.upsample import upsample, upsample_rows


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
