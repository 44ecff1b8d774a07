from collections import Counter

import pytest
import timm
import torch
from torch import nn

from zoedepth.build import without_memory
from zoedepth.model.timm_encoder import FeatureEncoder, create_network, replace_depthwise


@torch.no_grad()
@pytest.mark.parametrize(
    ("name", "levels", "options"),
    [
        ("tf_efficientnet_lite0", (1, 2, 3, 4), {}),
        ("convnext_atto", (-4, -3, -2, -1), {}),
        ("swin_tiny_patch4_window7_224", (0, 1, 2, 3), {"img_size": 64, "embed_dim": 24, "num_heads": (1, 2, 4, 8)}),
    ],
)
def test_maps_are_those_of_timms_network_channels_first(name: str, levels: tuple[int, ...], options: dict):
    torch.manual_seed(0)
    encoder = FeatureEncoder(name, levels=levels, options=options).eval()
    network = timm.create_model(name, pretrained=False, **options).eval()
    encoder.load_timm(network)
    pixels = torch.rand(2, 3, 64, 64)
    maps = encoder(pixels)
    assert encoder.strides == (4, 8, 16, 32)
    assert [tuple(x.shape) for x in maps] == [
        (2, channels, 64 // stride, 64 // stride)
        for channels, stride in zip(encoder.channels, encoder.strides, strict=True)
    ]
    expected = timm.create_model(name, pretrained=False, features_only=True, out_indices=levels, **options).eval()
    expected.load_state_dict(encoder.stages.state_dict())
    for x, y in zip(maps, expected(pixels), strict=True):
        assert torch.allclose(x, y if y.shape == x.shape else y.permute(0, 3, 1, 2), atol=1e-5)


@pytest.mark.parametrize("name", ["convnext_atto", "tf_efficientnet_lite0"])
def test_checkpointed_gradients_are_the_same_and_nothing_is_computed_three_times(name: str):
    """The one network has stages that can do it; the other does it as a whole."""
    torch.manual_seed(0)
    encoder = FeatureEncoder(name, levels=(-2, -1)).eval()
    pixels, gradients, calls = torch.rand(1, 3, 32, 32), [], Counter()
    for convolution in (module for module in encoder.modules() if isinstance(module, nn.Conv2d)):
        convolution.register_forward_pre_hook(lambda module, _: calls.update([module]))
    for most in (1, 2):
        encoder.zero_grad()
        calls.clear()
        encoder(pixels)[-1].square().mean().backward()
        gradients.append([p.grad.clone() for p in encoder.parameters() if p.grad is not None])
        assert max(calls.values()) == most
        encoder.checkpoint_gradients()
    assert calls.total() > 1.5 * len(calls)
    for one, other in zip(*gradients, strict=True):
        assert torch.allclose(one, other, atol=1e-6)


def test_depthwise_convolutions_train_in_float32_and_no_others():
    torch.manual_seed(0)
    depthwise = nn.Conv2d(2, 2, 3, stride=2, padding=3, dilation=2, groups=2, bias=False)
    network = nn.Sequential(depthwise, nn.Conv2d(4, 4, 3), nn.Conv2d(1, 1, 3))
    x = torch.randn(2, 2, 8, 8)
    with torch.no_grad():
        expected = network[0](x)
    replace_depthwise(network)
    assert [type(layer) is nn.Conv2d for layer in network] == [False, True, True]
    assert torch.allclose(network[0](x), expected)
    with torch.autocast("cpu", torch.bfloat16):
        assert network[0](x).dtype == torch.float32
        assert network.eval()[0](x).dtype == torch.bfloat16


def test_every_network_has_its_depthwise_convolutions_replaced():
    with without_memory():
        network = create_network("tf_efficientnet_lite0", num_classes=0)
    depthwise = [m for m in network.modules() if isinstance(m, nn.Conv2d) and m.groups == m.in_channels > 1]
    assert len(depthwise) == 16
    assert not any(type(m).__module__.startswith(("torch", "timm")) for m in depthwise)
