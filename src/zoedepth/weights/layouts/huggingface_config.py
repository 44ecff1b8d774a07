"""``config.json`` and ``preprocessor_config.json`` of Hugging Face ``transformers`` ZoeDepth, both ways."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from torch import Tensor

from zoedepth.config import INDOOR, AttractorConfig, Domain, ModelConfig
from zoedepth.errors import InputError
from zoedepth.presets import PRESETS, in_training_cameras
from zoedepth.weights.layouts import original, shapes

LAYER_NORM_EPS = 1e-6
"""LayerNorm eps that BEiT was trained with. The published folders do not say it; transformers then takes 1e-12."""


def heads_in(config: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the entries of ``bin_configurations``, one a head."""
    bins = config.get("bin_configurations") or [{"n_bins": 64, "min_depth": 1e-3, "max_depth": 10.0}]
    if not isinstance(bins, list) or not all(isinstance(entry, dict) for entry in bins):
        raise InputError("bin_configurations in config.json must be a list of objects")
    if len(bins) > 1 and not all(isinstance(entry.get("name"), str) for entry in bins):
        raise InputError("bin_configurations in config.json must name every head")
    if len(bins) > 2:
        raise InputError(f"bin_configurations in config.json has {len(bins)} heads; transformers routes between two")
    return bins


def read(
    config: Mapping[str, Any],
    weights: Mapping[str, Tensor],
    *,
    heads: list[dict[str, Any]],
    preprocessor: Mapping[str, Any] | None = None,
) -> ModelConfig:
    """Return our config. Whatever shapes tell is read from them; strict loading compares all of them later."""
    size = size_in(preprocessor)
    backbone = config.get("backbone_config") or {}
    if not isinstance(backbone, dict):
        raise InputError("backbone_config in config.json must be an object")
    _refuse_other_structure(config, backbone)
    centers = config.get("bin_centers_type", "softplus")
    if centers not in ("softplus", "normed"):
        raise InputError(f"bin_centers_type {centers!r} in config.json: transformers has softplus and normed only")
    head = shapes.head(
        weights,
        centers=centers,
        reduce=str(config.get("attractor_kind", "mean")),
        min_temperature=_number(config, "min_temp", 0.0212),
        max_temperature=_number(config, "max_temp", 50.0),
    )
    attention_heads = config.get("patch_transformer_num_attention_heads")
    model = shapes.model(
        weights,
        head=head,
        domains=tuple(_domain(entry) for entry in heads),
        size=size or PRESETS["zoed-m12-n"].size,
        encoder=shapes.beit(weights, native=_native(backbone), taps=_taps(backbone)),
        attention_heads=attention_heads if isinstance(attention_heads, int) else 4,
    )
    model = replace(
        model,
        resize="keep-aspect" if _switch(preprocessor, "keep_aspect_ratio", True) else "squeeze",
        pad=_switch(preprocessor, "do_pad", True),
    )
    if len(heads) == 1 and "focal_px" not in heads[0]:  # only we write it, and of our own files all is believed
        model = _as_released(model, size=size)
    return _with_ours(in_training_cameras(model), heads)


def _with_ours(model: ModelConfig, heads: list[dict[str, Any]]) -> ModelConfig:
    """Give the domains the fields that config.json has of ours; transformers does not know them, but keeps them."""
    domains = [
        replace(
            domain,
            focal_px=_focal_px(entry) if "focal_px" in entry else domain.focal_px,
            std_factor=_number(entry, "std_factor", domain.std_factor),
        )
        for entry, domain in zip(heads, model.domains, strict=True)
    ]
    return replace(model, domains=tuple(domains))


def _focal_px(entry: Mapping[str, Any]) -> float | None:
    """Return the focal length that a head has, None where its file says that nobody knows it."""
    return None if entry["focal_px"] is None else _number(entry, "focal_px", 0.0)


