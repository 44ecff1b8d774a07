import math
from dataclasses import replace
from itertools import pairwise
from typing import Any, ClassVar

import pytest
import torch
from tests.model.heads.base import DOMAIN, HeadTester, build_head, decoder_features
from torch.nn.functional import conv2d

from zoedepth.config import DornConfig
from zoedepth.model.heads.dorn import SceneModule, interval_edges, ordinal_depth

TINY = DornConfig(n_intervals=6, width=8)
OPTIONS = {
    "paper": TINY,
    "uniform": replace(TINY, spacing="uniform"),
    "soft": replace(TINY, decode="soft"),
    "scene": replace(TINY, scene=True),
    "scene-soft": replace(TINY, scene=True, decode="soft", spacing="uniform"),
    "two-intervals": replace(TINY, n_intervals=2),
}


class TestDornHead(HeadTester):
    TINY = TINY
    HAS_BINS = False
    EXPORTED = (TINY, OPTIONS["scene-soft"])
    CHANGES: ClassVar[dict[str, tuple[Any, dict[str, Any]]]] = {
        "n_intervals": (9, {}),
        "spacing": ("uniform", {}),
        "decode": ("soft", {}),
        "width": (16, {}),
        "scene": (True, {}),
    }

    @pytest.fixture(params=list(OPTIONS))
    def config(self, request: pytest.FixtureRequest) -> DornConfig:
        return OPTIONS[request.param]


RANGES = [(1e-3, 10.0), (1e-3, 80.0), (2.0, 80.0), (0.5, 8.0)]


def right_logits(depth: torch.Tensor, edges: torch.Tensor) -> torch.Tensor:
    """Logits (1, intervals, 1, depths) of the right answer, sure of it."""
    beyond = depth >= edges[1:, None]
    return torch.where(beyond, 1e3, -1e3)[None, :, None]


@pytest.mark.parametrize(("low", "high"), RANGES)
def test_increasing_intervals_grow_by_one_factor_of_the_shifted_depth(low: float, high: float):
    edges = interval_edges(low, high, 80, spacing="increasing")
    assert len(edges) == 81
    assert (edges[0], edges[-1]) == (low, high)
    ratios = [(b + 1 - low) / (a + 1 - low) for a, b in pairwise(edges)]
    assert ratios == pytest.approx([(high + 1 - low) ** (1 / 80)] * 80, rel=1e-9)


def test_intervals_by_hand():
    # Shifted by 0.5: from 1 to 16 in four steps of a factor of 2.
    assert interval_edges(0.5, 15.5, 4, spacing="increasing") == pytest.approx((0.5, 1.5, 3.5, 7.5, 15.5))
    assert interval_edges(1.0, 9.0, 4, spacing="uniform") == pytest.approx((1.0, 3.0, 5.0, 7.0, 9.0))


@pytest.mark.parametrize("decode", ["hard", "soft"])
@pytest.mark.parametrize("spacing", ["increasing", "uniform"])
@pytest.mark.parametrize(("low", "high"), RANGES)
def test_right_logits_decode_to_the_middle_of_the_interval_of_the_depth(
    low: float, high: float, spacing: str, decode: str
):
    """The nearest and the farthest depth and every edge included: never more than half an interval off."""
    edges = torch.tensor(interval_edges(low, high, 40, spacing=spacing))
    middles, widths = (edges[:-1] + edges[1:]) / 2, edges.diff()
    depth = torch.cat([edges, middles, torch.linspace(low, high, 501)]).clamp(low, high)
    found = ordinal_depth(right_logits(depth, edges), edges, decode=decode)[0, 0, 0]
    label = (torch.searchsorted(edges, depth, right=True) - 1).clamp(max=39)
    assert torch.allclose(found, middles[label], rtol=1e-4)
    assert ((found - depth).abs() <= widths[label] / 2 + 1e-4 * depth).all()
    assert torch.allclose(found[41:81], middles, rtol=1e-4), "no interval too far"
    thresholds = right_logits(depth, edges)[0, :, 0]
    assert (thresholds.diff(dim=0) <= 0).all(), "what is beyond an interval is beyond all before it"


def test_probabilities_of_a_half_count_as_beyond():
    edges = torch.tensor([1.0, 2.0, 4.0, 8.0])
    assert ordinal_depth(torch.zeros(1, 3, 1, 1), edges, decode="hard").item() == 6.0  # the last of 1.5, 3, 6
    soft = ordinal_depth(torch.zeros(1, 3, 1, 1), edges, decode="soft")
    assert soft.item() == pytest.approx(1.5 + 0.5 * 1.5 + 0.5 * 3)
    one = torch.tensor([0.1, -0.1, -0.1])[None, :, None, None]
    assert ordinal_depth(one, edges, decode="hard").item() == 3.0


