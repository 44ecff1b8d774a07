import pytest
import torch

from zoedepth.build import build_model
from zoedepth.config import AdaBinsNetworkConfig, BaselineConfig


def test_it_has_the_published_number_of_parameters():
    with torch.device("meta"):
        model = build_model(BaselineConfig(AdaBinsNetworkConfig()))
    n_parameters = sum(p.numel() for p in model.parameters())
    assert n_parameters == 78_253_232
    assert n_parameters == pytest.approx(78e6, rel=0.03)


def test_transformer_is_the_published_one():
    with torch.device("meta"):
        bins = build_model(BaselineConfig(AdaBinsNetworkConfig())).bins
    assert len(bins.tokens.transformer.layers) == 4
    assert bins.tokens.positions.shape == (500, 128)
    assert bins.tokens.embed.weight.shape == (128, 128, 16, 16)
    assert bins.widths[-1].out_features == bins.probability.out_channels == 256
    assert bins.n_queries == 128
