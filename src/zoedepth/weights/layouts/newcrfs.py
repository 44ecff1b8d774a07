"""NeWCRFs (aliyun/NeWCRFs ``model_nyu.ckpt``, ``model_kittieigen.ckpt``): the baseline as its authors published it."""

from collections.abc import Mapping

from torch import Tensor

from zoedepth.config import BaselineConfig, NewCrfsNetworkConfig
from zoedepth.model.heads.newcrfs import NATIVE_WINDOW
from zoedepth.weights.layouts import shapes
from zoedepth.weights.layouts.keys import Row, Table, unwrapped

_SWIN = {
    (96, 6): "swin_tiny_patch4_window7_224",
    (96, 18): "swin_small_patch4_window7_224",
    (128, 18): "swin_base_patch4_window7_224",
    (192, 18): "swin_large_patch4_window7_224",
}
"""Width of the first stage, blocks of the third → timm's name."""


def rows() -> list[Row]:
    """Return the rows of Swin, pyramid pooling, four levels and last convolution."""
    swin = "backbone.layers.{}.blocks.{}"
    table = [
        Row("backbone.patch_embed.*", "encoder.stages.patch_embed.*"),
        Row(f"{swin}.attn.relative_position_index", None),  # computed
        Row(f"{swin}.*", "encoder.stages.layers_{}.blocks.{}.*"),
        # Their stages end by halving the map, timm's begin with it.
        *(Row(f"backbone.layers.{i}.downsample.*", f"encoder.stages.layers_{i + 1}.downsample.*") for i in range(3)),
        Row("backbone.norm{}.*", "encoder.norms.{}.*"),
        Row("decoder.psp_modules.{}.1.conv.*", "decoder.seed.regions.{}.1.*"),
        Row("decoder.psp_modules.{}.1.gn.*", "decoder.seed.regions.{}.2.*"),
        Row("decoder.bottleneck.conv.*", "decoder.seed.join.0.*"),
        Row("decoder.bottleneck.bn.*", "decoder.seed.join.1.*"),
    ]
    for i in range(4):
        # Ours go from coarse to fine.
        theirs, ours = f"crf{3 - i}", f"decoder.levels.{i}"
        block, ours_block = f"{theirs}.crf_layer.blocks.{{}}", f"{ours}.blocks.{{}}"
        table += [
            Row(f"{theirs}.proj_x.*", f"{ours}.features.*"),
            Row(f"{theirs}.proj_v.*", f"{ours}.values.*"),
            Row(f"{block}.attn.relative_position_index", None),
            Row(f"{block}.norm1.*", f"{ours_block}.norm1.*"),
            Row(f"{block}.attn.relative_position_bias_table", f"{ours_block}.attention.bias_table"),
            Row(f"{block}.attn.qk.*", f"{ours_block}.attention.queries_keys.*"),
            Row(f"{block}.attn.proj.*", f"{ours_block}.attention.project.*"),
            Row(f"{block}.norm2.*", f"{ours_block}.norm2.*"),
            Row(f"{block}.mlp.fc1.*", f"{ours_block}.mlp.0.*"),
            Row(f"{block}.mlp.fc2.*", f"{ours_block}.mlp.2.*"),
            Row(f"{theirs}.norm_crf.*", f"{ours}.norm.*"),
        ]
    return [*table, Row("disp_head1.conv1.*", "depth.conv.*")]


TABLE = Table(rows())


def is_newcrfs(weights: Mapping[str, Tensor]) -> bool:
    """Return True if these are the names of this layout."""
    return {"backbone.patch_embed.proj.weight", "crf3.crf_layer.blocks.0.attn.qk.weight"} <= unwrapped(weights).keys()


def read(weights: Mapping[str, Tensor]) -> tuple[BaselineConfig, dict[str, Tensor], Table]:
    """Return config, weights under our names, and the table, of a NeWCRFs state dict.

    No weight tells the depth range: NYU's is taken (10 m).

    Raises:
        InputError: weights are unknown or missing, or the encoder is not a Swin with windows of 7x7.
    """
    ours = TABLE.to_ours(unwrapped(weights))
    with shapes.errors_named(TABLE):
        network = _network(ours)
    return BaselineConfig(network=network), ours, TABLE


def _network(ours: Mapping[str, Tensor]) -> NewCrfsNetworkConfig:
    name = "encoder.stages.patch_embed.proj.weight"
    width = shapes.shape_of(ours, name, 4)[0]
    n_blocks = shapes.count_of(ours, "encoder.stages.layers_2.blocks.{}.attn.qkv.weight")
    if (width, n_blocks) not in _SWIN:
        raise shapes.WeightError(
            name, f"has {width} channels, and the third stage {n_blocks} blocks; the known pairs are {sorted(_SWIN)}"
        )
    tables = ["encoder.stages.layers_0.blocks.0.attn.relative_position_bias_table"]
    tables += [f"decoder.levels.{i}.blocks.0.attention.bias_table" for i in range(4)]
    sizes = [shapes.shape_of(ours, table, 2) for table in tables]
    for table, (n_rows, _) in zip(tables, sizes, strict=True):
        if n_rows != (2 * NATIVE_WINDOW - 1) ** 2:
            raise shapes.WeightError(
                table, f"has {n_rows} rows, not those of windows of {NATIVE_WINDOW}x{NATIVE_WINDOW}"
            )
    widths = [shapes.shape_of(ours, f"decoder.levels.{i}.norm.weight", 1)[0] for i in range(4)]
    heads = [n_heads for _, n_heads in sizes[1:]]
    return NewCrfsNetworkConfig(
        encoder=_SWIN[width, n_blocks],
        widths=(widths[0], widths[1], widths[2], widths[3]),
        attention_heads=(heads[0], heads[1], heads[2], heads[3]),
        seed_width=shapes.shape_of(ours, "decoder.seed.join.1.weight", 1)[0],
    )
