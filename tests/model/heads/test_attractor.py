import math
from dataclasses import replace
from typing import Any, ClassVar

import pytest
import torch
from tests.model.heads.base import CHANNELS, DOMAIN, HeadTester, build_head, decoder_features

from zoedepth.config import AttractorConfig
from zoedepth.model.heads.attractor import AttractorHead, AttractorLayer, attract, normed_centers

TINY = AttractorConfig(
    n_bins=6, n_attractors=(4, 3, 2, 1), embedding_width=8, projector_width=8, seed_width=8, max_temperature=5.0
)
NORMED = replace(TINY, centers="normed")
OPTIONS = {
    "paper": TINY,
    "sum": replace(TINY, reduce="sum"),
    "exponential": replace(TINY, kind="exponential"),
    "odd-gamma": replace(TINY, alpha=3.0, gamma=3.0),
    "gamma-one": replace(TINY, alpha=3.0, gamma=1.0),
    "normed": NORMED,
    "normed-sum": replace(NORMED, reduce="sum"),
    "normed-released": replace(NORMED, attractor_ratio=False),
    "no-relative": replace(TINY, relative_input=False, bottleneck_factor=4),
    "softmax": replace(TINY, probability="softmax"),
    "geometric": replace(TINY, initial_centers="geometric", alpha=1.0),
    "two-bins": replace(TINY, n_bins=2),
}


class TestAttractorHead(HeadTester):
    TINY = TINY
    BOUNDED = False
    EXPORTED = tuple(
        replace(config, n_attractors=(2, 1, 1, 1))
        for config in (
            TINY,
            replace(NORMED, kind="exponential", reduce="sum", attractor_ratio=False, relative_input=False),
            replace(NORMED, gamma=3.0, probability="softmax"),
        )
    )
    CHANGES: ClassVar[dict[str, tuple[Any, dict[str, Any]]]] = {
        "n_bins": (9, {}),
        "n_attractors": ((4, 3, 2, 2), {}),
        "kind": ("exponential", {}),
        "reduce": ("sum", {}),
        "alpha": (100.0, {}),
        "gamma": (3.0, {}),
        "centers": ("normed", {}),
        "attractor_ratio": (False, {"centers": "normed"}),
        "relative_input": (False, {}),
        "probability": ("softmax", {}),
        "bottleneck_factor": (4, {}),
        "min_temperature": (1.0, {}),
        "max_temperature": (50.0, {}),
        "embedding_width": (24, {}),
        "projector_width": (24, {}),
        "seed_width": (24, {}),
        "initial_centers": ("geometric", {}),
    }

    @pytest.fixture(params=list(OPTIONS))
    def config(self, request: pytest.FixtureRequest) -> AttractorConfig:
        return OPTIONS[request.param]

    def check_centers(self, centers: torch.Tensor, config: AttractorConfig) -> None:
        assert centers.isfinite().all()
        if config.centers == "softplus":
            assert (centers > 0).all(), "softplus centers are positive metres"
        if config.centers == "normed":
            assert (centers >= DOMAIN.min_depth - 1e-5).all()
            assert (centers <= DOMAIN.max_depth + 1e-5).all()
            assert (centers.diff(dim=1) >= -1e-5).all(), "normed centers are sorted"


def test_number_of_bins_and_attractors_follow_the_config():
    head = build_head(replace(TINY, n_bins=11, n_attractors=(7, 5, 3, 2)))
    assert head(decoder_features((32, 32))).distribution.bin_centers.shape[1] == 11
    x = torch.randn(1, 8, 2, 2)
    assert [layer(x).shape[1] for layer in head.domain.attractors] == [7, 5, 3, 2]


def test_attractors_of_softplus_centers_are_positive_metres():
    torch.manual_seed(0)
    layer, x = AttractorLayer(8, 3, normed=False, ratio=True), torch.randn(2, 8, 4, 4)
    points = layer(x)
    assert points.shape == (2, 3, 4, 4)
    for b, k in [(0, 0), (1, 2)]:
        assert points[b, k, 1, 2].item() == pytest.approx(
            math.log1p(math.exp(layer.mlp(x)[b, k, 1, 2].item())), abs=1e-6
        )


