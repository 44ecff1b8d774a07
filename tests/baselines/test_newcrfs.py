from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import timm
import torch
from tests.baselines.base import ENCODER, BaselineTester, build, gradients, photos
from timm.models.swin_transformer import SwinTransformerBlock

import zoedepth
from zoedepth.baselines.newcrfs import PyramidEncoder
from zoedepth.build import build_model, without_memory
from zoedepth.config import INDOOR, BaselineConfig, NewCrfsNetworkConfig
from zoedepth.weights.load import load_model

TINY = BaselineConfig(
    NewCrfsNetworkConfig(ENCODER, widths=(32, 16, 16, 8), attention_heads=(4, 2, 2, 1), seed_width=16), size=(64, 96)
)
SWIN = "swin_tiny_patch4_window7_224"
ON_SWIN = replace(TINY, network=replace(TINY.network, encoder=SWIN))


class TestNewCrfs(BaselineTester):
    TINY = TINY
    HAS_BINS = False
    BOUNDED = False


def noise(size: tuple[int, int], *, n: int = 2) -> torch.Tensor:
    return torch.rand(n, 3, *size, generator=torch.Generator().manual_seed(0))


@cache
def swin() -> PyramidEncoder:
    """A random Swin-Tiny whose relative positions matter. Shared: do not change it."""
    torch.manual_seed(0)
    encoder = PyramidEncoder(SWIN).eval()
    with torch.no_grad():
        for name, p in encoder.named_parameters():
            if name.endswith("bias_table") or p.ndim == 1:
                p.add_(0.3 * torch.randn_like(p))
    return encoder


def test_it_has_the_published_number_of_parameters():
    with without_memory():
        model = build_model(BaselineConfig(NewCrfsNetworkConfig()))
    counts = {name: sum(p.numel() for p in part.parameters()) for name, part in model.named_children()}
    assert counts == {"encoder": 194_998_164, "decoder": 75_445_560, "depth": 1_153}
    assert sum(counts.values()) == 270_444_877
    assert sum(counts.values()) == pytest.approx(270e6, rel=0.03)


@torch.no_grad()
def test_depth_follows_the_range():
    far = build(replace(TINY, domains=(replace(INDOOR, max_depth=80.0),)), weights_of=TINY)
    pixels = photos(TINY)
    assert torch.allclose(far(pixels).depth, 8 * build(TINY)(pixels).depth, rtol=1e-5)


def test_a_batch_trains_every_parameter_of_a_swin():
    model = build(ON_SWIN).train()
    for module in model.modules():
        if type(module).__name__ == "DropPath":
            module.drop_prob = 0.0  # no block is skipped by chance
    found = gradients(model, photos(TINY, 3))
    assert [name for name, g in found.items() if g is None or not g.abs().sum() > 0] == []
    assert all(g.isfinite().all() for g in found.values() if g is not None)


@torch.no_grad()
def test_a_swin_is_saved_and_loaded_with_what_it_computes_beside_its_weights(tmp_path: Path):
    model = build(ON_SWIN)
    zoedepth.save_model(model, tmp_path / "newcrfs.safetensors")
    pixels = noise((64, 96), n=1)
    # Sums may round otherwise by how weights lie in memory.
    torch.testing.assert_close(
        load_model(tmp_path / "newcrfs.safetensors")(pixels).depth, model(pixels).depth, rtol=1e-4, atol=1e-5
    )


# --- the encoder ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [SWIN, ENCODER, "convnext_atto"])
def test_encoder_takes_the_weights_of_timms_network_and_can_save_memory(name: str):
    torch.manual_seed(1)
    encoder = PyramidEncoder(name).eval()
    network = timm.create_model(name, pretrained=False).eval()
    encoder.load_timm(network)
    pixels = noise((224, 224), n=1) if name == SWIN else noise((64, 32))
    maps = encoder(pixels)
    assert [pixels.shape[-1] // x.shape[-1] for x in maps] == [4, 8, 16, 32] == list(encoder.strides)
    assert [x.shape[1] for x in maps] == list(encoder.channels)
    if name == SWIN:
        # At its own size there is nothing to pad, and timm shifts no window that is the whole map: the same but there.
        given = network.patch_embed(pixels)
        for i, (stage, norm) in enumerate(zip(network.layers[:3], encoder.norms, strict=False)):
            given = stage(given)
            assert torch.allclose(maps[i], norm(given).permute(0, 3, 1, 2), atol=1e-4)
    encoder.checkpoint_gradients()
    again = encoder(pixels.requires_grad_())
    assert torch.allclose(again[-1], maps[-1], atol=1e-5)
    assert any(getattr(module, "grad_checkpointing", False) for module in encoder.modules())


def test_maps_of_a_swin_are_normalised_those_of_others_as_they_are():
    assert [tuple(norm.weight.shape) for norm in swin().norms] == [(96,), (192,), (384,), (768,)]
    assert not list(PyramidEncoder(ENCODER).norms.parameters())
    with torch.no_grad():
        x = swin()(noise((64, 32), n=1))[1]
    norm = swin().norms[1]
    x = (x.permute(0, 2, 3, 1) - norm.bias) / norm.weight
    assert torch.allclose(x.mean(-1), torch.zeros(1, 8, 4), atol=1e-4)
    assert torch.allclose(x.var(-1, unbiased=False), torch.ones(1, 8, 4), atol=1e-2)


@torch.no_grad()
@pytest.mark.parametrize("size", [(96, 160), (64, 32), (160, 224)])
def test_opposite_borders_of_a_photo_do_not_look_at_each_other(size: tuple[int, int]):
    """The finest map of Swin, two blocks deep: what changes is near the change, though the map is no whole windows."""
    pixels = noise(size, n=1)
    changed = pixels.clone()
    changed[..., -4:, -4:] = 0  # one token
    rows, columns = size[0] // 4, size[1] // 4
    moved = ((swin()(changed)[0] - swin()(pixels)[0]).abs().amax(1)[0] > 1e-6).nonzero()
    assert len(moved) > 1
    assert (moved >= torch.tensor([rows, columns]) - 14).all()
    expected = torch.tensor([reach(rows), reach(columns)])
    assert torch.equal(moved.min(dim=0).values, expected)


def reach(side: int) -> int:
    """The first token of a row that the last one reaches by a window of 7, and then by one shifted by 3."""
    first = (side - 1) // 7 * 7
    return max((first - 3) // 7 * 7 + 3, 0)


def test_every_second_block_is_shifted_at_every_stage():
    """Where one window would hold timm's own input as well."""
    blocks = [m for m in swin().modules() if isinstance(m, SwinTransformerBlock)]
    assert [block.window_size for block in blocks] == 12 * [(7, 7)]
    assert [block.shift_size for block in blocks] == 6 * [(0, 0), (3, 3)]


def test_blocks_are_skipped_while_training_more_often_the_deeper():
    rates = [m.drop_prob for m in PyramidEncoder(SWIN).modules() if type(m).__name__ == "DropPath"]
    assert rates == sorted(rates)
    assert rates[-1] == pytest.approx(0.3)
    assert len(set(rates)) == 11  # of 12 blocks: the first is never skipped
