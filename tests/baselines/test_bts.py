from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import timm
import torch

import zoedepth
from zoedepth.baselines.bts import DenseAspp, DenseNetEncoder
from zoedepth.build import build_model
from zoedepth.config import INDOOR, BaselineConfig, BtsNetworkConfig
from zoedepth.errors import InputError
from zoedepth.losses import silog
from zoedepth.model.interface import DepthModel
from zoedepth.weights.load import load_model

TINY = BaselineConfig(BtsNetworkConfig("tf_efficientnet_lite0", width=128), size=(64, 96))


@cache
def _weights() -> dict[str, torch.Tensor]:
    torch.manual_seed(0)
    return build_model(TINY).state_dict()


def build(config: BaselineConfig = TINY) -> DepthModel:
    """A random model, in training mode, always of the same weights."""
    with torch.device("meta"):
        model = build_model(config)
    model.load_state_dict({name: value.clone() for name, value in _weights().items()}, assign=True)
    return model.train()


def noise(size: tuple[int, int], *, n: int = 2) -> torch.Tensor:
    return torch.rand(n, 3, *size, generator=torch.Generator().manual_seed(0))


def count(network: BtsNetworkConfig) -> int:
    with torch.device("meta"):
        model = build_model(BaselineConfig(network))
    return sum(p.numel() for p in model.parameters())


def test_it_has_the_published_number_of_parameters():
    assert count(BtsNetworkConfig()) == 47_000_688
    assert count(BtsNetworkConfig()) == pytest.approx(47.0e6, rel=0.001)
    assert count(BtsNetworkConfig("resnet50")) == 47_481_968


@torch.no_grad()
@pytest.mark.parametrize("size", [(32, 32), (64, 96), (160, 32)])
def test_any_size_gives_metres_up_to_the_farthest(size: tuple[int, int]):
    output = build().eval()(noise(size), return_std=True, return_bins=True)
    assert output.depth.shape == (2, 1, *size)
    assert output.depth.dtype == torch.float32
    assert ((output.depth > 0) & (output.depth < INDOOR.max_depth)).all()
    assert output.std is output.bin_centers is output.probability is output.relative is None


def test_a_batch_trains_every_parameter():
    model = build()
    depth = model(noise((64, 96), n=3)).depth
    target = torch.linspace(1, 8, 96).expand_as(depth)
    silog(depth, target, torch.ones_like(target, dtype=torch.bool)).backward()
    without = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert without == []
    assert all(p.grad.isfinite().all() for p in model.parameters())


@torch.no_grad()
def test_depth_follows_the_range_and_the_focal_length():
    pixels = noise((64, 64))
    depth = build().eval()(pixels).depth
    network = replace(TINY.network, focal_px=2 * 715.0873)
    far = build(replace(TINY, network=network, domains=(replace(INDOOR, max_depth=80.0),))).eval()
    assert torch.allclose(far(pixels).depth, 16 * depth)


@torch.no_grad()
def test_half_precision_is_finite_and_close():
    model, pixels = build().eval(), noise((64, 96))
    exact = model(pixels).depth
    with torch.autocast("cpu", dtype=torch.bfloat16):
        depth = model(pixels).depth
    assert depth.dtype == torch.float32
    assert ((depth - exact).abs() / exact).mean() < 0.05


@torch.no_grad()
def test_images_do_not_see_each_other():
    model, pixels = build().eval(), noise((64, 96), n=3)
    together = model(pixels).depth
    for i in range(3):
        assert torch.allclose(model(pixels[i : i + 1]).depth, together[i : i + 1], atol=1e-4)


@torch.no_grad()
def test_it_is_saved_and_loaded(tmp_path: Path):
    model, pixels = build().eval(), noise((64, 96))
    zoedepth.save_model(model, tmp_path / "bts.safetensors")
    loaded = load_model(tmp_path / "bts.safetensors")
    assert loaded.config == TINY
    assert torch.equal(loaded(pixels).depth, model(pixels).depth)


@pytest.mark.parametrize("name", ["densenet121", "tf_efficientnet_lite0"])
def test_encoder_takes_the_weights_of_timms_network_and_can_save_memory(name: str):
    torch.manual_seed(1)
    encoder = build_model(replace(TINY, network=replace(TINY.network, encoder=name))).encoder.eval()
    network = timm.create_model(name, pretrained=False).eval()
    encoder.load_timm(network)
    pixels = noise((32, 32))
    maps = encoder(pixels)
    assert [pixels.shape[-1] // x.shape[-1] for x in maps] == [2, 4, 8, 16, 32] == list(encoder.strides)
    assert [x.shape[1] for x in maps] == list(encoder.channels)
    if name == "densenet121":
        assert torch.allclose(maps[-1], network.forward_features(pixels), atol=1e-5)
    encoder.checkpoint_gradients()
    again = encoder(pixels.requires_grad_())
    assert torch.allclose(again[-1], maps[-1], atol=1e-5)
    assert any(getattr(module, "grad_checkpointing", False) for module in encoder.modules())


def test_densenets_maps_are_those_of_bts():
    with torch.device("meta"):
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
    decoder = build_model(TINY).decoder
    weight = decoder.fuse16[0].weight
    bound = (6 / (9 * (weight.shape[0] + weight.shape[1]))) ** 0.5
    assert bound * 0.99 < weight.abs().max() <= bound
    norms = [module for module in decoder.modules() if isinstance(module, torch.nn.BatchNorm2d)]
    assert all(norm.momentum == 0.01 for norm in norms)
    assert sorted({norm.eps for norm in norms}) == [1e-5, 1.1e-5]


def test_config_refuses_what_makes_no_decoder():
    with pytest.raises(InputError, match=r"network\.width must be a multiple of 32, 128 or more"):
        BtsNetworkConfig(width=100)
    with pytest.raises(InputError, match=r"network\.focal_px must be more than 0"):
        BtsNetworkConfig(focal_px=0.0)