@pytest.mark.parametrize("ratio", [True, False])
def test_attractors_of_normed_centers_pair_neighbouring_channels(ratio: bool):
    """Channels are (a0, b0, a1, b1, ...); the attractor is a / (a + b), or a alone as the released code has it."""
    torch.manual_seed(0)
    layer, x = AttractorLayer(8, 3, normed=True, ratio=ratio), torch.randn(2, 8, 4, 4)
    raw, points = layer.mlp(x), layer(x)
    assert raw.shape[1] == 6
    assert points.shape == (2, 3, 4, 4)
    for k in range(3):
        a = max(raw[1, 2 * k, 3, 0].item(), 0) + 1e-3
        b = max(raw[1, 2 * k + 1, 3, 0].item(), 0) + 1e-3
        assert points[1, k, 3, 0].item() == pytest.approx(a / (a + b) if ratio else a, abs=1e-6)


def test_mlps_are_two_convolutions_with_a_relu_between():
    head = build_head(TINY)
    for mlp in (head.shared.seed, *head.shared.levels, head.domain.seed, head.domain.attractors[0].mlp):
        first, last = mlp[0], mlp[-1]
        x = 3 * torch.randn(2, first.in_channels, 2, 3)
        torch.testing.assert_close(mlp(x), last(first(x).relu()))


def test_single_pixel_of_a_head_by_hand():
    """All maps constant, so that upsampling does nothing: the whole head is arithmetic on one pixel."""
    config = replace(TINY, reduce="mean", alpha=2.0)
    head = build_head(config)
    features = decoder_features((32, 32), batch=1)
    flat = features._replace(
        bottleneck=features.bottleneck[:, :, :1, :1],
        levels=tuple(x[:, :, :1, :1].expand_as(x) for x in features.levels),
        last=features.last[:, :, :1, :1].expand_as(features.last),
        relative=features.relative[:, :, :1, :1].expand_as(features.relative),
    )
    embedding = head.shared(flat)
    softplus = torch.nn.functional.softplus
    centers = softplus(head.domain.seed(embedding.bottleneck)).flatten().tolist()
    previous = embedding.seed[0, :, 0, 0]
    for layer, level in zip(head.domain.attractors, embedding.levels, strict=True):
        here = level[0, :, 0, 0]
        points = softplus(layer.mlp((here + previous)[None, :, None, None])).flatten().tolist()
        centers = [c + sum((a - c) / (1 + 2 * (a - c) ** 2) for a in points) / len(points) for c in centers]
        previous = here
    inputs = torch.cat([flat.last[0, :, 0, 0], flat.relative[0, :, 0, 0], previous])
    probability = (
        head.domain.probability([inputs[None, :, None, None]], torch.ones(1, 1, 1, 1)).probability.flatten().tolist()
    )
    depth = sum(p * c for p, c in zip(probability, centers, strict=True))
    output = head(flat)
    assert output.distribution.bin_centers[0, :, 5, 7].tolist() == pytest.approx(centers, abs=1e-5)
    assert output.distribution.probability[0, :, 5, 7].tolist() == pytest.approx(probability, abs=1e-5)
    assert output.depth[0, 0, 5, 7].item() == pytest.approx(depth, abs=1e-5)


def pixels(*values: float) -> torch.Tensor:
    """A map of one pixel."""
    return torch.tensor(values).view(1, -1, 1, 1)


def test_normed_centers_by_hand():
    """Seeds of 0.2, -1 and 0.797 are widths of 0.201, 0.001 and 0.798; the attractors pull their middles."""
    head = build_head(replace(NORMED, n_bins=3, reduce="mean", alpha=2.0)).domain
    levels = [(0.3, 0.9), (0.5, 0.1), (0.4, 0.4), (0.8, 0.2)]
    found = head.centers([pixels(0.2, -1.0, 0.797), *(pixels(*level) for level in levels)], 0.5, 8.0)
    expected = [0.1005, 0.2015, 0.601]
    for level in levels:
        expected = [c + sum((a - c) / (1 + 2 * (a - c) ** 2) for a in level) / 2 for c in expected]
    assert found.flatten().tolist() == pytest.approx([0.5 + 7.5 * c for c in expected], abs=1e-5)


