from dataclasses import replace
from typing import ClassVar

import pytest
import torch
from tests.baselines.base import ENCODER, BaselineTester, build, n_parameters, photos

from zoedepth.build import build_model, without_memory
from zoedepth.config import BaselineConfig, LocalBinsNetworkConfig

TINY = BaselineConfig(LocalBinsNetworkConfig(ENCODER, n_seed_bins=2, n_windows=4), size=(64, 96))
PUBLIC = replace(TINY, network=replace(TINY.network, front_padding=False))


class TestLocalBins(BaselineTester):
    TINY = TINY
    HAS_BINS = True
    TERMS: ClassVar[set[str]] = {"silog", "window_chamfer"}


def test_it_has_the_published_number_of_parameters():
    n = n_parameters(BaselineConfig(LocalBinsNetworkConfig()))
    assert n == 73_544_872
    assert n == pytest.approx(74e6, rel=0.03)


@torch.no_grad()
def test_bins_are_in_order():
    centers = build(TINY)(photos(TINY), return_bins=True).bin_centers
    assert centers.shape[1] == 32
    assert (centers.diff(dim=1) > 0).all()


def test_its_bins_are_sixteen_times_the_seed_bins():
    for n_seed_bins, n_bins in ((8, 128), (16, 256)):
        with without_memory():
            model = build_model(BaselineConfig(LocalBinsNetworkConfig(n_seed_bins=n_seed_bins)))
        assert model.probability.out_channels == n_bins
        assert [splitter[-1].out_channels for splitter in model.bins.splitters] == [
            n_bins // 2**i for i in (3, 2, 1, 0)
        ]


def test_windows_come_while_training_and_where_asked_for():
    pixels = photos(TINY)
    boxes, centers = build(TINY).train()(pixels).supervision.window_bins
    assert boxes.shape == (2, 20, 4)
    assert [x.shape for x in centers] == [(2, 20, n) for n in (4, 8, 16, 32)]
    assert build(TINY)(pixels).supervision.window_bins is None
    without = replace(TINY, network=replace(TINY.network, n_windows=0))
    assert build(without, weights_of=TINY).train()(pixels).supervision.window_bins is None


@torch.no_grad()
def test_every_bin_of_the_public_code_is_where_the_next_one_should_be():
    """But for the nearest depth, 1 mm; and the last ends at the farthest depth, as wide as the nearest."""
    pixels = photos(TINY)
    right, shifted = (build(config, weights_of=TINY)(pixels, return_bins=True) for config in (TINY, PUBLIC))
    assert torch.allclose(shifted.bin_centers[:, :-1], right.bin_centers[:, 1:] - 1e-3, atol=1e-4)
    assert torch.allclose(shifted.bin_centers[:, -1], torch.tensor(10.0 - 0.0005), atol=1e-4)
    assert torch.equal(right.probability, shifted.probability)


def test_windows_of_the_public_code_have_its_bins_as_well():
    right, shifted = [], []
    for config, levels in ((TINY, right), (PUBLIC, shifted)):
        torch.manual_seed(0)  # the same windows
        levels += build(config, weights_of=TINY).train()(photos(TINY)).supervision.window_bins.centers
    for wanted, found in zip(right, shifted, strict=True):
        assert torch.allclose(found[..., :-1], wanted[..., 1:] - 1e-3, atol=1e-4)
