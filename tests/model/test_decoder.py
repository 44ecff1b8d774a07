import pytest
import torch
import torch.nn.functional as F

from zoedepth.config import DecoderConfig
from zoedepth.model.decoder import Decoder, Fusion, Reassemble, RelativeHead, ResidualUnit
from zoedepth.model.encoder import EncoderFeatures

WIDTHS = (8, 10, 12, 14)


def token_decoder(*, output_stride: int = 1) -> Decoder:
    torch.manual_seed(0)
    return Decoder(
        (20,) * 4,
        (16,) * 4,
        DecoderConfig(WIDTHS, features=5, output_stride=output_stride),
        has_readout=True,
        reassembled_channels=(4, 6, 8, 8),
    ).eval()


def token_features(size: tuple[int, int], *, batch: int = 2) -> EncoderFeatures:
    generator = torch.Generator().manual_seed(0)
    maps = torch.randn(4, batch, 20, size[0] // 16, size[1] // 16, generator=generator)
    return EncoderFeatures(tuple(maps), tuple(torch.randn(4, batch, 20, generator=generator)))


def pyramid_decoder(*, output_stride: int = 1) -> Decoder:
    torch.manual_seed(0)
    channels = (6, 7, 8, 9)
    return Decoder(
        channels,
        (4, 8, 16, 32),
        DecoderConfig(WIDTHS, features=5, output_stride=output_stride),
        has_readout=False,
        reassembled_channels=channels,
    ).eval()


def pyramid_features(size: tuple[int, int], *, batch: int = 2) -> EncoderFeatures:
    generator = torch.Generator().manual_seed(0)
    maps = (
        torch.randn(batch, channels, size[0] // stride, size[1] // stride, generator=generator)
        for channels, stride in zip((6, 7, 8, 9), (4, 8, 16, 32), strict=True)
    )
    return EncoderFeatures(tuple(maps), None)


@pytest.mark.parametrize("output_stride", [1, 2])
@pytest.mark.parametrize("size", [(32, 32), (64, 96), (160, 32)])
@pytest.mark.parametrize("kind", ["tokens", "pyramid"])
def test_maps_have_the_published_strides_and_the_channels_announced(
    kind: str, size: tuple[int, int], output_stride: int
):
    if kind == "tokens":
        decoder, features = token_decoder(output_stride=output_stride), token_features(size)
    else:
        decoder, features = pyramid_decoder(output_stride=output_stride), pyramid_features(size)
    out = decoder(features)

    def shape(channels: int, stride: int) -> tuple[int, ...]:
        return (2, channels, size[0] // stride, size[1] // stride)

    assert tuple(out.bottleneck.shape) == shape(decoder.channels.bottleneck, 32)
    levels = [shape(channels, stride) for channels, stride in zip(decoder.channels.levels, (16, 8, 4, 2), strict=True)]
    assert [tuple(x.shape) for x in out.levels] == levels
    assert tuple(out.last.shape) == shape(decoder.channels.last, output_stride)
    assert tuple(out.relative.shape) == shape(1, output_stride)
    assert decoder.channels == (14, (12, 10, 8, 8), 5)


def test_last_map_and_relative_depth_are_not_negative():
    out = token_decoder()(token_features((64, 64)))
    assert (out.last >= 0).all()
    assert (out.relative >= 0).all()
    assert out.last.max() > 0


def test_gradients_reach_every_parameter():
    for decoder, features in (
        (token_decoder(), token_features((64, 64))),
        (pyramid_decoder(), pyramid_features((64, 64))),
    ):
        torch.nn.init.constant_(decoder.relative_head.conv3.bias, 1.0)  # so that its ReLU is open
        decoder(features).relative.square().mean().backward()
        assert [name for name, p in decoder.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_whole_pyramid_decoder_against_the_published_wiring():
    """As MiDaS writes it: upsample before the 1x1 convolution, skip added after its residual unit."""
    decoder, features = pyramid_decoder(), pyramid_features((64, 96))

    def up(x: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
        return F.interpolate(x, size=size, mode="bilinear", align_corners=True)

    def unit(x: torch.Tensor, weights: ResidualUnit) -> torch.Tensor:
        y = F.conv2d(F.relu(x), weights.conv1.weight, weights.conv1.bias, padding=1)
        return x + F.conv2d(F.relu(y), weights.conv2.weight, weights.conv2.bias, padding=1)

    def fuse(weights: Fusion, x: torch.Tensor, skip: torch.Tensor | None, size: tuple[int, int]) -> torch.Tensor:
        if skip is not None:
            x = x + unit(skip, weights.skip)
        return F.conv2d(up(unit(x, weights.refine), size), weights.project.weight, weights.project.bias)

    l1, l2, l3, l4 = (F.conv2d(x, c.weight, padding=1) for x, c in zip(features.maps, decoder.project, strict=True))
    r4 = fuse(decoder.fusion[0], l4, None, (4, 6))
    r3 = fuse(decoder.fusion[1], r4, l3, (8, 12))
    r2 = fuse(decoder.fusion[2], r3, l2, (16, 24))
    r1 = fuse(decoder.fusion[3], r2, l1, (32, 48))
    head = decoder.relative_head
    x = up(F.conv2d(r1, head.conv1.weight, head.conv1.bias, padding=1), (64, 96))
    last = F.relu(F.conv2d(x, head.conv2.weight, head.conv2.bias, padding=1))
    relative = F.relu(F.conv2d(last, head.conv3.weight, head.conv3.bias))
    out = decoder(features)
    for found, expected in zip(
        (out.bottleneck, *out.levels, out.last, out.relative), (l4, r4, r3, r2, r1, last, relative), strict=True
    ):
        assert torch.allclose(found, expected, atol=1e-5)


@torch.no_grad()
def test_reassemble_joins_the_class_token_to_every_token():
    torch.manual_seed(0)
    reassemble = Reassemble(6, 4, stride=16, output_stride=16)
    x, readout = torch.randn(1, 6, 2, 3), torch.randn(1, 6)
    found = reassemble(x, readout)
    for row in range(2):
        for column in range(3):
            joined = torch.cat([x[0, :, row, column], readout[0]])
            token = F.gelu(reassemble.readout.weight @ joined + reassemble.readout.bias)
            expected = reassemble.project.weight[:, :, 0, 0] @ token + reassemble.project.bias
            assert torch.allclose(found[0, :, row, column], expected, atol=1e-6)


@pytest.mark.parametrize(
    ("output_stride", "weight"), [(4, (8, 8, 4, 4)), (8, (8, 8, 2, 2)), (16, None), (32, (8, 8, 3, 3))]
)
def test_reassemble_resamples_as_published(output_stride: int, weight: tuple[int, ...] | None):
    reassemble = Reassemble(6, 8, stride=16, output_stride=output_stride)
    assert reassemble(torch.randn(1, 6, 4, 6), torch.randn(1, 6)).shape[-2:] == (
        64 // output_stride,
        96 // output_stride,
    )
    assert getattr(reassemble.resample, "weight", torch.empty(0)).shape == (weight or (0,))


def test_residual_unit_of_zero_weights_is_the_identity_and_leaves_its_input_alone():
    unit = ResidualUnit(3)
    for p in unit.parameters():
        torch.nn.init.zeros_(p)
    x = torch.randn(1, 3, 4, 4)
    before = x.clone()
    assert torch.equal(unit(x), before)
    assert torch.equal(x, before)


def test_relative_head_begins_with_an_open_relu():
    assert RelativeHead(8, features=5, upsample=False).conv3.bias.tolist() == [0.5]


def test_relative_head_doubles_the_size_only_at_stride_1():
    x = torch.randn(1, 8, 4, 6)
    for grows, size in ((True, (8, 12)), (False, (4, 6))):
        last, relative = RelativeHead(8, features=5, upsample=grows)(x)
        assert last.shape == (1, 5, *size)
        assert relative.shape == (1, 1, *size)
