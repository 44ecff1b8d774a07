from dataclasses import replace

import pytest
import torch

from zoedepth.build import build_model
from zoedepth.config import BaselineConfig, PixelBinsNetworkConfig

TINY = BaselineConfig(PixelBinsNetworkConfig("tf_efficientnet_lite0", n_bins=6), size=(64, 96))


def test_it_has_the_parameters_of_its_code():
    """No number is published; its code makes as many and the 4096 of a norm that it does not use."""
    with torch.device("meta"):
        model = build_model(BaselineConfig(PixelBinsNetworkConfig()))
    assert sum(p.numel() for p in model.parameters()) == 61_222_320 - 4096


@torch.no_grad()
def test_published_bins_begin_one_width_late():
    torch.manual_seed(0)
    public = build_model(TINY).eval()
    right = build_model(replace(TINY, network=replace(TINY.network, exact=False))).eval()
    right.load_state_dict(public.state_dict())
    pixels = torch.rand(1, 3, 64, 96)
    late, early = (model(pixels, return_bins=True).bin_centers for model in (public, right))
    assert (late.mean(dim=1) > early.mean(dim=1)).all()
    assert late[:, -1] == pytest.approx(10 - 0.0005, abs=1e-3)
