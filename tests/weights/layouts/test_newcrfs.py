"""NeWCRFs: the names of its checkpoints."""

import pytest
import torch
from tests.weights.layouts.layouts import released, same

from zoedepth.build import build_model, without_memory
from zoedepth.config import INDOOR, BaselineConfig, NewCrfsNetworkConfig
from zoedepth.errors import InputError
from zoedepth.weights.layouts import newcrfs


def ours_of(network: NewCrfsNetworkConfig) -> dict[str, torch.Tensor]:
    """Names and shapes of our model, no memory."""
    with without_memory():
        return build_model(BaselineConfig(network)).state_dict()


def test_every_name_and_shape_is_that_of_our_model():
    theirs = released("newcrfs")
    assert newcrfs.is_newcrfs(theirs)
    config, ours, table = newcrfs.read(theirs)
    assert config == BaselineConfig(NewCrfsNetworkConfig(), domains=(INDOOR,))
    assert {name: x.shape for name, x in ours_of(NewCrfsNetworkConfig()).items()} == {
        name: x.shape for name, x in ours.items()
    }
    back = table.to_theirs(ours)
    kept = {name: x.shape for name, x in theirs.items() if not name.endswith("relative_position_index")}
    assert {name: x.shape for name, x in back.items()} == kept
    assert len(theirs) - len(kept) == 24 + 4 * 2  # one a block, computed


def test_levels_and_stages_keep_their_order():
    for ours, theirs in {
        "decoder.levels.0.blocks.1.attention.queries_keys.weight": "crf3.crf_layer.blocks.1.attn.qk.weight",
        "decoder.levels.3.values.bias": "crf0.proj_v.bias",
        "decoder.levels.2.norm.weight": "crf1.norm_crf.weight",
        "decoder.levels.1.blocks.0.mlp.2.bias": "crf2.crf_layer.blocks.0.mlp.fc2.bias",
        "decoder.seed.regions.3.2.weight": "decoder.psp_modules.3.1.gn.weight",
        "encoder.stages.layers_1.downsample.reduction.weight": "backbone.layers.0.downsample.reduction.weight",
        "encoder.stages.layers_3.blocks.1.attn.qkv.bias": "backbone.layers.3.blocks.1.attn.qkv.bias",
        "encoder.norms.2.bias": "backbone.norm2.bias",
    }.items():
        assert newcrfs.TABLE.theirs(ours) == (theirs,)


@pytest.mark.parametrize(
    "network",
    [
        NewCrfsNetworkConfig("swin_tiny_patch4_window7_224"),
        NewCrfsNetworkConfig("swin_small_patch4_window7_224", widths=(512, 256, 128, 64), attention_heads=(8, 4, 2, 1)),
        NewCrfsNetworkConfig("swin_base_patch4_window7_224", seed_width=256),
    ],
    ids=lambda network: network.encoder,
)
def test_encoder_and_widths_are_told_by_the_shapes(network: NewCrfsNetworkConfig):
    ours = ours_of(network)
    config, found, _ = newcrfs.read(newcrfs.TABLE.to_theirs(ours))
    assert config.network == network
    assert found.keys() == ours.keys()


def test_weights_of_a_wrapped_model_are_those_of_the_model():
    torch.manual_seed(0)
    network = NewCrfsNetworkConfig("swin_tiny_patch4_window7_224", (32, 16, 8, 8), (4, 2, 2, 1), 8)
    ours = build_model(BaselineConfig(network)).state_dict()
    wrapped = {f"module.{name}": value for name, value in newcrfs.TABLE.to_theirs(ours).items()}
    assert newcrfs.is_newcrfs(wrapped)
    config, found, table = newcrfs.read(wrapped)
    assert config.network == network
    assert same(found, ours)
    assert same(table.to_theirs(found), newcrfs.TABLE.to_theirs(ours))


def test_others_are_not_taken_for_it():
    for name in ("original-n", "huggingface-nk"):
        assert not newcrfs.is_newcrfs(released(name))
    assert not newcrfs.is_newcrfs({"backbone.patch_embed.proj.weight": torch.empty(1)})


def test_unknown_encoders_and_windows_are_refused():
    theirs = released("newcrfs")
    with pytest.raises(InputError, match=r"unknown weights: 'backbone\.absolute_pos_embed'"):
        newcrfs.read(theirs | {"backbone.absolute_pos_embed": torch.empty(1)})
    with pytest.raises(InputError, match=r"backbone\.patch_embed\.proj\.weight has 64 channels"):
        newcrfs.read(theirs | {"backbone.patch_embed.proj.weight": torch.empty(64, 3, 4, 4)})
    table = "backbone.layers.0.blocks.0.attn.relative_position_bias_table"
    with pytest.raises(InputError, match=rf"{table} has 529 rows, not those of windows of 7x7"):
        newcrfs.read(theirs | {table: torch.empty(529, 6)})
    del theirs["crf2.norm_crf.weight"]
    with pytest.raises(InputError, match=r"crf2\.norm_crf\.weight is missing"):
        newcrfs.read(theirs)
