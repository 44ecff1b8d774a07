from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import timm
import torch

import zoedepth
from zoedepth.build import build_model
from zoedepth.config import INDOOR, OUTDOOR, BaselineConfig, DornNetworkConfig
from zoedepth.errors import InputError
from zoedepth.losses import ordinal
from zoedepth.model.heads.dorn import interval_edges
from zoedepth.model.interface import DepthModel
from zoedepth.weights.load import load_model

SIZE = (65, 97)
TINY = BaselineConfig(DornNetworkConfig("tf_efficientnet_lite0", n_intervals=10, rates=(1, 2, 3), pooling=4), size=SIZE)


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


def noise(*, n: int = 2) -> torch.Tensor:
    return torch.rand(n, 3, *SIZE, generator=torch.Generator().manual_seed(0))


def on_meta(network: DornNetworkConfig, size: tuple[int, int]) -> DepthModel:
    with torch.device("meta"):
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
    pool = build().decoder[0].full_image[0]
    x = torch.arange(6.0)[None, None, None].repeat(1, 1, 5, 1)
    x[..., 4, :] += 100
    # 4 x 4 cells: columns 0-3 and 4-5, rows 0-3 and 4.
    assert pool(x)[0, 0].tolist() == [[1.5, 4.5], [101.5, 104.5]]


@torch.no_grad()
@pytest.mark.parametrize("decode", ["hard", "soft"])
def test_depth_is_metres_in_the_range_of_its_domain(decode: str):
    for domain in (INDOOR, OUTDOOR):
        network = replace(TINY.network, decode=decode)
        output = build(replace(TINY, network=network, domains=(domain,))).eval()(noise(), return_std=True)
        assert output.depth.shape == (2, 1, *SIZE)
        assert output.depth.dtype == torch.float32
        assert ((output.depth > domain.min_depth) & (output.depth < domain.max_depth)).all()
        assert output.std is output.relative is None
        logits, edges = output.supervision.ordinal
        assert logits.shape == (2, 10, *SIZE)
        expected = interval_edges(domain.min_depth, domain.max_depth, 10, spacing="increasing")
        assert torch.allclose(edges, torch.tensor(expected).expand(2, -1))
        middles = (edges[0, 1:] + edges[0, :-1]) / 2
        assert (decode == "hard") == torch.isin(output.depth, middles).all().item()


def test_it_takes_its_own_size_only():
    with pytest.raises(InputError, match=r"\(65, 97\) only"):
        build()(torch.rand(1, 3, 64, 96))


def loss_of(model: DepthModel, pixels: torch.Tensor) -> torch.Tensor:
    """Of depths that rise to the right from 0.1 m to 9 m."""
    target = torch.linspace(0.1, 9, SIZE[1]).expand(len(pixels), 1, *SIZE)
    return ordinal(*model(pixels).supervision.ordinal, target, torch.ones_like(target, dtype=torch.bool))


def test_a_batch_trains_every_parameter():
    model = build()
    torch.manual_seed(0)
    loss_of(model, noise(n=3)).backward()
    without = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert without == []
    assert all(p.grad.isfinite().all() for p in model.parameters())


def test_loss_falls_on_one_batch():
    model, pixels = build(), noise()
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-4)
    values = []
    for _ in range(5):
        torch.manual_seed(0)  # the same dropout
        loss = loss_of(model, pixels)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        values.append(loss.item())
    assert values[-1] < 0.8 * values[0]


@torch.no_grad()
def test_half_precision_is_finite_and_close():
    model, pixels = build(replace(TINY, network=replace(TINY.network, decode="soft"))).eval(), noise()
    exact = model(pixels)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        output = model(pixels)
    assert output.depth.dtype == output.supervision.ordinal.logits.dtype == torch.float32
    assert ((output.depth - exact.depth).abs() / exact.depth).mean() < 0.05


@torch.no_grad()
def test_it_is_saved_and_loaded(tmp_path: Path):
    model, pixels = build().eval(), noise()
    zoedepth.save_model(model, tmp_path / "dorn.safetensors")
    loaded = load_model(tmp_path / "dorn.safetensors")
    assert loaded.config == TINY
    assert torch.equal(loaded(pixels).depth, model(pixels).depth)


@torch.no_grad()
def test_images_do_not_see_each_other():
    model, pixels = build().eval(), noise(n=3)
    together = model(pixels).supervision.ordinal.logits
    for i in range(3):
        alone = model(pixels[i : i + 1]).supervision.ordinal.logits
        assert torch.allclose(alone, together[i : i + 1], atol=1e-4)


@torch.no_grad()
def test_dilated_encoder_is_timms_with_an_output_stride():
    """And takes the weights of timm's network without."""
    model = build().eval()
    torch.manual_seed(1)
    network = timm.create_model("tf_efficientnet_lite0", pretrained=False).eval()
    model.encoder.load_timm(network)
    dilated = timm.create_model(
        "tf_efficientnet_lite0", pretrained=False, features_only=True, out_indices=(4,), output_stride=8
    ).eval()
    dilated.load_state_dict(model.encoder.stages.state_dict())
    x = noise()
    assert torch.allclose(model.encoder(x)[0], dilated(x)[0], atol=1e-5)
    assert torch.equal(model.encoder.stages.conv_stem.weight, network.conv_stem.weight)
    assert model.encoder(x)[0].shape == (2, 320, 9, 13)


def test_config_refuses_what_makes_no_network():
    for name, value in (("n_intervals", 1), ("rates", (0, 1, 2)), ("pooling", 0)):
        with pytest.raises(InputError, match=rf"network\.{name} must be"):
            replace(DornNetworkConfig(), **{name: value})