def test_soft_depth_grows_with_every_logit_that_matters():
    edges = torch.tensor([1.0, 2.0, 4.0, 8.0])
    logits = torch.randn(1, 3, 2, 2, requires_grad=True)
    ordinal_depth(logits, edges, decode="soft").sum().backward()
    assert (logits.grad[:, :2] > 0).all()
    assert (logits.grad[:, 2] == 0).all(), "no interval lies beyond the last"


def test_the_loss_gets_logits_and_the_edges_of_the_domain_for_every_image():
    ordinal = build_head(TINY)(decoder_features((64, 96), batch=3)).supervision.ordinal
    assert ordinal.logits.shape == (3, 6, 32, 48)
    assert ordinal.logits.dtype == torch.float32
    assert ordinal.edges.shape == (3, 7)
    for edges in ordinal.edges.tolist():
        assert edges == pytest.approx(interval_edges(DOMAIN.min_depth, DOMAIN.max_depth, 6, spacing="increasing"))


def test_a_head_looks_at_the_finest_level_or_at_the_bottleneck():
    features = decoder_features((64, 64))
    blind = features._replace(bottleneck=torch.zeros_like(features.bottleneck))
    for scene in (False, True):
        head = build_head(replace(TINY, scene=scene, decode="soft")).eval()
        assert torch.equal(head(features).depth, head(blind).depth) != scene


@torch.no_grad()
def test_logits_of_the_finest_level_by_hand():
    """A 1x1 convolution of the ReLU of a 3x3 convolution."""
    head, features = build_head(TINY), decoder_features((64, 96))
    conv, logits = head.domain.hidden[0], head.domain.logits
    hidden = conv2d(features.levels[-1], conv.weight, conv.bias, padding=1).relu()
    found = head(features).supervision.ordinal.logits
    torch.testing.assert_close(found, conv2d(hidden, logits.weight, logits.bias))


@torch.no_grad()
def test_full_image_of_the_scene_is_its_mean_of_which_training_drops_a_half():
    full_image = build_head(replace(TINY, scene=True)).domain.hidden.full_image
    x, conv = torch.randn(2, 10, 3, 4), full_image[-1]
    torch.testing.assert_close(full_image.eval()(x), conv2d(x.mean(dim=(2, 3), keepdim=True), conv.weight, conv.bias))
    exact = full_image.eval()(x)  # training doubles what it keeps: no draw gives the same
    assert not torch.equal(full_image.train()(x), exact)


def test_scene_module_has_five_branches_of_which_one_sees_all_and_none_more_than_its_rate():
    """Which inputs a pixel's features depend on: rows 0, 4, 6 and 8 places away, and, by the full image, all others."""
    torch.manual_seed(0)
    for sees_all in (False, True):
        pool = torch.nn.AdaptiveAvgPool2d(1)
        nothing = torch.nn.Sequential(pool, torch.nn.Conv2d(3, 8, 1))
        if not sees_all:
            torch.nn.init.zeros_(nothing[1].weight)
        module = SceneModule(3, width=8, rates=(4, 6, 8), full_image=nothing).eval()
        x = torch.randn(1, 3, 1, 24, requires_grad=True)
        features = module(x)
        assert features.shape == (1, 32, 1, 24)
        features[:, :, 0, 10].sum().backward()
        seen = {int(i) - 10 for i in (x.grad.abs().sum(dim=(0, 1, 2)) > 0).nonzero()}
        assert seen == (set(range(-10, 14)) if sees_all else {-8, -6, -4, 0, 4, 6, 8})


@torch.no_grad()
def test_scene_module_by_hand():
    """One pixel: every convolution is the matrix in its middle."""
    torch.manual_seed(0)
    full_image = torch.nn.Conv2d(3, 8, 1)
    module = SceneModule(3, width=8, rates=(1, 2, 3), full_image=full_image).eval()
    x = torch.randn(1, 3, 1, 1)

    def apply(layer: torch.nn.Conv2d, values: torch.Tensor) -> torch.Tensor:
        middle = layer.kernel_size[0] // 2
        return (layer.weight[:, :, middle, middle] @ values + layer.bias).clamp(min=0)

    pixel = x[0, :, 0, 0]
    branches = [apply(layer, pixel) for layer in (full_image, *module.branches)]
    joined = torch.cat([apply(layer, branch) for layer, branch in zip(module.projects, branches, strict=True)])
    assert torch.allclose(module(x)[0, :, 0, 0], apply(module.mix, joined), atol=1e-6)
    assert module.dropout.p == 0.5


def test_new_head_starts_undecided():
    """Every logit near 0: a loss of ln 2 an interval."""
    head = build_head(replace(TINY, n_intervals=40))
    logits = head(decoder_features((32, 32))).supervision.ordinal.logits
    assert torch.nn.functional.softplus(logits).mean().item() == pytest.approx(math.log(2), abs=0.2)
