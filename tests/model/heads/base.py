"""What every metric head must do. A new head inherits ``HeadTester`` and gives its configs."""

import io
import os
from dataclasses import fields, replace
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor, nn

import zoedepth.model.heads.probability
from zoedepth.config import Domain, ModelConfig
from zoedepth.data.sample import Batch
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads import HEADS, HeadOutput
from zoedepth.model.heads.probability import BinDistribution
from zoedepth.model.interface import DepthOutput
from zoedepth.model.upsample import upsample
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import ZOED_LITE
from zoedepth.train.config import TrainConfig
from zoedepth.train.metric import metric_losses

CHANNELS = DecoderChannels(bottleneck=10, levels=(8, 6, 5, 3), last=4)
DOMAIN = Domain("indoor", 0.5, 8.0)


def decoder_features(size: tuple[int, int], *, batch: int = 2, output_stride: int = 1) -> DecoderFeatures:
    """Random maps as a decoder gives them for pixels of ``size``."""
    generator = torch.Generator().manual_seed(size[0] + size[1])

    def noise(channels: int, stride: int) -> Tensor:
        return torch.randn(batch, channels, size[0] // stride, size[1] // stride, generator=generator)

    return DecoderFeatures(
        noise(CHANNELS.bottleneck, 32),
        tuple(noise(channels, stride) for channels, stride in zip(CHANNELS.levels, (16, 8, 4, 2), strict=True)),
        noise(CHANNELS.last, output_stride).relu(),
        noise(1, output_stride).relu(),
    )


def scaled(features: DecoderFeatures, factor: float) -> DecoderFeatures:
    """Stronger maps."""
    levels = tuple(factor * level for level in features.levels)
    return features._replace(bottleneck=factor * features.bottleneck, levels=levels)


def rows_of(features: DecoderFeatures, rows: slice) -> DecoderFeatures:
    """Some images of the batch."""
    levels = tuple(level[rows] for level in features.levels)
    return DecoderFeatures(features.bottleneck[rows], levels, features.last[rows], features.relative[rows])


class Head(nn.Module):
    """Both parts of a head, from decoder features to depth."""

    def __init__(self, config: Any, domain: Domain = DOMAIN) -> None:
        super().__init__()
        parts = HEADS[type(config)]
        self.shared = parts.shared(CHANNELS, config)
        self.domain = parts.domain(CHANNELS, config, domain)

    def forward(self, features: DecoderFeatures) -> HeadOutput:
        return self.domain(self.shared(features))


def build_head(config: Any, *, seed: int = 0) -> Head:
    """A random head."""
    torch.manual_seed(seed)
    return Head(config)


def loss_of(output: HeadOutput, size: tuple[int, int]) -> Tensor:
    """What the head is trained with, of smooth random depths that are known at most places."""
    n = len(output.depth)
    generator = torch.Generator().manual_seed(0)
    coarse = 0.6 + 7 * torch.rand(n, 1, 4, 4, generator=generator)
    target = upsample(coarse, torch.Size(size))
    mask = torch.rand(n, 1, *size, generator=generator) < 0.9
    none = torch.zeros(n, dtype=torch.long)
    said = DepthOutput(upsample(output.depth, torch.Size(size)), None, none, None, None, None, None, output.supervision)
    batch = Batch(torch.zeros(n, 3, *size), target, mask, none, none, ["?"] * n, "depth")
    terms = metric_losses(said, batch, TrainConfig("metric", ZOED_LITE, (), steps=1), ())
    return torch.stack(list(terms.values())).sum()


def tensors_of(x: Any) -> list[Tensor]:
    """Every tensor of nested tuples."""
    if isinstance(x, tuple):
        return [tensor for part in x for tensor in tensors_of(part)]
    return [x] if isinstance(x, Tensor) else []


class _Exportable(nn.Module):
    """A head as torch.export takes it: tensors in, tensors out."""

    def __init__(self, head: Head) -> None:
        super().__init__()
        self.head = head

    def forward(self, bottleneck: Tensor, a: Tensor, b: Tensor, c: Tensor, d: Tensor, last: Tensor, relative: Tensor):
        depth, std = self.head(DecoderFeatures(bottleneck, (a, b, c, d), last, relative)).depth_and_std()
        return (depth,) if std is None else (depth, std)


class HeadTester:
    """Subclasses give a fixture ``config``, with a param for each option, and what is below.

    Attributes:
        TINY: a small config.
        CHANGES: for every field of the config another value, and what the config must be for it to matter.
        BOUNDED: depth stays in the range of the domain.
        HAS_BINS: depth is the mean of a distribution.
        EXPORTED: configs that pass through every line of the head between them, for the exporter; none: the small one.
    """

    TINY: ClassVar[Any]
    CHANGES: ClassVar[dict[str, tuple[Any, dict[str, Any]]]]
    BOUNDED: ClassVar[bool] = True
    HAS_BINS: ClassVar[bool] = True
    EXPORTED: ClassVar[tuple[Any, ...]] = ()

    def check_centers(self, centers: Tensor, config: Any) -> None:
        """Assert what this head promises of its bin centers (batch, bins, height, width)."""
        assert centers.isfinite().all()
        assert (centers >= DOMAIN.min_depth - 1e-4).all()
        assert (centers <= DOMAIN.max_depth + 1e-4).all()
        assert (centers.diff(dim=1) >= -1e-4).all(), "bins are in order"

    @pytest.fixture
    def config(self) -> Any:
        return self.TINY

    @pytest.fixture
    def head(self, config: Any) -> Head:
        return build_head(config)

    @pytest.mark.parametrize(("size", "output_stride"), [((32, 32), 1), ((64, 96), 2), ((160, 32), 1)])
    def test_any_input_size_gives_a_map_of_its_proportions(self, head: Head, size: tuple[int, int], output_stride: int):
        output = head(decoder_features(size, output_stride=output_stride))
        stride = size[0] // output.depth.shape[-2]
        assert output.depth.shape == (2, 1, size[0] // stride, size[1] // stride)
        assert output.depth.dtype == torch.float32
        assert (output.distribution is not None) == self.HAS_BINS
        if output.distribution is not None:
            for bins in (output.distribution.bin_centers, output.distribution.probability):
                assert bins.shape[-2:] == output.depth.shape[-2:]
                assert bins.dtype == torch.float32

    def test_depth_is_positive_metres_inside_the_promised_range(self, head: Head):
        for factor in (0.0, 1.0, 30.0):
            depth = head(scaled(decoder_features((64, 64)), factor)).depth
            assert depth.isfinite().all()
            assert (depth > 0).all()
            if self.BOUNDED:
                assert (depth >= DOMAIN.min_depth - 1e-4).all()
                assert (depth <= DOMAIN.max_depth + 1e-4).all()

    def test_depth_is_the_mean_of_the_bins(self, head: Head, config: Any):
        for factor in (1.0, 30.0):
            output = head(scaled(decoder_features((64, 64)), factor))
            if output.distribution is None:
                depth, std = output.depth_and_std()
                assert torch.equal(depth, output.depth)
                assert std is None
                return
            centers, probability = output.distribution.bin_centers, output.distribution.probability
            self.check_centers(centers, config)
            assert (probability >= 0).all()
            total = probability.sum(dim=1)
            assert torch.allclose(total, torch.ones_like(total), atol=1e-5)
            expected = (probability.double() * centers.double()).sum(dim=1, keepdim=True)
            assert torch.allclose(output.depth.double(), expected, rtol=1e-5)
            depth, std = output.depth_and_std()
            torch.testing.assert_close(depth, output.depth)
            assert std is not None
            assert std.isfinite().all()

    def test_bands_of_rows_give_what_the_whole_gives(self, head: Head, monkeypatch: pytest.MonkeyPatch):
        features = decoder_features((64, 96))
        head.eval()
        whole = head(features)
        monkeypatch.setattr(zoedepth.model.heads.probability, "_BAND", 700)
        with torch.inference_mode():
            depth, std = head(features).depth_and_std()
        expected_depth, expected_std = whole.depth_and_std()
        assert torch.allclose(depth, expected_depth, rtol=1e-5)
        if std is not None and expected_std is not None:
            assert torch.allclose(std, expected_std, rtol=1e-3, atol=1e-3)

    def test_its_loss_gives_every_parameter_a_gradient(self, head: Head):
        loss_of(head(decoder_features((64, 64), batch=3)), (64, 64)).backward()
        without = [name for name, p in head.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
        assert without == []
        assert all(p.grad.isfinite().all() for p in head.parameters() if p.grad is not None)

    def test_it_learns(self, head: Head):
        """Ten steps on one batch make its own loss smaller."""
        features = decoder_features((32, 32))
        optimizer = torch.optim.Adam(head.parameters(), lr=3e-3)
        values = []
        for _ in range(10):
            torch.manual_seed(0)  # where a loss draws windows, the same ones
            loss = loss_of(head(features), (32, 32))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            values.append(loss.item())
        assert values[-1] < values[0]

    def test_images_do_not_see_each_other(self, head: Head):
        head.eval()
        features = decoder_features((64, 64), batch=3)
        together = head(features).depth
        for i in range(3):
            alone = head(rows_of(features, slice(i, i + 1))).depth
            assert torch.allclose(alone, together[i : i + 1], atol=1e-5)

    def test_bfloat16_autocast_is_finite_and_close(self, head: Head):
        head.eval()
        features = decoder_features((64, 64))
        exact = head(features)
        try:
            with torch.autocast("cpu", dtype=torch.bfloat16):
                output = head(features)
        except RuntimeError as error:
            # torch's own attention takes AMX for bfloat16 and then lacks a kernel that ATEN_CPU_CAPABILITY forbids it.
            # No processor is so: AMX comes with AVX-512. Without the variable the error is one.
            if "ATEN_CPU_CAPABILITY" not in os.environ or "pack_vnni2" not in str(error):
                raise
            # An error of torch itself, on a processor that the variable makes up: there is nothing of ours to test.
            pytest.skip("torch has no attention in bfloat16 with AMX under ATEN_CPU_CAPABILITY")
        assert output.depth.dtype == torch.float32
        assert output.depth.isfinite().all()
        if output.distribution is not None:
            probability = output.distribution.probability
            total = probability.sum(dim=1)
            assert probability.dtype == torch.float32
            assert torch.allclose(total, torch.ones_like(total), atol=1e-4)
        assert ((output.depth - exact.depth).abs() / exact.depth).mean() < 0.05

    def test_everything_it_makes_is_on_the_device_of_its_input(self, head: Head):
        """The device that has shapes but no numbers refuses to meet the CPU, as a GPU does."""
        bottleneck, levels, last, relative = decoder_features((64, 64))
        meta = DecoderFeatures(
            bottleneck.to("meta"), tuple(x.to("meta") for x in levels), last.to("meta"), relative.to("meta")
        )
        output = head.to("meta")(meta)
        assert {x.device.type for x in tensors_of((output.prediction, output.supervision))} == {"meta"}

    def test_weights_carry_everything_to_another_head(self, head: Head, config: Any):
        file = io.BytesIO()
        torch.save(head.state_dict(), file)
        file.seek(0)
        other, features = build_head(config, seed=1).eval(), decoder_features((64, 64))
        head.eval()
        assert not torch.equal(other(features).depth, head(features).depth)
        other.load_state_dict(torch.load(file, weights_only=True))
        assert torch.equal(other(features).depth, head(features).depth)

    def shorten(self, head: Head) -> None:
        """Take out what a head that is to be exported repeats: hundreds of operations take the exporter seconds."""

    def test_it_can_be_exported(self):
        """A program for any batch, with all that a whole model asks of a head."""
        (bottleneck, levels, *rest), (others, other_levels, *other_rest) = (
            decoder_features((64, 96), batch=batch) for batch in (2, 3)
        )
        shapes = ({0: torch.export.Dim("batch", min=1, max=1024)},) * 7
        for config in self.EXPORTED or (self.TINY,):
            head = build_head(config).eval()
            self.shorten(head)
            model = _Exportable(head)
            exported = torch.export.export(
                model, (bottleneck, *levels, *rest), dynamic_shapes=shapes, strict=False
            ).module()
            inputs = (others, *other_levels, *other_rest)
            for found, expected in zip(exported(*inputs), model(*inputs), strict=True):
                assert torch.allclose(found, expected, rtol=1e-4, atol=1e-5), config

    def test_every_field_of_its_config_matters(self):
        assert set(self.CHANGES) == {field.name for field in fields(self.TINY)}
        features = decoder_features((64, 64))
        for name, (value, needed) in self.CHANGES.items():
            config = replace(self.TINY, **needed)
            assert getattr(config, name) != value
            one, other = build_head(config), build_head(replace(config, **{name: value}))
            shapes = [[tuple(p.shape) for p in head.state_dict().values()] for head in (one, other)]
            if shapes[0] == shapes[1]:
                torch.manual_seed(1)
                said = one(features)
                torch.manual_seed(1)
                changed = other(features)
                assert not _same(said, changed), f"{name} changes nothing"

    def test_a_whole_model_takes_it_with_any_number_of_domains(self, tiny_config: ModelConfig):
        pixels = torch.rand(3, 3, 64, 96)
        for n in (1, 3):
            domains = tuple(Domain(f"scene {i}", 1e-3, 10.0 * (i + 1)) for i in range(n))
            torch.manual_seed(0)
            model = ZoeDepth(replace(tiny_config, head=self.TINY, domains=domains)).eval()
            given = torch.tensor([0, n - 1, 0])
            output = model(pixels, domain=given, return_std=True, return_bins=True)
            assert output.depth.shape == (3, 1, 64, 96)
            assert (output.std is not None) == (output.bin_centers is not None) == self.HAS_BINS
            for i in range(3):
                alone = model(pixels[i : i + 1], domain=given[i : i + 1]).depth
                assert torch.allclose(alone, output.depth[i : i + 1], rtol=1e-4, atol=1e-4)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, HeadOutput) and isinstance(other, HeadOutput):
        one, other = ((output.depth, output.distribution, output.supervision) for output in (one, other))
    if isinstance(one, BinDistribution) and isinstance(other, BinDistribution):
        one, other = ((found.bin_centers, found.probability) for found in (one, other))
    if isinstance(one, Tensor) and isinstance(other, Tensor):
        return one.shape == other.shape and bool(torch.equal(one, other))
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    return one is other
