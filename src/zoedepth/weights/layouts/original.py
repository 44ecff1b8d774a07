"""The checkpoints of isl-org/ZoeDepth (``ZoeD_M12_{N,K,NK}.pt``) and of people who trained with its code."""

from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from zoedepth.config import INDOOR, OUTDOOR, ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.beit import relative_position_index
from zoedepth.presets import PRESETS
from zoedepth.weights.layouts import midas, shapes
from zoedepth.weights.layouts.keys import Row, Table

CORE = "core.core."
DOMAINS = {"indoor": "nyu", "outdoor": "kitti"}
"""Our scene type → the data set that the original names its head after."""


def table(domains: tuple[str, ...]) -> Table:
    """Return the table of a checkpoint with these scene types, in the order of the router's scores."""
    if len(domains) == 1:
        return Table([
            *midas.rows(CORE),
            Row("conv2.*", "shared.bottleneck.*"),
            Row("seed_bin_regressor._net.*", "heads.0.seed.*"),
            Row("seed_projector._net.*", "shared.seed.*"),
            Row("projectors.{}._net.*", "shared.levels.{}.*"),
            Row("attractors.{}._net.*", "heads.0.attractors.{}.mlp.*"),
            Row("conditional_log_binomial.log_binomial_transform.k_idx", None),  # 0, 1, 2 ...
            Row("conditional_log_binomial.log_binomial_transform.K_minus_1", None),
            Row("conditional_log_binomial.*", "heads.0.probability.*"),
        ])  # fmt: skip
    rows = [
        *midas.rows(CORE),
        Row("conv2.*", "shared.bottleneck.*"),
        Row("patch_transformer.embedding_convPxP.*", "router.classifier.project.*"),
        Row("patch_transformer.transformer_encoder.layers.{}.*", "router.classifier.transformer.layers.{}.*"),
        Row("mlp_classifier.*", "router.classifier.mlp.*"),
        Row("seed_projector._net.*", "shared.seed.*"),
        Row("projectors.{}._net.*", "shared.levels.{}.*"),
    ]
    for i, domain in enumerate(domains):
        name = DOMAINS.get(domain, domain)
        rows += [
            Row(f"seed_bin_regressors.{name}._net.*", f"heads.{i}.seed.*"),
            Row(f"attractors.{name}.{{}}._net.*", f"heads.{i}.attractors.{{}}.mlp.*"),
            Row(f"conditional_log_binomial.{name}.log_binomial_transform.k_idx", None),
            Row(f"conditional_log_binomial.{name}.log_binomial_transform.K_minus_1", None),
            Row(f"conditional_log_binomial.{name}.*", f"heads.{i}.probability.*"),
        ]
    return Table(rows)


def is_original(names: Mapping[str, object]) -> bool:
    """Return True if these are the names of this layout."""
    return any(name.startswith(CORE) for name in names)


def read(weights: Mapping[str, Tensor]) -> tuple[ModelConfig, dict[str, Tensor], Table]:
    """Return config, weights under our names, and the table, of a state dict of the original.

    The checkpoint holds no config. Shapes tell the widths and counts; the rest (mean of the pulls, alpha 300,
    temperatures) is the same in all released models.

    Raises:
        InputError: weights are unknown or missing, or no such model has these shapes.
    """
    # The original fixes the router's names and their order.
    domains = ("indoor", "outdoor") if any(name.startswith("patch_transformer.") for name in weights) else ("indoor",)
    names = table(domains)
    ours = names.to_ours(weights)
    with shapes.errors_named(names):
        return config_of(ours), ours, names


def config_of(weights: Mapping[str, Tensor]) -> ModelConfig:
    """Return the config of a model of the original's code, told by the shapes of its weights under our names."""
    if any(name.startswith("router.") for name in weights):
        head = shapes.head(weights, centers="softplus")
        return shapes.model(weights, head=head, domains=(INDOOR, OUTDOOR), size=PRESETS["zoed-m12-nk"].size)
    n_points = shapes.attractor_channels(weights)
    if n_points == tuple(2 * n for n in shapes.attractors(PRESETS["zoed-m12-k"]).n_attractors):
        # Normed centers predict pairs of points. No checkpoint holds their range. The original's default of 10 m would
        # make every depth 8 times too small.
        head = shapes.head(weights, centers="normed")
        return shapes.model(weights, head=head, domains=(OUTDOOR,), size=PRESETS["zoed-m12-k"].size)
    head = shapes.head(weights, centers="softplus")
    return shapes.model(weights, head=head, domains=(INDOOR,), size=PRESETS["zoed-m12-n"].size)


