"""MiDaS v3.1 DPT-BEiT (isl-org/MiDaS ``dpt_beit_*.pt``): the encoder and decoder of ZoeDepth before stage 2."""

from collections.abc import Mapping
from dataclasses import replace

from torch import Tensor

from zoedepth.config import ModelConfig
from zoedepth.presets import PRESETS
from zoedepth.weights.layouts import shapes
from zoedepth.weights.layouts.keys import Row, Table


def rows(prefix: str = "") -> list[Row]:
    """Return the rows of encoder and decoder. The original ZoeDepth has them under ``core.core.``."""
    network, scratch = f"{prefix}pretrained.model", f"{prefix}scratch"
    table = [
        Row(f"{network}.cls_token", "encoder.network.cls_token"),
        Row(f"{network}.patch_embed.proj.*", "encoder.network.patch_embed.*"),
        Row(f"{network}.blocks.{{}}.attn.relative_position_bias_table", "encoder.network.position_tables.{}"),
        Row(f"{network}.blocks.{{}}.attn.relative_position_index", None),  # computed; timm < 0.9.6 saved it
        Row(f"{network}.blocks.{{}}.*", "encoder.network.blocks.{}.*"),
        Row(f"{network}.fc_norm.*", None),  # the ImageNet classifier
        Row(f"{network}.head.*", None),
        Row(f"{scratch}.refinenet4.resConfUnit1.*", None),  # the coarsest fusion block has no skip
    ]
    for i in range(4):
        reassemble, refine = f"{prefix}pretrained.act_postprocess{i + 1}", f"{scratch}.refinenet{i + 1}"
        table += [
            Row(f"{reassemble}.0.project.0.*", f"decoder.reassemble.{i}.readout.*"),
            Row(f"{reassemble}.3.*", f"decoder.reassemble.{i}.project.*"),
            Row(f"{reassemble}.4.*", f"decoder.reassemble.{i}.resample.*"),
            Row(f"{scratch}.layer{i + 1}_rn.*", f"decoder.project.{i}.*"),
            # Ours go from coarse to fine.
            Row(f"{refine}.resConfUnit1.*", f"decoder.fusion.{3 - i}.skip.*"),
            Row(f"{refine}.resConfUnit2.*", f"decoder.fusion.{3 - i}.refine.*"),
            Row(f"{refine}.out_conv.*", f"decoder.fusion.{3 - i}.project.*"),
        ]
    return [
        *table,
        Row(f"{scratch}.output_conv.0.*", "decoder.relative_head.conv1.*"),
        Row(f"{scratch}.output_conv.2.*", "decoder.relative_head.conv2.*"),
        Row(f"{scratch}.output_conv.4.*", "decoder.relative_head.conv3.*"),
    ]


TABLE = Table(rows())


def read(weights: Mapping[str, Tensor]) -> tuple[ModelConfig, dict[str, Tensor], Table]:
    """Return config, weights under our names, and the table, of a MiDaS state dict: a model without metric heads.

    Raises:
        InputError: weights are unknown or missing, as for MiDaS's other encoders (Swin, LeViT, ResNeXt).
    """
    ours = TABLE.to_ours(weights)
    with shapes.errors_named(TABLE):
        encoder, decoder = shapes.beit(ours), shapes.decoder(ours)
    return replace(PRESETS["dpt-beit-large-384"], encoder=encoder, decoder=decoder, size=encoder.size), ours, TABLE