def _as_released(model: ModelConfig, *, size: tuple[int, int] | None) -> ModelConfig:
    """Give the published ZoeD-K the domain and range that it was trained at, and its size if no file says another.

    Its published config.json says "nyu" and 10 m, the defaults of the original's code; with 10 m every depth is 8 times
    too small. Other ranges are believed: somebody has corrected the file, and hardly the name, too. A model of exactly
    these sizes is the published one: transformers cannot train ZoeDepth.
    """
    released = PRESETS["zoed-m12-k"]
    alike = replace(model, domains=released.domains, size=released.size, resize=released.resize, pad=released.pad)
    domain = model.domains[0]
    if alike != released or domain.name not in original.DOMAINS:
        return model
    if domain.max_depth == 10.0:
        warnings.warn(
            "config.json says that this ZoeD-K reaches 10 m; it was trained to 80 m, and that is used: a depth d of "
            "transformers becomes (d - 0.001) * 79.999 / 9.999 + 0.001. For the range of 10 m give compat=['10m']",
            stacklevel=2,
        )
        domain = released.domains[0]
    elif domain.name == INDOOR.name:
        domain = replace(domain, name=released.domains[0].name)
    return replace(model, domains=(domain,), size=size or released.size)


def _refuse_other_structure(config: Mapping[str, Any], backbone: Mapping[str, Any]) -> None:
    """Refuse values that change the network without changing any shape."""
    known = {
        "readout_type": (config, "project"),
        "reassemble_factors": (config, [4, 2, 1, 0.5]),
        "use_batch_norm_in_fusion_residual": (config, False),
        "add_projection": (config, False),
        "head_in_index": (config, -1),
        "hidden_act": (backbone, "gelu"),
        "patch_size": (backbone, 16),
        "use_absolute_position_embeddings": (backbone, False),
        "use_shared_relative_position_bias": (backbone, False),
    }
    for name, (values, expected) in known.items():
        found = values.get(name, expected)
        if (list(found) if isinstance(found, tuple) else found) != expected:
            raise InputError(f"{name} in config.json is {found!r}, but only {expected!r} can be loaded")
    if backbone.get("model_type", "beit") != "beit":
        raise InputError(f"the backbone in config.json is {backbone['model_type']!r}, but only 'beit' can be loaded")


def _number(config: Mapping[str, Any], name: str, default: float) -> float:
    value = config.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name} in config.json must be a number, not {value!r}")
    return float(value)


def _switch(preprocessor: Mapping[str, Any] | None, name: str, default: bool) -> bool:
    value = (preprocessor or {}).get(name, default)
    if not isinstance(value, bool):
        raise InputError(f"{name} in preprocessor_config.json must be true or false, not {value!r}")
    return value


def _domain(entry: Mapping[str, Any]) -> Domain:
    names = {theirs: ours for ours, theirs in original.DOMAINS.items()}
    name = str(entry.get("name", "nyu"))
    return Domain(
        names.get(name, name),
        _number(entry, "min_depth", INDOOR.min_depth),
        _number(entry, "max_depth", INDOOR.max_depth),
    )


def _native(backbone: Mapping[str, Any]) -> tuple[int, int]:
    side = backbone.get("image_size", 384)
    if isinstance(side, int):
        return side, side
    if not isinstance(side, list | tuple) or len(side) != 2 or not all(isinstance(n, int) for n in side):
        raise InputError(f"image_size of the backbone in config.json must be one or two integers, not {side!r}")
    # transformers, like MiDaS, reads the position table of a (height, width) picture as one of (width, height). For the
    # square released models it makes no difference. The swap here gives the same numbers for all others.
    return side[1], side[0]


def _taps(backbone: Mapping[str, Any]) -> tuple[int, ...] | None:
    """Return the blocks whose outputs are used: "stage6" is the output of the sixth block, index 5."""
    stages = backbone.get("out_features")
    numbers = backbone.get("out_indices")
    if isinstance(stages, list) and all(isinstance(s, str) and s[5:].isdecimal() for s in stages):
        numbers = [int(stage[5:]) for stage in stages]
    if numbers is None:
        return None
    if not isinstance(numbers, list) or len(numbers) != 4 or not all(isinstance(n, int) for n in numbers):
        raise InputError(f"the backbone in config.json must give four stages, not {numbers!r}")
    return tuple(number - 1 for number in numbers)


def size_in(preprocessor: Mapping[str, Any] | None) -> tuple[int, int] | None:
    """Return the size of photos in a preprocessor_config.json, None if it has none."""
    size = (preprocessor or {}).get("size")
    if not isinstance(size, dict):
        return None
    height, width = size.get("height"), size.get("width")
    return (height, width) if isinstance(height, int) and isinstance(width, int) else None


