from dataclasses import replace

import pytest
import torch

from zoedepth.build import without_memory
from zoedepth.config import EncoderConfig, ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.encoder import Encoder
from zoedepth.presets import ENCODERS

TINY_SWIN = EncoderConfig(
    "swinv2_tiny_window16_256", "swin", size=(64, 64), width=24, depth=(1, 1, 2, 1), heads=(1, 2, 4, 8)
)

# Channels of the four maps, and those of BEiT's after reassembling, from the tables of MiDaS v3.1 and timm.
PUBLISHED = {
    "beit_large_patch16_384": ((1024,) * 4, (256, 512, 1024, 1024)),
    "beit_large_patch16_512": ((1024,) * 4, (256, 512, 1024, 1024)),
    "beit_base_patch16_384": ((768,) * 4, (96, 192, 384, 768)),
    "swin_large_patch4_window12_384": ((192, 384, 768, 1536),) * 2,
    "swinv2_large_window12to24_192to384": ((192, 384, 768, 1536),) * 2,
    "swinv2_base_window12to24_192to384": ((128, 256, 512, 1024),) * 2,
    "swinv2_tiny_window16_256": ((96, 192, 384, 768),) * 2,
    "tf_efficientnet_b5": ((40, 64, 176, 512),) * 2,
    "tf_efficientnet_lite0": ((24, 40, 112, 320),) * 2,
    "tf_efficientnet_lite1": ((24, 40, 112, 320),) * 2,
    "tf_efficientnet_lite2": ((24, 48, 120, 352),) * 2,
    "tf_efficientnet_lite3": ((32, 48, 136, 384),) * 2,
}


@pytest.mark.parametrize("name", ENCODERS)
def test_channels_are_the_published_ones_and_the_maps_have_them(name: str):
    """Whole networks, on the device that has shapes but no numbers."""
    config = ENCODERS[name]
    size = config.size if config.family == "swin" else (64, 96)
    with without_memory():
        encoder = Encoder(config).eval()
    features = encoder(torch.empty(2, 3, *size, device="meta"))  # it makes its own tensors there, too
    channels, reassembled = PUBLISHED[name]
    assert encoder.channels == channels
    assert encoder.reassembled_channels == reassembled
    shapes = [(2, c, size[0] // s, size[1] // s) for c, s in zip(encoder.channels, encoder.strides, strict=True)]
    assert [tuple(x.shape) for x in features.maps] == shapes
    assert encoder.has_readout == (features.readouts is not None) == name.startswith("beit")


@pytest.mark.parametrize("size", [(32, 32), (64, 96)])
def test_convolutional_maps_have_their_strides_at_any_size(size: tuple[int, int]):
    torch.manual_seed(0)
    encoder = Encoder(ENCODERS["tf_efficientnet_lite0"]).eval()
    features = encoder(torch.rand(1, 3, *size))
    assert encoder.strides == (4, 8, 16, 32)
    assert [x.shape[-2:] for x in features.maps] == [torch.Size([size[0] // s, size[1] // s]) for s in (4, 8, 16, 32)]
    assert features.readouts is None


def test_swin_maps_are_channels_first_pyramids():
    torch.manual_seed(0)
    encoder = Encoder(TINY_SWIN).eval()
    features = encoder(torch.rand(2, 3, 64, 64))
    assert encoder.channels == encoder.reassembled_channels == (24, 48, 96, 192)
    assert [tuple(x.shape) for x in features.maps] == [
        (2, 24, 16, 16), (2, 48, 8, 8), (2, 96, 4, 4), (2, 192, 2, 2)]  # fmt: skip
    assert all(x.isfinite().all() for x in features.maps)


def test_beit_has_four_maps_at_one_stride_and_a_class_token_beside_each(tiny_config: ModelConfig):
    encoder = Encoder(tiny_config.encoder).eval()
    features = encoder(torch.rand(2, 3, 64, 96))
    assert encoder.strides == (16, 16, 16, 16)
    assert encoder.channels == (32,) * 4
    assert encoder.reassembled_channels == (8, 16, 16, 16)
    assert [tuple(x.shape) for x in features.maps] == [(2, 32, 4, 6)] * 4
    assert [tuple(x.shape) for x in features.readouts] == [(2, 32)] * 4


def test_map_keeps_its_place_in_the_image():
    """A bright corner of the photo is the corner that changes in the fine map, for channels last as for first."""
    for config in (TINY_SWIN, ENCODERS["tf_efficientnet_lite0"]):
        torch.manual_seed(0)
        encoder = Encoder(config).eval()
        dark = torch.zeros(1, 3, 64, 64)
        corner = dark.clone()
        corner[..., :8, 56:] = 1  # upper right
        with torch.no_grad():
            change = (encoder(corner).maps[0] - encoder(dark).maps[0]).abs().sum(dim=1)[0]
        row, column = divmod(int(change.argmax()), 16)
        assert row <= 4
        assert column >= 11


@pytest.mark.parametrize("name", ["tf_efficientnet_lite0", "swin", "beit"])
def test_gradients_reach_every_weight(name: str, tiny_config: ModelConfig):
    config = {"swin": TINY_SWIN, "beit": tiny_config.encoder}.get(name) or ENCODERS[name]
    torch.manual_seed(0)
    encoder = Encoder(config).eval()
    features = encoder(torch.rand(2, 3, 64, 64))
    sum(x.square().mean() for x in (*features.maps, *(features.readouts or ()))).backward()
    # The bias of Swin V2's position MLP and the like may be zero; none may be missing.
    assert [name for name, p in encoder.named_parameters() if p.grad is None] == []


def test_training_under_bfloat16_agrees_with_float32():
    """Depthwise convolutions change their precision then; not what they compute."""
    torch.manual_seed(0)
    encoder = Encoder(ENCODERS["tf_efficientnet_lite0"]).train()
    pixels = torch.rand(4, 3, 64, 64)
    exact = encoder(pixels).maps[0]
    with torch.autocast("cpu", dtype=torch.bfloat16):
        half = encoder(pixels).maps[0]
    half.float().square().mean().backward()
    assert (half.float() - exact).norm() / exact.norm() < 0.05
    used = [p for name, p in encoder.named_parameters() if "blocks.0." in name]
    assert all(p.grad is not None and p.grad.isfinite().all() for p in used)


def test_weights_keep_timm_names_so_that_published_files_fit():
    import timm

    encoder = Encoder(ENCODERS["tf_efficientnet_lite0"])
    timms = timm.create_model(
        "tf_efficientnet_lite0", pretrained=False, features_only=True, out_indices=(1, 2, 3, 4)
    ).state_dict()
    ours = encoder.network.stages.state_dict()
    assert {name: value.shape for name, value in ours.items()} == {name: x.shape for name, x in timms.items()}


def test_width_depth_and_heads_take_the_place_of_timms():
    small, deep = Encoder(TINY_SWIN), Encoder(replace(TINY_SWIN, depth=(1, 1, 3, 1)))
    assert sum(p.numel() for p in deep.parameters()) > sum(p.numel() for p in small.parameters())
    assert Encoder(replace(TINY_SWIN, width=48)).channels == (48, 96, 192, 384)


def test_depth_and_width_of_the_mlps_of_beit_take_the_place_of_timms(tiny_config: ModelConfig):
    encoder = Encoder(replace(tiny_config.encoder, mlp_width=40))
    assert [block.mlp.fc1.out_features for block in encoder.network.blocks] == [40] * 4
    with pytest.raises(InputError, match="has 3 blocks"):
        Encoder(replace(tiny_config.encoder, depth=(3,)))