def test_mean_of_pulls_contracts_and_a_sum_does_not():
    """Sixteen attractors at 1 m: with a mean no center goes past them, and none overtakes another."""
    centers = torch.linspace(0.9, 1.1, 201).view(1, -1, 1, 1)
    moved = {
        reduce: attract(
            centers, torch.ones(1, 16, 1, 1), kind="inverse", reduce=reduce, alpha=300.0, gamma=2.0
        ).flatten()
        for reduce in ("mean", "sum")
    }
    assert (moved["mean"] - 1).abs().max() < 0.1
    assert (moved["mean"].diff() > 0).all()
    assert (moved["sum"] - 1).abs().max() > 0.4
    assert (moved["sum"].diff() < 0).any()
    assert AttractorConfig().reduce == "mean"


def test_only_a_sum_of_pulls_is_kept_from_below_the_nearest_depth():
    """A mean of pulls leaves a center among the attractors, however near they are."""
    for reduce, nearest in (("mean", 0.1), ("sum", 0.5)):
        head = build_head(replace(TINY, n_bins=2, reduce=reduce, alpha=1.0)).domain
        centers = head.centers([pixels(-3.0, -2.0), *4 * [pixels(0.1, 0.1)]], 0.5, 8.0)
        assert centers.flatten().tolist() == pytest.approx([nearest] * 2, abs=0.01)


def test_relative_depth_matters_only_where_it_is_an_input():
    features = decoder_features((32, 32))
    nearer = features._replace(relative=features.relative + 1)
    for relative_input in (True, False):
        head = build_head(replace(TINY, relative_input=relative_input))
        assert torch.equal(head(features).depth, head(nearer).depth) != relative_input


def test_normed_depth_spans_the_range_of_its_domain():
    """The same weights in another range: centers are mapped linearly from one to the other."""
    head, features = build_head(NORMED), decoder_features((32, 32))
    far = AttractorHead(CHANNELS, NORMED, replace(DOMAIN, name="outdoor", min_depth=2.0, max_depth=77.0))
    far.load_state_dict(head.domain.state_dict())
    embeddings = head.shared(features)
    near_centers, far_centers = (
        head.domain(embeddings).distribution.bin_centers,
        far(embeddings).distribution.bin_centers,
    )
    assert torch.allclose((near_centers - 0.5) / 7.5, (far_centers - 2.0) / 75.0, atol=1e-5)


def test_normed_centers_increase_inside_the_unit_interval():
    torch.manual_seed(0)
    centers = normed_centers(torch.rand(2, 9, 3, 3) + 1e-3)
    assert (centers > 0).all()
    assert (centers < 1).all()
    assert (centers.diff(dim=1) > 0).all()


def test_new_geometric_head_starts_with_centers_spread_over_its_range():
    """Its biases alone are a geometric row from the nearest depth, or 5 % of the farthest if that is more."""
    head = build_head(replace(TINY, initial_centers="geometric"))
    last = head.domain.seed[-1]
    centers = torch.nn.functional.softplus(last.bias).tolist()
    ratio = (8.0 / 0.5) ** (1 / 5)  # the domain begins at 0.5 m, beyond 5 % of 8 m
    assert centers == pytest.approx([0.5 * ratio**i for i in range(6)], rel=1e-4)
    wide = AttractorHead(CHANNELS, replace(TINY, initial_centers="geometric"), replace(DOMAIN, min_depth=1e-3))
    centers = torch.nn.functional.softplus(wide.seed[-1].bias).tolist()
    assert centers[0] == pytest.approx(0.4, rel=1e-4)
    assert centers[-1] == pytest.approx(8.0, rel=1e-4)


def test_a_released_new_head_starts_near_softplus_of_zero():
    features = decoder_features((32, 32))
    head = build_head(replace(TINY, reduce="mean"))
    assert head(features).depth.mean().item() == pytest.approx(math.log(2), abs=0.25)
