import torch
from tests.model.heads.base import CHANNELS, decoder_features

from zoedepth.config import NaiveConfig
from zoedepth.model.heads.output import HeadOutput, Ordinal, PassThrough, Supervision, mixed
from zoedepth.model.heads.probability import BinDistribution


def distribution(seed: int) -> BinDistribution:
    generator = torch.Generator().manual_seed(seed)
    logits, centers = (torch.randn(2, 3, 2, 2, generator=generator) for _ in range(2))
    return BinDistribution(logits, None, None, 4 + centers)


def test_depth_is_the_prediction_or_its_mean():
    plain = HeadOutput(torch.rand(2, 1, 2, 2))
    assert plain.depth is plain.prediction
    assert plain.distribution is None
    assert plain.depth_and_std() == (plain.prediction, None)
    output = HeadOutput(distribution(0))
    expected = (output.distribution.probability * output.distribution.bin_centers).sum(dim=1, keepdim=True)
    assert torch.allclose(output.depth, expected)
    depth, std = output.depth_and_std()
    variance = output.distribution.probability * (output.distribution.bin_centers - expected).square()
    assert torch.allclose(depth, expected)
    assert torch.allclose(std, variance.sum(dim=1, keepdim=True).sqrt(), atol=1e-5)


def test_mixture_of_depths_is_their_weighted_mean():
    weight = torch.tensor([[0.25, 0.75], [1.0, 0.0]])
    one, other = torch.full((2, 1, 2, 2), 2.0), torch.full((2, 1, 2, 2), 6.0)
    found = mixed([HeadOutput(one), HeadOutput(other)], weight)
    assert found.distribution is None
    assert found.depth[:, 0, 0, 0].tolist() == [5.0, 2.0]


def test_mixture_of_distributions_has_the_bins_of_both():
    weight = torch.tensor([[0.25, 0.75], [0.6, 0.4]])
    heads = [HeadOutput(distribution(0)), HeadOutput(distribution(1))]
    found = mixed(heads, weight)
    parts = [w[:, None, None, None] * h.distribution.probability for w, h in zip(weight.T, heads, strict=True)]
    assert torch.allclose(found.distribution.probability, torch.cat(parts, dim=1), atol=1e-6)
    assert torch.equal(found.distribution.bin_centers, torch.cat([h.distribution.bin_centers for h in heads], dim=1))
    depth = sum(w[:, None, None, None] * h.depth for w, h in zip(weight.T, heads, strict=True))
    assert torch.allclose(found.depth, depth, atol=1e-5)


def test_supervision_is_joined_where_there_is_some():
    logits, edges = torch.arange(3.0).view(3, 1, 1, 1), torch.arange(3.0).view(3, 1)
    parts = [Supervision(Ordinal(logits[:1], edges[:1])), Supervision(Ordinal(logits[1:], edges[1:]))]
    found = Supervision.joined(parts, torch.tensor([2, 0, 1]))
    assert found.ordinal.logits.flatten().tolist() == found.ordinal.edges.flatten().tolist() == [2, 0, 1]
    assert found.image_bins is found.window_bins is None


def test_heads_that_share_nothing_see_the_decoder_features_themselves():
    features = decoder_features((32, 32))
    assert PassThrough(CHANNELS, NaiveConfig())(features) is features
