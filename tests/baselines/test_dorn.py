from dataclasses import replace
from typing import ClassVar

import pytest
import timm
import torch
from tests.baselines.base import ENCODER, BaselineTester, build, photos

from zoedepth.build import build_model, without_memory
from zoedepth.config import INDOOR, OUTDOOR, BaselineConfig, DornNetworkConfig
from zoedepth.model.heads.dorn import interval_edges
from zoedepth.model.interface import DepthModel

SIZE = (65, 97)
TINY = BaselineConfig(DornNetworkConfig(ENCODER, n_intervals=10, rates=(1, 2, 3), pooling=4), size=SIZE)


class TestDorn(BaselineTester):
    TINY = TINY
    HAS_BINS = False
    TERMS: ClassVar[set[str]] = {"ordinal"}


def on_meta(network: DornNetworkConfig, size: tuple[int, int]) -> DepthModel:
    with without_memory():
        return build_model(BaselineConfig(network, size=size))


def test_it_has_the_published_number_of_parameters():
    """The release has a softmax over two logits an interval: 68 or 71 times 2049 more."""
    nyu = sum(p.numel() for p in on_meta(DornNetworkConfig(), (257, 353)).parameters())
    assert nyu == 110_141_444
    assert nyu == pytest.approx(110e6, rel=0.01)
    kitti = on_meta(DornNetworkConfig(n_intervals=71, rates=(6, 12, 18), pooling=16), (385, 513))
    assert sum(p.numel() for p in kitti.parameters()) == 99_661_831


def test_encoder_is_dorns_resnet():
    """Three convolutions first, stride 8 at the end, the last two stages dilated from their first block on."""
    model = on_meta(DornNetworkConfig(), (257, 353)).eval()
    stages = model.encoder.stages
    assert [layer.out_channels for layer in stages.conv1 if isinstance(layer, torch.nn.Conv2d)] == [64, 64, 128]
    for stage, stride, dilation in ((stages.layer2, 2, 1), (stages.layer3, 1, 2), (stages.layer4, 1, 4)):
        assert stage[0].conv2.stride == (stride, stride)
        assert {(block.conv2.dilation, block.conv2.padding) for block in stage} == {((dilation,) * 2,) * 2}
    (features,) = model.encoder(torch.empty(1, 3, 257, 353, device="meta"))
    assert features.shape == (1, 2048, 33, 45)
    assert model.decoder[0].full_image[0](features).shape[-2:] == (5, 6)
    assert [branch.dilation[0] for branch in model.decoder[0].branches] == [1, 4, 8, 12]


def test_averages_of_the_full_image_round_up_and_count_what_is_there():
    pool = build(TINY).decoder[0].full_image[0]
    x = torch.arange(6.0)[None, None, None].repeat(1, 1, 5, 1)
    x[..., 4, :] += 100
    # 4 x 4 cells: columns 0-3 and 4-5, rows 0-3 and 4.
    assert pool(x)[0, 0].tolist() == [[1.5, 4.5], [101.5, 104.5]]


@torch.no_grad()
@pytest.mark.parametrize("decode", ["hard", "soft"])
def test_depth_is_metres_in_the_range_of_its_domain(decode: str):
    for domain in (INDOOR, OUTDOOR):
        network = replace(TINY.network, decode=decode)
        output = build(replace(TINY, network=network, domains=(domain,)), weights_of=TINY)(photos(TINY))
        assert ((output.depth > domain.min_depth) & (output.depth < domain.max_depth)).all()
        logits, edges = output.supervision.ordinal
        assert logits.shape == (2, 10, *SIZE)
        expected = interval_edges(domain.min_depth, domain.max_depth, 10, spacing="increasing")
        assert torch.allclose(edges, torch.tensor(expected).expand(2, -1))
        middles = (edges[0, 1:] + edges[0, :-1]) / 2
        assert (decode == "hard") == torch.isin(output.depth, middles).all().item()


@torch.no_grad()
def test_dilated_encoder_is_timms_with_an_output_stride():
    """And takes the weights of timm's network without."""
    model = build(TINY)
    torch.manual_seed(1)
    network = timm.create_model(ENCODER, pretrained=False).eval()
    model.encoder.load_timm(network)
    dilated = timm.create_model(ENCODER, pretrained=False, features_only=True, out_indices=(4,), output_stride=8).eval()
    dilated.load_state_dict(model.encoder.stages.state_dict())
    x = photos(TINY)
    assert torch.allclose(model.encoder(x)[0], dilated(x)[0], atol=1e-5)
    assert torch.equal(model.encoder.stages.conv_stem.weight, network.conv_stem.weight)
    assert model.encoder(x)[0].shape == (2, 64, 9, 13)
