"""Promises of every baseline. A new baseline inherits ``BaselineTester`` and gives a tiny config."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import ClassVar

import pytest
import timm
import torch
from torch import Tensor, nn

import zoedepth
from zoedepth.build import build_model, without_memory
from zoedepth.config import INDOOR, OUTDOOR, BaselineConfig
from zoedepth.data.sample import Batch
from zoedepth.errors import InputError
from zoedepth.model.interface import DepthModel
from zoedepth.presets import ZOED_LITE
from zoedepth.train.config import TrainConfig
from zoedepth.train.metric import metric_losses
from zoedepth.weights.load import load_model

ENCODER = "test_efficientnet"
"""timm's smallest network with maps at strides 2 to 32."""


@cache
def _weights(config: BaselineConfig) -> dict[str, Tensor]:
    torch.manual_seed(0)
    return build_model(config).state_dict()


def build(config: BaselineConfig, *, weights_of: BaselineConfig | None = None) -> DepthModel:
    """A random model, in evaluation mode, always with the same weights: those of another config if one is given."""
    model = build_model(config)
    model.load_state_dict(_weights(weights_of or config))
    return model.eval()


def photos(config: BaselineConfig, n: int = 2) -> Tensor:
    """Noise."""
    return torch.rand(n, 3, *config.size, generator=torch.Generator().manual_seed(0))


def n_parameters(config: BaselineConfig) -> int:
    with without_memory():
        model = build_model(config)
    return sum(p.numel() for p in model.parameters())


def losses_of(model: DepthModel, pixels: Tensor) -> dict[str, Tensor]:
    """The terms of the model's own loss, for depths that rise to the right from 1 m to 8 m."""
    n, size = len(pixels), pixels.shape[-2:]
    none = torch.zeros(n, dtype=torch.long)
    target = torch.linspace(1, 8, size[1]).expand(n, 1, *size)
    batch = Batch(pixels, target, torch.ones(n, 1, *size, dtype=torch.bool), none, none, ["?"] * n, "depth")
    torch.manual_seed(0)  # the same windows and dropout every time
    return metric_losses(model(pixels), batch, TrainConfig("metric", ZOED_LITE, (), steps=1), ())


def gradients(model: DepthModel, pixels: Tensor) -> dict[str, Tensor | None]:
    """The gradient of the loss in every parameter."""
    model.zero_grad()
    torch.stack(list(losses_of(model, pixels).values())).sum().backward()
    return {name: p.grad for name, p in model.named_parameters()}


