"""What every metric head must do. A new head inherits :class:`HeadTester` and gives its configs."""

import io
from typing import Any

import pytest
import torch
from torch import nn

from zoedepth.config import Domain
from zoedepth.heads import HEADS, HeadOutput
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures

CHANNELS = DecoderChannels(bottleneck=10, levels=(8, 6, 5, 5), last=4)
DOMAIN = Domain("indoor", 0.5, 8.0)


def decoder_features(size: tuple[int, int], *, batch: int = 2, output_stride: int = 1) -> DecoderFeatures:
    """Random maps as a decoder gives them for pixels of ``size``."""
    generator = torch.Generator().manual_seed(size[0] + size[1])

    def noise(channels: int, stride: int) -> torch.Tensor:
        return torch.randn(batch, channels, size[0] // stride, size[1] // stride, generator=generator)

    return DecoderFeatures(
        noise(CHANNELS.bottleneck, 32),
        tuple(noise(channels, stride) for channels, stride in zip(CHANNELS.levels, (16, 8, 4, 2), strict=True)),
        noise(CHANNELS.last, output_stride).relu(),
        noise(1, output_stride).relu(),
    )


class Head(nn.Module):
    """Both parts of a head, from decoder features to depth."""

    def __init__(self, config: Any) -> None:
        super().__init__()
        parts = HEADS[type(config)]
        self.shared = parts.shared(CHANNELS, config)
        self.domain = parts.domain(CHANNELS, config, DOMAIN)

    def forward(self, features: DecoderFeatures) -> HeadOutput:
        return self.domain(self.shared(features))


def build_head(config: Any, *, seed: int = 0) -> Head:
    """A random head."""
    torch.manual_seed(seed)
    return Head(config)


class HeadTester:
    """Subclasses give a fixture ``config`` (with a param for each option) and :meth:`check_centers`."""

    def check_centers(self, centers: torch.Tensor, config: Any) -> None:
        """Assert what this head promises of its bin centers (batch, bins, height, width)."""
        raise NotImplementedError  # abstract: each head test class gives its own

    @pytest.fixture
    def head(self, config: Any) -> Head:
        return build_head(config)

    @pytest.mark.parametrize("output_stride", [1, 2])
    @pytest.mark.parametrize("size", [(32, 32), (64, 96), (160, 32)])
    def test_output_has_the_size_of_the_last_map(self, head: Head, size: tuple[int, int], output_stride: int):
        features = decoder_features(size, output_stride=output_stride)
        output = head(features)
        map_size = features.last.shape[-2:]
        assert output.depth.shape == (2, 1, *map_size)
        assert output.bin_centers.shape == output.probability.shape
        assert output.bin_centers.shape[0] == 2
        assert output.bin_centers.shape[-2:] == map_size
        assert all(value.dtype == torch.float32 for value in output)

    def test_probabilities_are_a_distribution(self, head: Head):
        probability = head(decoder_features((64, 64))).probability
        assert (probability >= 0).all()
        assert torch.allclose(probability.sum(dim=1), torch.ones(2, 64, 64), atol=1e-5)

    def test_depth_is_the_mean_of_the_bins(self, head: Head):
        output = head(decoder_features((64, 64)))
        expected = (output.probability.double() * output.bin_centers.double()).sum(dim=1, keepdim=True)
        assert torch.allclose(output.depth.double(), expected, rtol=1e-5)
        assert (output.depth > 0).all()

    def test_centers_keep_their_promise(self, head: Head, config: Any):
        for factor in (1.0, 30.0):
            features = decoder_features((64, 64))
            strong = DecoderFeatures(
                factor * features.bottleneck,
                tuple(factor * level for level in features.levels),
                features.last,
                features.relative,
            )
            self.check_centers(head(strong).bin_centers, config)

    def test_every_parameter_gets_a_gradient(self, head: Head):
        head(decoder_features((64, 64), batch=3)).depth.square().mean().backward()
        without = [name for name, p in head.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
        assert without == []
        assert all(p.grad.isfinite().all() for p in head.parameters() if p.grad is not None)

    def test_images_do_not_see_each_other(self, head: Head):
        features = decoder_features((64, 64), batch=3)
        together = head(features).depth
        for i in range(3):
            alone = DecoderFeatures(
                features.bottleneck[i : i + 1],
                tuple(level[i : i + 1] for level in features.levels),
                features.last[i : i + 1],
                features.relative[i : i + 1],
            )
            assert torch.allclose(head(alone).depth, together[i : i + 1], atol=1e-5)

    def test_bfloat16_autocast_is_finite_and_close(self, head: Head):
        features = decoder_features((64, 64))
        exact = head(features)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            output = head(features)
        assert all(value.dtype == torch.float32 for value in output)
        assert all(value.isfinite().all() for value in output)
        assert torch.allclose(output.probability.sum(dim=1), torch.ones(2, 64, 64), atol=1e-4)
        assert ((output.depth - exact.depth).abs() / exact.depth).mean() < 0.05

    def test_weights_carry_everything_to_another_head(self, head: Head, config: Any):
        file = io.BytesIO()
        torch.save(head.state_dict(), file)
        file.seek(0)
        other, features = build_head(config, seed=1), decoder_features((64, 64))
        assert not torch.equal(other(features).depth, head(features).depth)
        other.load_state_dict(torch.load(file, weights_only=True))
        assert torch.equal(other(features).depth, head(features).depth)
