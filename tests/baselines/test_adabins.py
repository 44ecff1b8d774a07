from typing import ClassVar

import pytest
from tests.baselines.base import ENCODER, BaselineTester, n_parameters

from zoedepth.build import build_model, without_memory
from zoedepth.config import AdaBinsNetworkConfig, BaselineConfig

TINY = BaselineConfig(AdaBinsNetworkConfig(ENCODER, n_bins=16), size=(64, 96))


class TestAdaBins(BaselineTester):
    TINY = TINY
    HAS_BINS = True
    TERMS: ClassVar[set[str]] = {"silog", "chamfer"}


def test_it_has_the_published_number_of_parameters():
    n = n_parameters(BaselineConfig(AdaBinsNetworkConfig()))
    assert n == 78_253_232
    assert n == pytest.approx(78e6, rel=0.03)


def test_transformer_is_the_published_one():
    with without_memory():
        bins = build_model(BaselineConfig(AdaBinsNetworkConfig())).bins
    assert len(bins.tokens.transformer.layers) == 4
    assert bins.tokens.positions.shape == (500, 128)
    assert bins.tokens.embed.weight.shape == (128, 128, 16, 16)
    assert bins.widths[-1].out_features == bins.probability.out_channels == 256
    assert bins.n_queries == 128
