from dataclasses import replace
from typing import Any, ClassVar

import pytest
import torch
from tests.model.heads.base import DOMAIN, HeadTester, build_head, decoder_features

from zoedepth.config import PixelBinsConfig
from zoedepth.model.heads.pixelbins import PixelBins

TINY = PixelBinsConfig(n_bins=6, width=8)


class TestPixelBinsHead(HeadTester):
    TINY = TINY
    CHANGES: ClassVar[dict[str, tuple[Any, dict[str, Any]]]] = {
        "n_bins": (7, {}),
        "width": (16, {}),
        "exact": (True, {}),
    }


class TestExactPixelBinsHead(TestPixelBinsHead):
    TINY = replace(TINY, exact=True)
    BOUNDED = False
    CHANGES: ClassVar[dict[str, tuple[Any, dict[str, Any]]]] = {**TestPixelBinsHead.CHANGES, "exact": (False, {})}

    def check_centers(self, centers: torch.Tensor, config: PixelBinsConfig) -> None:
        """Between 0, not the nearest depth, and the farthest."""
        assert (centers > 0).all()
        assert (centers <= DOMAIN.max_depth + 1e-4).all()
        assert (centers.diff(dim=1) >= -1e-4).all()


def by_hand(scores: list[float], *, exact: bool) -> list[float]:
    """Centers of three bins whose scores are the same at every pixel."""
    layer = PixelBins(1, 3, DOMAIN, exact=exact)
    with torch.no_grad():
        layer.widths.weight.zero_()
        layer.widths.bias.copy_(torch.tensor(scores))
        return layer(torch.zeros(1, 1, 2, 2)).distribution.bin_centers[0, :, 1, 0].tolist()


def test_bins_begin_at_the_nearest_depth_and_end_at_the_farthest():
    """Equal widths of 2.5 m between 0.5 and 8 m."""
    assert by_hand([1.0, 1.0, 1.0], exact=False) == pytest.approx([1.75, 4.25, 6.75])


def test_published_bins_begin_one_width_late():
    """Edges at 2.5, 5, 7.5 and 8 m: the nearest depth was put behind the widths."""
    assert by_hand([1.0, 1.0, 1.0], exact=True) == pytest.approx([3.75, 6.25, 7.75], abs=1e-4)


def test_published_widths_can_die_and_ours_cannot():
    for exact in (True, False):
        layer = PixelBins(1, 3, DOMAIN, exact=exact)
        with torch.no_grad():
            layer.widths.bias.fill_(-20.0)
        layer(torch.zeros(1, 1, 2, 2)).depth.sum().backward()
        gradient = layer.widths.bias.grad.abs().max()
        assert (gradient == 0) if exact else (gradient > 0)


def test_every_pixel_has_bins_of_its_own():
    layer, x = PixelBins(5, 3, DOMAIN, exact=False), torch.randn(1, 5, 4, 6)
    alone = layer(x[:, :, 2:3, 4:5]).distribution.bin_centers
    assert torch.allclose(layer(x).distribution.bin_centers[:, :, 2:3, 4:5], alone)
    centers = build_head(TINY)(decoder_features((64, 64))).distribution.bin_centers
    assert not torch.equal(centers[:, :, 0, 0], centers[:, :, 9, 9])
