from dataclasses import replace

import torch
from tests.baselines.base import ENCODER, BaselineTester, build, n_parameters, photos

from zoedepth.config import BaselineConfig, PixelBinsNetworkConfig

TINY = BaselineConfig(PixelBinsNetworkConfig(ENCODER, n_bins=6), size=(64, 96))


class TestPixelBins(BaselineTester):
    TINY = TINY
    HAS_BINS = True


def test_it_has_the_parameters_of_its_code():
    """No number is published; its code makes as many and the 4096 of a norm that it does not use."""
    assert n_parameters(BaselineConfig(PixelBinsNetworkConfig())) == 61_222_320 - 4096


@torch.no_grad()
def test_published_bins_begin_one_width_late():
    right = replace(TINY, network=replace(TINY.network, exact=False))
    pixels = photos(TINY)
    late, early = (build(config, weights_of=TINY)(pixels, return_bins=True).bin_centers for config in (TINY, right))
    assert torch.allclose(late[:, -1], torch.tensor(10 - 0.0005), atol=1e-4), "a last bin as wide as the nearest depth"
    assert (early[:, -1] < 9.99).all()
