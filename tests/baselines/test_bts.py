from dataclasses import replace

import pytest
import timm
import torch
from tests.baselines.base import ENCODER, BaselineTester, build, n_parameters, photos

from zoedepth.baselines.bts import BtsDecoder, DenseAspp, DenseNetEncoder
from zoedepth.build import without_memory
from zoedepth.config import INDOOR, BaselineConfig, BtsNetworkConfig

TINY = BaselineConfig(BtsNetworkConfig(ENCODER, width=128), size=(64, 96))


class TestBts(BaselineTester):
    TINY = TINY
    HAS_BINS = False
    BOUNDED = False


def test_it_has_the_published_number_of_parameters():
    n = n_parameters(BaselineConfig(BtsNetworkConfig()))
    assert n == 47_000_688
    assert n == pytest.approx(47.0e6, rel=0.001)
    assert n_parameters(BaselineConfig(BtsNetworkConfig("resnet50"))) == 47_481_968


@torch.no_grad()
def test_depth_follows_the_range_and_the_focal_length():
    pixels = photos(TINY)
    depth = build(TINY)(pixels).depth
    network = replace(TINY.network, focal_px=2 * 715.0873)
    far = build(replace(TINY, network=network, domains=(replace(INDOOR, max_depth=80.0),)), weights_of=TINY)
    assert torch.allclose(far(pixels).depth, 16 * depth)


def test_densenet_takes_the_weights_of_timms_network_and_can_save_memory():
    torch.manual_seed(1)
    encoder = DenseNetEncoder("densenet121").eval()
    network = timm.create_model("densenet121", pretrained=False).eval()
    encoder.load_timm(network)
    pixels = torch.rand(1, 3, 32, 32)
    maps = encoder(pixels)
    assert [pixels.shape[-1] // x.shape[-1] for x in maps] == [2, 4, 8, 16, 32] == list(encoder.strides)
    assert [x.shape[1] for x in maps] == list(encoder.channels)
    assert torch.allclose(maps[-1], network.forward_features(pixels), atol=1e-5)
    encoder.checkpoint_gradients()
    assert torch.allclose(encoder(pixels.requires_grad_())[-1], maps[-1], atol=1e-5)
    assert any(getattr(module, "grad_checkpointing", False) for module in encoder.modules())


def test_densenets_maps_are_those_of_bts():
    with without_memory():
        encoder = DenseNetEncoder("densenet161")
        maps = encoder(torch.empty(1, 3, 64, 64))
    assert encoder.channels == (96, 96, 192, 384, 2208)
    assert [tuple(x.shape[1:]) for x in maps] == [(96, 32, 32), (96, 16, 16), (192, 8, 8), (384, 4, 4), (2208, 2, 2)]


def test_each_dilated_branch_sees_those_before_it():
    """Weights of all branches but two are zeroed: what the later one gives changes with the earlier one."""
    torch.manual_seed(0)
    aspp = DenseAspp(8, 4, 4).eval()
    joined = 8 + 4
    assert [branch[2].in_channels for branch in aspp.branches] == [8, *(joined + 4 * i for i in (1, 2, 3, 4))]
    assert [branch[5].dilation[0] for branch in aspp.branches] == [3, 6, 12, 18, 24]
    x, skip = torch.randn(1, 8, 6, 6), torch.randn(1, 12, 6, 6)
    before = aspp(x, skip)
    for i, branch in enumerate(aspp.branches):
        with torch.no_grad():
            branch[5].weight.mul_(2)
        after = aspp(x, skip)
        assert not torch.equal(after, before), f"branch {i} matters"
        before = after
    assert before.shape == (1, 4, 6, 6)


def test_decoder_starts_with_xavier_weights_and_slow_statistics():
    torch.manual_seed(0)
    decoder = BtsDecoder((16, 24, 32, 48, 64), width=128)
    weight = decoder.fuse16[0].weight
    bound = (6 / (9 * (weight.shape[0] + weight.shape[1]))) ** 0.5
    assert bound * 0.99 < weight.abs().max() <= bound
    norms = [module for module in decoder.modules() if isinstance(module, torch.nn.BatchNorm2d)]
    assert all(norm.momentum == 0.01 for norm in norms)
    assert sorted({norm.eps for norm in norms}) == [1e-5, 1.1e-5]