# --- and back ---------------------------------------------------------------------------------------------------------


def to_json(config: ModelConfig, weights: Mapping[str, Tensor]) -> dict[str, Any]:
    """Return the config.json that belongs to ``huggingface.write``, given the weights under our names."""
    encoder, head = config.encoder, shapes.attractors(config)
    heads = weights["encoder.network.position_tables.0"].shape[1]
    n_blocks = sum(name.startswith("encoder.network.position_tables.") for name in weights)
    hidden, width = weights["encoder.network.blocks.0.mlp.fc1.weight"].shape
    height, side = encoder.size[1], encoder.size[0]  # see _native
    # A model that could be taken for the published ZoeD-K always says its focal length, so that its range is believed.
    alone = len(config.domains) == 1 and head.centers == "normed"
    values: dict[str, Any] = {
        "architectures": ["ZoeDepthForDepthEstimation"],
        "model_type": "zoedepth",
        "backbone_config": {
            "model_type": "beit",
            "image_size": side if height == side else [height, side],
            "patch_size": 16,
            "hidden_size": width,
            "intermediate_size": hidden,
            "num_hidden_layers": n_blocks,
            "num_attention_heads": heads,
            "layer_norm_eps": LAYER_NORM_EPS,
            "use_relative_position_bias": True,
            "reshape_hidden_states": False,
            "out_features": [f"stage{tap + 1}" for tap in encoder.taps],
        },
        "neck_hidden_sizes": list(encoder.channels),
        "fusion_hidden_size": config.decoder.widths[0],
        "bottleneck_features": config.decoder.widths[3],
        "num_relative_features": config.decoder.features,
        "readout_type": "project",
        "reassemble_factors": [4, 2, 1, 0.5],
        "bin_configurations": [
            {
                "name": original.DOMAINS.get(domain.name, domain.name),
                "n_bins": head.n_bins,
                "min_depth": domain.min_depth,
                "max_depth": domain.max_depth,
                # Not transformers': they are ours, where they are not those of the published models.
                **({} if domain.focal_px == taken and not alone else {"focal_px": domain.focal_px}),
                **({} if domain.std_factor == 1 else {"std_factor": domain.std_factor}),
            }
            for domain, taken in zip(config.domains, _taken_focals(config), strict=True)
        ],
        "torch_dtype": "float32",
    }
    values |= _head_json(head)
    if len(config.domains) > 1:
        values |= {
            "num_patch_transformer_layers": 4,
            "patch_transformer_hidden_size": config.router.width,
            "patch_transformer_intermediate_size": config.router.feedforward_width,
            "patch_transformer_num_attention_heads": config.router.attention_heads,
        }
    return values


def _taken_focals(config: ModelConfig) -> list[float | None]:
    """Return for each domain the focal length that ``read`` takes where config.json says none."""
    return [domain.focal_px for domain in in_training_cameras(config).domains]


def _head_json(head: AttractorConfig) -> dict[str, Any]:
    return {
        "bin_embedding_dim": head.embedding_width,
        "bin_centers_type": head.centers,
        "num_attractors": list(head.n_attractors),
        "attractor_kind": head.reduce,
        "attractor_alpha": 1000,  # as published; transformers, like the original, always uses 300
        "attractor_gamma": 2,
        "min_temp": head.min_temperature,
        "max_temp": head.max_temperature,
    }


def preprocessor_json(config: ModelConfig) -> dict[str, Any]:
    """Return preprocessor_config.json: the padding, resizing and normalisation of the original."""
    return {
        "image_processor_type": "ZoeDepthImageProcessor",
        "do_pad": config.pad,
        "do_rescale": True,
        "rescale_factor": 1 / 255,
        "do_resize": True,
        "size": {"height": config.size[0], "width": config.size[1]},
        "keep_aspect_ratio": config.keep_aspect_ratio,
        "ensure_multiple_of": config.multiple,
        "resample": 2,  # bilinear
        "do_normalize": True,
        "image_mean": [0.5, 0.5, 0.5],
        "image_std": [0.5, 0.5, 0.5],
    }
