"""What every baseline does alike: sizes, ranges, gradients, half precision, files, ImageNet weights, training."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import timm
import torch

import zoedepth
from zoedepth.baselines import BASELINES
from zoedepth.build import build_model
from zoedepth.config import (
    INDOOR,
    OUTDOOR,
    AdaBinsNetworkConfig,
    BaselineConfig,
    BtsNetworkConfig,
    DornNetworkConfig,
    LocalBinsNetworkConfig,
    NewCrfsNetworkConfig,
    PixelBinsNetworkConfig,
)
from zoedepth.data.sample import Batch
from zoedepth.errors import InputError
from zoedepth.model.interface import DepthModel
from zoedepth.presets import ZOED_LITE
from zoedepth.train.config import TrainConfig
from zoedepth.train.metric import metric_losses
from zoedepth.weights.load import load_model

ENCODER = "tf_efficientnet_lite0"
CRFS = {"widths": (32, 16, 16, 8), "attention_heads": (4, 2, 2, 1), "seed_width": 16}
CONFIGS = {
    "bts": BaselineConfig(BtsNetworkConfig(ENCODER, width=128), size=(64, 96)),
    "adabins": BaselineConfig(AdaBinsNetworkConfig(ENCODER, n_bins=16), size=(64, 96)),
    "localbins": BaselineConfig(LocalBinsNetworkConfig(ENCODER, n_seed_bins=2, n_windows=3), size=(64, 96)),
    "pixelbins": BaselineConfig(PixelBinsNetworkConfig(ENCODER, n_bins=16), size=(64, 96)),
    "newcrfs": BaselineConfig(NewCrfsNetworkConfig(ENCODER, **CRFS), size=(64, 96)),
    "dorn": BaselineConfig(DornNetworkConfig(ENCODER, n_intervals=10), size=(65, 97)),
}
EVERY = pytest.mark.parametrize("name", CONFIGS)


@cache
def _weights(name: str) -> dict[str, torch.Tensor]:
    torch.manual_seed(0)
    return build_model(CONFIGS[name]).state_dict()


def build(name: str, config: BaselineConfig | None = None) -> DepthModel:
    """A random one, in evaluation mode."""
    model = build_model(config or CONFIGS[name])
    model.load_state_dict(_weights(name))
    return model.eval()


def photos(name: str, n: int = 2) -> torch.Tensor:
    return torch.rand(n, 3, *CONFIGS[name].size, generator=torch.Generator().manual_seed(0))


def test_all_of_them_are_here():
    assert {type(config.network) for config in CONFIGS.values()} == set(BASELINES)


@EVERY
@torch.no_grad()
def test_depth_is_metres_in_the_range_of_its_domain_at_the_size_of_the_photo(name: str):
    for domain in (INDOOR, OUTDOOR):
        model = build(name, replace(CONFIGS[name], domains=(domain,)))
        output = model(photos(name), return_std=True)
        assert output.depth.shape == (2, 1, *CONFIGS[name].size)
        assert output.depth.isfinite().all()
        assert (output.depth > 0).all()
        assert (output.depth <= domain.max_depth + 1e-3).all()
        assert output.domain.tolist() == [0, 0]
        assert output.relative is output.domain_logits is None
        assert (output.std is not None) == (name in ("adabins", "localbins", "pixelbins"))


@EVERY
@torch.no_grad()
def test_any_size_it_may_be_given(name: str):
    model = build(name)
    for size in [(32, 32), (160, 64), (64, 224)]:
        pixels = torch.rand(1, 3, *size)
        if CONFIGS[name].one_size:
            with pytest.raises(InputError, match=r"takes pixels of \(65, 97\) only"):
                model(pixels)
        else:
            assert model(pixels).depth.shape == (1, 1, *size)
    with pytest.raises(InputError, match="the baselines"):
        model.relative(photos(name))


@EVERY
@torch.no_grad()
def test_images_do_not_see_each_other(name: str):
    model, pixels = build(name), photos(name, 3)
    together = model(pixels).depth
    for i in range(3):
        assert torch.allclose(model(pixels[i : i + 1]).depth, together[i : i + 1], rtol=1e-3, atol=1e-3)


@EVERY
@torch.no_grad()
def test_half_precision_is_finite_and_close(name: str):
    model, pixels = build(name), photos(name)
    exact = model(pixels).depth
    with torch.autocast("cpu", dtype=torch.bfloat16):
        depth = model(pixels).depth
    assert depth.dtype == torch.float32
    assert depth.isfinite().all()
    assert ((depth - exact).abs() / exact).mean() < 0.1


@EVERY
@torch.no_grad()
def test_it_is_saved_and_loaded(name: str, tmp_path: Path):
    model, pixels = build(name), photos(name)
    zoedepth.save_model(model, tmp_path / "model.safetensors")
    loaded = load_model(tmp_path / "model.safetensors")
    assert loaded.config == CONFIGS[name]
    assert torch.equal(loaded(pixels).depth, model(pixels).depth)
    photo = (255 * pixels[0].permute(1, 2, 0)).byte().numpy()
    assert zoedepth.Predictor(loaded)(photo).depth.shape == CONFIGS[name].size


@EVERY
def test_its_loss_reaches_every_parameter(name: str):
    model, pixels = build(name).train(), photos(name, 3)
    none = torch.zeros(3, dtype=torch.long)
    size = CONFIGS[name].size
    target = torch.linspace(1, 8, size[1]).expand(3, 1, *size)
    batch = Batch(pixels, target, torch.ones(3, 1, *size, dtype=torch.bool), none, none, ["?"] * 3, "depth")
    torch.manual_seed(0)
    terms = metric_losses(model(pixels), batch, TrainConfig("metric", ZOED_LITE, (), steps=1))
    torch.stack(list(terms.values())).sum().backward()
    without = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert without == []
    assert all(p.grad.isfinite().all() for p in model.parameters() if p.grad is not None)


@EVERY
def test_encoder_takes_the_weights_of_timms_network_and_checkpoints_gradients(name: str):
    model = build(name)
    torch.manual_seed(1)
    network = timm.create_model(ENCODER, pretrained=False)
    model.encoder.load_timm(network)
    (stem,) = (value for key, value in model.encoder.state_dict().items() if key.endswith("conv_stem.weight"))
    assert torch.equal(stem, network.conv_stem.weight)
    exact = model.train()(photos(name)).depth.mean().item()
    model.encoder.checkpoint_gradients()
    loss = model(photos(name)).depth.mean()
    assert loss.isfinite()
    assert exact > 0
    if loss.requires_grad:
        loss.backward()


@EVERY
def test_parameters_are_of_the_encoder_the_decoder_or_what_follows(name: str):
    """Their rates go by these names."""
    names = [key.partition(".")[0] for key, _ in build(name).named_parameters()]
    assert {"encoder", "decoder"} <= set(names)