class BaselineTester:
    """Subclasses give what is below.

    Attributes:
        TINY: a small config.
        HAS_BINS: depth is the mean of a distribution.
        BOUNDED: depth is not nearer than the nearest depth of the domain.
        TERMS: names of the terms of the loss.
    """

    TINY: ClassVar[BaselineConfig]
    HAS_BINS: ClassVar[bool]
    BOUNDED: ClassVar[bool] = True
    TERMS: ClassVar[set[str]] = {"silog"}

    @pytest.fixture
    def config(self) -> BaselineConfig:
        return self.TINY

    @torch.no_grad()
    def test_depth_is_metres_in_the_range_of_its_domain_at_the_size_of_the_photo(self, config: BaselineConfig):
        for domain in (INDOOR, OUTDOOR):
            model = build(replace(config, domains=(domain,)), weights_of=config)
            output = model(photos(config), return_std=True, return_bins=True)
            assert output.depth.shape == (2, 1, *config.size)
            assert output.depth.dtype == torch.float32
            nearest = domain.min_depth - 1e-5 if self.BOUNDED else 0
            for metres in (output.depth, output.bin_centers):
                assert metres is None or ((metres >= nearest) & (metres <= domain.max_depth + 1e-3)).all()
            assert output.domain.tolist() == [0, 0]
            assert output.relative is output.domain_logits is None
            found = (output.std, output.bin_centers, output.probability)
            assert [x is not None for x in found] == [self.HAS_BINS] * 3
            for maps in found:
                assert maps is None or (maps.isfinite().all() and maps.shape[-2:] == config.size)

    @torch.no_grad()
    def test_any_size_it_may_be_given(self, config: BaselineConfig):
        model = build(config)
        for size in [(32, 32), (160, 64), (64, 224)]:
            pixels = torch.rand(1, 3, *size)
            if config.one_size:
                with pytest.raises(InputError, match=rf"takes pixels of \({config.size[0]}, {config.size[1]}\) only"):
                    model(pixels)
            else:
                assert model(pixels).depth.shape == (1, 1, *size)
        with pytest.raises(InputError, match="the baselines"):
            model.relative(photos(config))

    @torch.no_grad()
    def test_images_do_not_see_each_other(self, config: BaselineConfig):
        model, pixels = build(config), photos(config, 3)
        together = model(pixels).depth
        for i in range(3):
            assert torch.allclose(model(pixels[i : i + 1]).depth, together[i : i + 1], rtol=1e-3, atol=1e-3)

    @torch.no_grad()
    def test_half_precision_is_finite_and_close(self, config: BaselineConfig):
        model, pixels = build(config), photos(config)
        exact = model(pixels).depth
        with torch.autocast("cpu", dtype=torch.bfloat16):
            output = model(pixels, return_bins=True)
        for maps in (output.depth, output.bin_centers, output.probability):
            assert maps is None or (maps.dtype == torch.float32 and maps.isfinite().all())
        assert ((output.depth - exact).abs() / exact).mean() < 0.1

    @torch.no_grad()
    def test_pixels_are_normalised_by_the_mean_and_deviation_of_imagenet(self, config: BaselineConfig):
        model, pixels = build(config), photos(config)
        seen: list[Tensor] = []
        model.encoder.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0]))
        model(pixels)
        mean, std = (torch.tensor(x)[:, None, None] for x in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
        assert torch.allclose(seen[0], (pixels - mean) / std, atol=1e-6)
        assert not {"mean", "std"} & set(model.state_dict()), "files carry no constants"

    @torch.no_grad()
    def test_it_is_saved_and_loaded(self, config: BaselineConfig, tmp_path: Path):
        model, pixels = build(config), photos(config)
        zoedepth.save_model(model, tmp_path / "model.safetensors")
        loaded = load_model(tmp_path / "model.safetensors")
        assert loaded.config == config
        expected, found = model.state_dict(), loaded.state_dict()
        assert found.keys() == expected.keys()
        assert all(torch.equal(found[name], value) for name, value in expected.items())
        torch.testing.assert_close(loaded(pixels).depth, model(pixels).depth, rtol=1e-4, atol=1e-5)
        photo = (255 * pixels[0].permute(1, 2, 0)).byte().numpy()
        assert zoedepth.Predictor(loaded)(photo).depth.shape == config.size

    def test_its_loss_gives_every_parameter_a_gradient_which_checkpointing_keeps(self, config: BaselineConfig):
        model, pixels = build(config).train(), photos(config, 3)
        terms = losses_of(model, pixels)
        assert set(terms) == self.TERMS
        assert all(term.requires_grad for term in terms.values())
        before = gradients(model, pixels)
        assert [name for name, g in before.items() if g is None or not g.abs().sum() > 0] == []
        assert all(g.isfinite().all() for g in before.values() if g is not None)
        before = {name: g.clone() for name, g in before.items() if g is not None}
        calls = n_forwards(model, pixels)
        model.encoder.checkpoint_gradients()
        assert n_forwards(model, pixels) > calls, "something is computed again"
        after = gradients(model, pixels)
        for name, g in before.items():
            assert torch.allclose(after[name], g, rtol=1e-3, atol=1e-4 * g.abs().max().item()), name

    def test_loss_falls_on_one_batch(self, config: BaselineConfig):
        model, pixels = build(config).train(), photos(config)
        optimizer = torch.optim.AdamW(model.parameters(), lr=1e-3)
        values = []
        for _ in range(6):
            loss = torch.stack(list(losses_of(model, pixels).values())).sum()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            values.append(loss.item())
        assert values[-1] < 0.9 * values[0]

    def test_encoder_takes_the_weights_of_timms_network(self, config: BaselineConfig):
        encoder = build(config).encoder
        torch.manual_seed(1)
        network = timm.create_model(config.network.encoder, pretrained=False)
        encoder.load_timm(network)
        (stem,) = (value for key, value in encoder.state_dict().items() if key.endswith("conv_stem.weight"))
        assert torch.equal(stem, network.get_parameter("conv_stem.weight"))

    def test_parameters_are_of_the_encoder_the_decoder_or_what_follows(self, config: BaselineConfig):
        """Their rates go by these names."""
        names = {key.partition(".")[0] for key, _ in build(config).named_parameters()}
        assert {"encoder", "decoder"} <= names


def n_forwards(model: DepthModel, pixels: Tensor) -> int:
    """How many convolutions of the encoder a forward and a backward pass compute."""
    calls: list[nn.Module] = []
    hooks = [
        module.register_forward_hook(lambda module, inputs, output: calls.append(module))
        for module in model.encoder.modules()
        if isinstance(module, nn.Conv2d)
    ]
    gradients(model, pixels)
    for hook in hooks:
        hook.remove()
    return len(calls)
