import pytest
import timm
import torch

from zoedepth.baselines.unet import EfficientNetEncoder, UNetDecoder
from zoedepth.build import without_memory
from zoedepth.errors import InputError

ENCODER = "test_efficientnet"


def test_maps_of_b5_are_those_of_the_originals():
    with without_memory():
        encoder = EfficientNetEncoder("tf_efficientnet_b5")
        maps = encoder(torch.empty(1, 3, 64, 96))
    assert encoder.channels == (24, 40, 64, 176, 2048)
    assert [tuple(x.shape) for x in maps] == [
        (1, channels, 64 // stride, 96 // stride)
        for channels, stride in zip(encoder.channels, (2, 4, 8, 16, 32), strict=True)
    ]


@torch.no_grad()
def test_coarsest_map_is_that_of_timms_network_before_its_last_norm():
    torch.manual_seed(0)
    network = timm.create_model(ENCODER, pretrained=False).eval()
    encoder = EfficientNetEncoder(ENCODER).eval()
    encoder.load_timm(network)
    x = torch.randn(1, 3, 64, 96)
    *maps, last = encoder(x)
    assert torch.allclose(network.bn2(last), network.forward_features(x), atol=1e-5)
    wanted = timm.create_model(ENCODER, pretrained=False, features_only=True).eval()
    wanted.load_state_dict({name: network.state_dict()[name] for name in wanted.state_dict()})
    for ours, theirs in zip(maps, wanted(x), strict=False):
        assert torch.allclose(ours, theirs, atol=1e-5)


def test_other_networks_are_refused():
    with pytest.raises(InputError, match="must be an EfficientNet with maps at strides"):
        EfficientNetEncoder("resnet18")


@torch.no_grad()
@pytest.mark.parametrize("slim", [False, True])
def test_decoder_halves_channels_and_doubles_sides(slim: bool):
    decoder = UNetDecoder((2, 3, 4, 5, 32), features=6, slim=slim).eval()
    maps = [torch.randn(1, c, 64 // s, 96 // s) for c, s in zip((2, 3, 4, 5, 32), (2, 4, 8, 16, 32), strict=True)]
    found = decoder(maps)
    # The first convolution's padding frames its map.
    assert found.bottleneck.shape == (1, 32, 2 + 2, 3 + 2)
    assert torch.equal(found.bottleneck[0, :, 0, 0], decoder.bottleneck.bias)
    assert [tuple(x.shape) for x in found.levels] == [(1, 16, 4, 6), (1, 8, 8, 12), (1, 4, 16, 24), (1, 2, 32, 48)]
    assert found.last.shape == (1, 6, 32, 48)
    assert (decoder.channels.bottleneck, decoder.channels.levels, decoder.channels.last) == (32, (16, 8, 4, 2), 6)
    first, second = decoder.levels[0].convs[0], decoder.levels[0].convs[3]
    assert (first.bias is None, second.bias is None, second.kernel_size) == (slim, slim, (1, 1) if slim else (3, 3))


@torch.no_grad()
def test_without_last_convolution_the_finest_level_is_the_last():
    decoder = UNetDecoder((2, 3, 4, 5, 32)).eval()
    found = decoder(
        [torch.randn(1, c, 64 // s, 64 // s) for c, s in zip((2, 3, 4, 5, 32), (2, 4, 8, 16, 32), strict=True)]
    )
    assert found.last is found.levels[-1]
