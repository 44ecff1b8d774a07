"""Hugging Face ``transformers`` ZoeDepth (Intel/zoedepth-{nyu,kitti,nyu-kitti}): its weights, both ways."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.weights.layouts import huggingface_config as settings
from zoedepth.weights.layouts import original, shapes
from zoedepth.weights.layouts.keys import Row, Table


def _encoder_rows(layout: int) -> list[Row]:
    """Return the rows of the encoder. transformers 5 changed its names; there are files of both kinds."""
    if layout == 5:
        block, here = "backbone.beit.layers.{}", "encoder.network.blocks.{}"
        attention, embeddings = f"{block}.attention", "backbone.beit.embeddings"
        table, output = f"{block}.relative_position_bias", f"{attention}.o_proj"
        query, key, value = f"{attention}.q_proj", f"{attention}.k_proj", f"{attention}.v_proj"
        mlp = (f"{block}.mlp.fc1", f"{block}.mlp.fc2")
    else:
        block, here = "backbone.encoder.layer.{}", "encoder.network.blocks.{}"
        attention, embeddings = f"{block}.attention.attention", "backbone.embeddings"
        table, output = f"{attention}.relative_position_bias", f"{block}.attention.output.dense"
        query, key, value = f"{attention}.query", f"{attention}.key", f"{attention}.value"
        mlp = (f"{block}.intermediate.dense", f"{block}.output.dense")
    return [
        Row(f"{embeddings}.cls_token", "encoder.network.cls_token"),
        Row(f"{embeddings}.patch_embeddings.projection.*", "encoder.network.patch_embed.*"),
        Row((f"{query}.weight", f"{key}.weight", f"{value}.weight"), f"{here}.attn.qkv.weight"),
        Row(f"{query}.bias", f"{here}.attn.q_bias"),
        Row(f"{value}.bias", f"{here}.attn.v_bias"),
        Row(f"{output}.*", f"{here}.attn.proj.*"),
        Row(f"{table}.relative_position_bias_table", "encoder.network.position_tables.{}"),
        Row(f"{table}.relative_position_index", None),  # computed; transformers < 4.45 saved it
        Row(f"{block}.layernorm_before.*", f"{here}.norm1.*"),
        Row(f"{block}.layernorm_after.*", f"{here}.norm2.*"),
        Row(f"{mlp[0]}.*", f"{here}.mlp.fc1.*"),
        Row(f"{mlp[1]}.*", f"{here}.mlp.fc2.*"),
        Row(f"{block}.lambda_1", f"{here}.gamma_1"),
        Row(f"{block}.lambda_2", f"{here}.gamma_2"),
    ]


def _decoder_rows() -> list[Row]:
    # The first fusion layer, the coarsest, has no skip.
    rows = [Row("neck.fusion_stage.layers.0.residual_layer1.*", None)]
    for i in range(4):
        fusion = f"neck.fusion_stage.layers.{i}"
        rows += [
            Row(f"neck.reassemble_stage.readout_projects.{i}.0.*", f"decoder.reassemble.{i}.readout.*"),
            Row(f"neck.reassemble_stage.layers.{i}.projection.*", f"decoder.reassemble.{i}.project.*"),
            Row(f"neck.reassemble_stage.layers.{i}.resize.*", f"decoder.reassemble.{i}.resample.*"),
            Row(f"neck.convs.{i}.*", f"decoder.project.{i}.*"),
            Row(f"{fusion}.projection.*", f"decoder.fusion.{i}.project.*"),
        ]
        for unit, ours in (("residual_layer1", "skip"), ("residual_layer2", "refine")):
            for conv in (1, 2):
                row = Row(f"{fusion}.{unit}.convolution{conv}.*", f"decoder.fusion.{i}.{ours}.conv{conv}.*")
                rows.append(row)
    return [*rows, Row("relative_head.*", "decoder.relative_head.*")]


def _mlp(theirs: str, ours: str) -> list[Row]:
    """Return the rows of a two-layer perceptron. Their layers are 1 and 2, ours 0 and 2, with an activation between."""
    return [Row(f"{theirs}.conv1.*", f"{ours}.0.*"), Row(f"{theirs}.conv2.*", f"{ours}.2.*")]


def table(names: tuple[str, ...], *, layout: int) -> Table:
    """Return the table of transformers 4 (files on the Hub) or 5, for these heads in the router's order."""
    rows = [
        *_encoder_rows(layout),
        *_decoder_rows(),
        Row("metric_head.conv2.*", "shared.bottleneck.*"),
        *_mlp("metric_head.seed_projector", "shared.seed"),
        *_mlp("metric_head.projectors.{}", "shared.levels.{}"),
    ]
    if len(names) > 1:
        attention = "metric_head.patch_transformer.transformer_encoder.{}.self_attn"
        layer = "router.classifier.transformer.layers.{}"
        parts = ("query", "key", "value")
        rows += [
            Row("metric_head.patch_transformer.embedding_convPxP.*", "router.classifier.project.*"),
            Row(tuple(f"{attention}.{part}.weight" for part in parts), f"{layer}.self_attn.in_proj_weight"),
            Row(tuple(f"{attention}.{part}.bias" for part in parts), f"{layer}.self_attn.in_proj_bias"),
            Row("metric_head.patch_transformer.transformer_encoder.{}.*", f"{layer}.*"),
            Row("metric_head.mlp_classifier.linear1.*", "router.classifier.mlp.0.*"),
            Row("metric_head.mlp_classifier.linear2.*", "router.classifier.mlp.2.*"),
        ]
    for i, name in enumerate(names):
        if len(names) == 1:
            seed, attractors, probability = "seed_bin_regressor", "attractors", "conditional_log_binomial"
        else:
            seed, attractors = f"seed_bin_regressors.{name}", f"attractors.{name}"
            probability = f"conditional_log_binomial.{name}"
        rows += [
            *_mlp(f"metric_head.{seed}", f"heads.{i}.seed"),
            *_mlp(f"metric_head.{attractors}.{{}}", f"heads.{i}.attractors.{{}}.mlp"),
            Row(f"metric_head.{probability}.*", f"heads.{i}.probability.*"),
        ]
    return Table(rows)


