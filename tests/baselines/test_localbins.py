from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import timm
import torch

import zoedepth
from zoedepth.build import build_model
from zoedepth.config import INDOOR, OUTDOOR, BaselineConfig, LocalBinsNetworkConfig
from zoedepth.data.sample import Batch
from zoedepth.errors import InputError
from zoedepth.model.interface import DepthModel
from zoedepth.presets import ZOED_LITE
from zoedepth.train.config import TrainConfig
from zoedepth.train.metric import metric_losses
from zoedepth.weights.load import load_model

TINY = BaselineConfig(LocalBinsNetworkConfig("tf_efficientnet_lite0", n_seed_bins=2, n_windows=4), size=(64, 96))
ENCODER = TINY.network.encoder


@cache
def _weights() -> dict[str, torch.Tensor]:
    torch.manual_seed(0)
    return build_model(TINY).state_dict()


def build(config: BaselineConfig = TINY) -> DepthModel:
    """A random model with the weights every other has that is like it."""
    with torch.device("meta"):
        model = build_model(config)
    model.load_state_dict({name: value.clone() for name, value in _weights().items()}, assign=True)
    return model.train()


def batch_of(size: tuple[int, int], *, n: int = 2) -> Batch:
    """Noise, and depths that rise to the right from 1 m to 8 m."""
    pixels = torch.rand(n, 3, *size, generator=torch.Generator().manual_seed(0))
    target = torch.linspace(1, 8, size[1]).expand(n, 1, *size)
    none = torch.zeros(n, dtype=torch.long)
    return Batch(pixels, target, torch.ones(n, 1, *size, dtype=torch.bool), none, none, ["?"] * n, "depth")


def loss_of(model: DepthModel, batch: Batch) -> dict[str, torch.Tensor]:
    """The terms of its loss."""
    return metric_losses(model(batch.pixels), batch, TrainConfig("metric", ZOED_LITE, (), steps=1))


def test_it_has_the_published_number_of_parameters():
    with torch.device("meta"):
        model = build_model(BaselineConfig(LocalBinsNetworkConfig()))
    n_parameters = sum(p.numel() for p in model.parameters())
    assert n_parameters == 73_544_872
    assert n_parameters == pytest.approx(74e6, rel=0.03)


def test_its_bins_are_sixteen_times_the_seed_bins():
    for n_seed_bins, n_bins in ((8, 128), (16, 256)):
        with torch.device("meta"):
            model = build_model(BaselineConfig(LocalBinsNetworkConfig(n_seed_bins=n_seed_bins)))
        assert model.probability.out_channels == n_bins
        assert [splitter[-1].out_channels for splitter in model.bins.splitters] == [
            n_bins // 2**i for i in (3, 2, 1, 0)
        ]


@torch.no_grad()
@pytest.mark.parametrize("size", [(32, 32), (64, 96), (160, 32)])
def test_any_size_gives_metres_in_the_range_of_its_domain(size: tuple[int, int]):
    for domain in (INDOOR, OUTDOOR):
        model = build(replace(TINY, domains=(domain,))).eval()
        output = model(batch_of(size).pixels, return_std=True, return_bins=True)
        assert output.depth.shape == output.std.shape == (2, 1, *size)
        assert output.probability.shape == output.bin_centers.shape == (2, 32, *size)
        for metres in (output.depth, output.bin_centers):
            assert (metres >= domain.min_depth - 1e-5).all()
            assert (metres <= domain.max_depth + 1e-4).all()
        assert (output.bin_centers.diff(dim=1) > 0).all()
        assert output.relative is output.domain_logits is None


def test_a_batch_trains_every_parameter():
    model, batch = build(), batch_of((64, 96), n=3)
    torch.manual_seed(0)
    torch.stack(list(loss_of(model, batch).values())).sum().backward()
    without = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert without == []
    assert all(p.grad.isfinite().all() for p in model.parameters())