def write(config: ModelConfig, weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return a state dict that the original's code loads strictly, unused weights included.

    Raises:
        InputError: the original's code has no such model.
    """
    problems = refusals(config)
    if config.resize != "keep-aspect":
        problems.append("a size that photos are squeezed to (give --compat squeeze where the file is loaded)")
    if not config.pad:
        problems.append("photos that are not padded (give pad=False to Predictor where it is loaded)")
    names = tuple(domain.name for domain in config.domains)
    router, kept = config.router, shapes.attractors(config)
    if len(names) == 2:
        fixed = {"attention heads": (router.attention_heads, 4), "router's MLP": (router.feedforward_width, 1024)}
    else:
        fixed = {"embedding_width": (kept.embedding_width, 128)}
    problems += differences(fixed)
    if len(names) == 2 and names != tuple(DOMAINS):
        problems.append(f"domains {names} (the original has {tuple(DOMAINS)} only)")
    # The original's code reads no config: the shapes alone must tell it this model.
    if not problems:
        again = config_of(weights)
        ratio = shapes.attractors(again).attractor_ratio
        if again.head != replace(kept, initial_centers="random", attractor_ratio=ratio):
            problems.append("a head whose kind cannot be told from its weights")
        elif (again.encoder.size, again.encoder.taps) != (config.encoder.size, config.encoder.taps):
            problems.append("an encoder whose size or taps cannot be told from its weights")
        elif kept.centers == "normed" and _range(again) != _range(config):
            problems.append(f"a depth range of {_range(config)} m (it takes {_range(again)} m for normed centers)")
    if problems:
        raise InputError(f"the original ZoeDepth has no such model: {'; '.join(problems)}")
    theirs = table(names).to_theirs(weights)
    return theirs | _unused(config, theirs)


def refusals(config: ModelConfig) -> list[str]:
    """Return the parts of a config that neither the original's code nor transformers can do."""
    head, released = shapes.attractors(config), shapes.attractors(PRESETS["zoed-m12-n"])
    embedding = head.embedding_width
    values: dict[str, tuple[object, object]] = {
        "encoder family": (config.encoder.family, "beit"),
        "output stride": (config.decoder.output_stride, 1),
        "decoder widths": (len(set(config.decoder.widths)), 1),
        "kind": (head.kind, released.kind),
        "alpha": (head.alpha, released.alpha),
        "gamma": (head.gamma, released.gamma),
        "probability": (head.probability, released.probability),
        "attractor ratio": (head.attractor_ratio and head.centers == "normed", False),
        "antialias": (config.antialias, False),
        "canonical camera": (config.canonical_camera, False),
    }
    if len(config.domains) > 1:
        values |= {
            "router": (config.router.kind in ("trained", "auto") and config.router.classifier, "transformer"),
            "relative input": (head.relative_input, False),
            "bottleneck factor": (head.bottleneck_factor, 4),
            "number of domains": (len(config.domains), 2),
            "projector_width": (head.projector_width, embedding // 2),
            "seed_width": (head.seed_width, embedding // 2),
            "n_attractors": (head.n_attractors, (16, 16, 16, 16)),
            "router.width": (config.router.width, 128),
        }
    else:
        values |= {
            "number of domains": (len(config.domains), 1),
            "relative input": (head.relative_input, True),
            "bottleneck factor": (head.bottleneck_factor, 2),
            "projector_width": (head.projector_width, 128),
            "seed_width": (head.seed_width, 256),
        }
    problems = differences(values)
    if config.router.vote != "image":
        problems.append(
            "a vote of the batch, which no file of theirs says (give --compat batch-vote where it is loaded)"
        )
    return problems


def differences(values: Mapping[str, tuple[object, object]]) -> list[str]:
    """Return a message for each name whose value (first) is not the only known one (second)."""
    return [f"{name} {value!r} (it has {known!r} only)" for name, (value, known) in values.items() if value != known]


def _range(config: ModelConfig) -> tuple[float, float]:
    return config.domains[0].min_depth, config.domains[0].max_depth


def _unused(config: ModelConfig, theirs: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Make up the weights that no forward pass reads and that the original's strict loading demands."""
    width, channels = config.decoder.widths[3], theirs[f"{CORE}pretrained.model.cls_token"].shape[-1]
    unused = {
        f"{CORE}scratch.refinenet4.resConfUnit1.{conv}.{kind}": torch.zeros(shape)
        for conv in ("conv1", "conv2")
        for kind, shape in (("weight", (width, width, 3, 3)), ("bias", (width,)))
    }
    model = f"{CORE}pretrained.model"
    unused |= {
        f"{model}.fc_norm.weight": torch.ones(channels),
        f"{model}.fc_norm.bias": torch.zeros(channels),
        f"{model}.head.weight": torch.zeros(1000, channels),
        f"{model}.head.bias": torch.zeros(1000),
    }
    index = relative_position_index((config.encoder.size[0] // 16, config.encoder.size[1] // 16))
    n_blocks = sum(name.endswith("relative_position_bias_table") for name in theirs)
    # The original pins a timm < 0.9.6, which demands them; a newer one needs strict=False. One tensor has 24 names.
    unused |= {f"{model}.blocks.{i}.attn.relative_position_index": index for i in range(n_blocks)}
    heads = [""] if len(config.domains) == 1 else [f"{DOMAINS.get(d.name, d.name)}." for d in config.domains]
    n_bins = shapes.attractors(config).n_bins
    for head in heads:
        transform = f"conditional_log_binomial.{head}log_binomial_transform"
        unused[f"{transform}.k_idx"] = torch.arange(n_bins).view(1, -1, 1, 1)
        unused[f"{transform}.K_minus_1"] = torch.tensor([float(n_bins - 1)]).view(1, -1, 1, 1)
    return unused