def layout_of(names: Mapping[str, object]) -> int | None:
    """Return 4 or 5 for names of that version of transformers, None for other names."""
    if any(name.startswith("backbone.beit.") for name in names):
        return 5
    return 4 if any(name.startswith("backbone.encoder.layer.") for name in names) else None


def read(
    weights: Mapping[str, Tensor],
    config: Mapping[str, Any] | None,
    *,
    layout: int,
    preprocessor: Mapping[str, Any] | None = None,
) -> tuple[ModelConfig, dict[str, Tensor], Table]:
    """Return config, weights under our names, and the table, of a transformers checkpoint.

    Args:
        weights: its weights, under its names.
        config: its config.json; None: the shapes tell the config, as for the original.
        layout: 4 or 5, see ``layout_of``.
        preprocessor: its preprocessor_config.json, for the input size and how photos are brought to it.

    Raises:
        InputError: weights are unknown or missing, or the config is not a ZoeDepth's.
    """
    two_heads = any(name.startswith("metric_head.patch_transformer.") for name in weights)
    if config is None:
        names = table(tuple(original.DOMAINS.values()) if two_heads else ("nyu",), layout=layout)
        ours = names.to_ours(weights)
        with shapes.errors_named(names):
            return original.config_of(ours), ours, names
    bins = settings.heads_in(config)
    names = table(tuple(str(entry.get("name", "nyu")) for entry in bins), layout=layout)
    ours = names.to_ours(weights)
    with shapes.errors_named(names):
        return settings.read(config, ours, heads=bins, preprocessor=preprocessor), ours, names


# --- and back ---------------------------------------------------------------------------------------------------------


def write(config: ModelConfig, weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return a state dict that every transformers since 4.45 loads without a missing or an unexpected key.

    Raises:
        InputError: transformers has no such model.
    """
    if problems := original.refusals(config):
        raise InputError(f"transformers' ZoeDepth has no such model: {'; '.join(problems)}")
    names = tuple(original.DOMAINS.get(domain.name, domain.name) for domain in config.domains)
    theirs = table(names, layout=4).to_theirs(weights)
    width = config.decoder.widths[3]
    # Demanded, but no forward pass reads them.
    for conv in ("convolution1", "convolution2"):
        unit = f"neck.fusion_stage.layers.0.residual_layer1.{conv}"
        theirs[f"{unit}.weight"], theirs[f"{unit}.bias"] = torch.zeros(width, width, 3, 3), torch.zeros(width)
    return theirs