def test_loss_falls_on_one_batch():
    model, batch = build(), batch_of((64, 64))
    optimizer = torch.optim.AdamW(model.parameters(), lr=3e-4)
    values = []
    for _ in range(6):
        torch.manual_seed(0)  # the same windows
        terms = loss_of(model, batch)
        assert set(terms) == {"silog", "window_chamfer"}
        optimizer.zero_grad()
        torch.stack(list(terms.values())).sum().backward()
        optimizer.step()
        values.append({name: term.item() for name, term in terms.items()})
    for name in ("silog", "window_chamfer"):
        assert values[-1][name] < 0.95 * values[0][name], name


def test_windows_come_while_training_and_where_asked_for():
    pixels = batch_of((64, 96)).pixels
    boxes, centers = build()(pixels).supervision.window_bins
    assert boxes.shape == (2, 20, 4)
    assert [x.shape for x in centers] == [(2, 20, n) for n in (4, 8, 16, 32)]
    assert build().eval()(pixels).supervision.window_bins is None
    without = replace(TINY, network=replace(TINY.network, n_windows=0))
    assert build(without)(pixels).supervision.window_bins is None


@torch.no_grad()
def test_every_bin_of_the_public_code_is_where_the_next_one_should_be():
    """But for the nearest depth, 1 mm; and the last ends at the farthest depth, as wide as the nearest."""
    pixels = batch_of((64, 96)).pixels
    public = replace(TINY, network=replace(TINY.network, front_padding=False))
    right, shifted = (build(config).eval()(pixels, return_bins=True) for config in (TINY, public))
    assert torch.allclose(shifted.bin_centers[:, :-1], right.bin_centers[:, 1:] - 1e-3, atol=1e-4)
    assert torch.allclose(shifted.bin_centers[:, -1], torch.tensor(10.0 - 0.0005), atol=1e-4)
    assert torch.equal(right.probability, shifted.probability)


def test_windows_of_the_public_code_have_its_bins_as_well():
    public = replace(TINY, network=replace(TINY.network, front_padding=False))
    right, shifted = [], []
    for config, levels in ((TINY, right), (public, shifted)):
        torch.manual_seed(0)  # the same windows
        levels += build(config)(batch_of((64, 96)).pixels).supervision.window_bins.centers
    for wanted, found in zip(right, shifted, strict=True):
        assert torch.allclose(found[..., :-1], wanted[..., 1:] - 1e-3, atol=1e-4)


@torch.no_grad()
def test_half_precision_is_finite_and_close():
    model, pixels = build().eval(), batch_of((64, 96)).pixels
    exact = model(pixels)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        output = model(pixels, return_bins=True)
    assert output.depth.dtype == output.bin_centers.dtype == output.probability.dtype == torch.float32
    assert output.depth.isfinite().all()
    assert ((output.depth - exact.depth).abs() / exact.depth).mean() < 0.05


@torch.no_grad()
def test_it_is_saved_and_loaded(tmp_path: Path):
    model, pixels = build().eval(), batch_of((64, 96)).pixels
    zoedepth.save_model(model, tmp_path / "localbins.safetensors")
    loaded = load_model(tmp_path / "localbins.safetensors")
    assert loaded.config == TINY
    assert torch.equal(loaded(pixels).depth, model(pixels).depth)


@torch.no_grad()
def test_images_do_not_see_each_other():
    model, pixels = build().eval(), batch_of((64, 96), n=3).pixels
    together = model(pixels).depth
    for i in range(3):
        assert torch.allclose(model(pixels[i : i + 1]).depth, together[i : i + 1], atol=1e-4)


def test_encoder_takes_the_weights_of_timms_network():
    model = build()
    torch.manual_seed(1)
    network = timm.create_model(ENCODER, pretrained=False)
    model.encoder.load_timm(network)
    assert torch.equal(model.encoder.state_dict()["network.conv_head.weight"], network.conv_head.weight)


def test_config_refuses_what_makes_no_bins():
    with pytest.raises(InputError, match=r"network\.n_seed_bins must be at least 2"):
        LocalBinsNetworkConfig(n_seed_bins=1)
    with pytest.raises(InputError, match=r"network\.n_windows must be at least 0"):
        LocalBinsNetworkConfig(n_windows=-1)
