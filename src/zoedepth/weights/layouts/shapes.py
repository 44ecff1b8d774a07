"""Tell the config of a model by the shapes of its weights, which have our names."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from torch import Tensor

from zoedepth.config import (
    AttractorConfig,
    DecoderConfig,
    Domain,
    EncoderConfig,
    ModelConfig,
    RouterConfig,
)
from zoedepth.errors import InputError
from zoedepth.model.beit import PATCH
from zoedepth.presets import ENCODERS, in_training_cameras
from zoedepth.weights.layouts.keys import Table

Weights = Mapping[str, Tensor]


def model(
    weights: Weights,
    *,
    head: AttractorConfig,
    domains: tuple[Domain, ...],
    size: tuple[int, int],
    encoder: EncoderConfig | None = None,
    attention_heads: int = 4,
) -> ModelConfig:
    """Return the config of a whole model with the given scene types, whose metres are taken to be NYU's and KITTI's.

    Args:
        weights: weights under our names.
        head, domains, size: see ``ModelConfig``.
        encoder: its config; None: told by the shapes.
        attention_heads: attention heads of the router, if there are several domains.

    Raises:
        InputError: a weight that tells something is missing, or no such model exists.
    """
    return in_training_cameras(
        ModelConfig(
            encoder or beit(weights),
            decoder=decoder(weights),
            head=head,
            router=router(weights, attention_heads=attention_heads) if len(domains) > 1 else RouterConfig(),
            domains=domains,
            size=size,
        )
    )


def beit(
    weights: Weights, *, native: tuple[int, int] | None = None, taps: tuple[int, ...] | None = None
) -> EncoderConfig:
    """Return the config of the BEiT: one of ``presets.ENCODERS`` if the widths fit, else a config of these widths.

    Args:
        weights: weights under our names.
        native: (height, width) in pixels that the position tables were made for; None: square.
        taps: blocks that maps are taken from; None: the last of each quarter, as in all of MiDaS.
    """
    n_rows, heads = shape_of(weights, "encoder.network.position_tables.0", 2)
    width = shape_of(weights, "encoder.network.cls_token", 3)[2]
    n_blocks = count_of(weights, "encoder.network.position_tables.{}")
    hidden = shape_of(weights, "encoder.network.blocks.0.mlp.fc1.weight", 2)[0]
    channels = tuple(shape_of(weights, f"decoder.reassemble.{i}.project.weight", 4)[0] for i in range(4))
    if native is None:
        side = math.isqrt(max(n_rows - 3, 0))
        if side**2 + 3 != n_rows or side % 2 == 0:
            raise InputError(
                f"position tables of {n_rows} rows are not those of a square picture: a config is needed, put "
                "config.json beside the weights"
            )
        native = (PATCH * (side + 1) // 2, PATCH * (side + 1) // 2)
    if taps is None:
        if n_blocks < 4 or n_blocks % 4:
            raise InputError(
                f"{n_blocks} encoder blocks have no four quarters: a config is needed, put config.json beside the "
                "weights"
            )
        taps = tuple(n_blocks * (i + 1) // 4 - 1 for i in range(4))
    for known, (known_width, known_heads) in _KNOWN.items():
        config = ENCODERS[known]
        found = (config.size, config.taps, config.channels, known_width, known_heads, 4 * known_width)
        if found == (native, taps, channels, width, heads, hidden):
            return config
    return EncoderConfig(
        "beit_base_patch16_384",
        "beit",
        size=native,
        taps=taps,
        channels=channels,
        width=width,
        depth=(n_blocks,),
        heads=(heads,),
        mlp_width=hidden,
    )


_KNOWN = {
    "beit_large_patch16_384": (1024, 16),
    "beit_large_patch16_512": (1024, 16),
    "beit_base_patch16_384": (768, 12),
}
"""Name of a released encoder → its width and heads. timm knows them too, but only after building a model."""


def attractors(config: ModelConfig) -> AttractorConfig:
    """Return the config of the attractor head, the only kind that other people's layouts can hold.

    Raises:
        InputError: the model has another kind of head.
    """
    if not isinstance(config.head, AttractorConfig):
        raise InputError(
            f"other layouts than ours hold attractor heads only, not {type(config.head).__name__}: write the zoedepth "
            "layout"
        )
    return config.head


def decoder(weights: Weights) -> DecoderConfig:
    """Return the config of the DPT decoder."""
    widths = [shape_of(weights, f"decoder.project.{i}.weight", 4)[0] for i in range(4)]
    features = shape_of(weights, "decoder.relative_head.conv2.weight", 4)[0]
    return DecoderConfig(widths=(widths[0], widths[1], widths[2], widths[3]), features=features)


def attractor_channels(weights: Weights) -> tuple[int, ...]:
    """Return the output channels of the four attractor layers: points, or pairs of points for normed centers."""
    return tuple(shape_of(weights, f"heads.0.attractors.{i}.mlp.2.weight", 4)[0] for i in range(4))


def head(
    weights: Weights,
    *,
    centers: str,
    reduce: str = "mean",
    min_temperature: float = 0.0212,
    max_temperature: float = 50.0,
) -> AttractorConfig:
    """Return the config of the metric head. No shape tells the keywords; their defaults are the released models'."""
    counts = attractor_channels(weights)
    if centers == "normed":
        if any(count % 2 for count in counts):
            raise InputError(f"normed attractors come in pairs; the layers give {counts}")
        counts = tuple(count // 2 for count in counts)
    hidden, inputs = shape_of(weights, "heads.0.probability.mlp.0.weight", 4)[:2]
    embedding, projector = shape_of(weights, "shared.seed.2.weight", 4)[:2]
    seed = shape_of(weights, "heads.0.seed.2.weight", 4)
    extra = inputs - embedding - shape_of(weights, "decoder.relative_head.conv2.weight", 4)[0]
    if extra not in (0, 1) or not 0 < hidden <= inputs:
        problem = f"takes {inputs} channels to {hidden}, which fits none of its inputs"
        raise WeightError("heads.0.probability.mlp.0.weight", problem)
    return AttractorConfig(
        n_bins=seed[0],
        n_attractors=(counts[0], counts[1], counts[2], counts[3]),
        reduce="sum" if reduce == "sum" else "mean",
        centers="normed" if centers == "normed" else "softplus",
        # The released code overwrites the ratio by its first member; for softplus there is none.
        attractor_ratio=centers != "normed",
        relative_input=extra == 1,
        bottleneck_factor=inputs // hidden,
        min_temperature=min_temperature,
        max_temperature=max_temperature,
        embedding_width=embedding,
        projector_width=projector,
        seed_width=seed[1],
    )


def router(weights: Weights, *, attention_heads: int) -> RouterConfig:
    """Return the config of the transformer router."""
    width = shape_of(weights, "router.classifier.project.weight", 4)[0]
    hidden = shape_of(weights, "router.classifier.transformer.layers.0.linear1.weight", 2)[0]
    return RouterConfig(
        "trained",
        classifier="transformer",
        width=width,
        attention_heads=attention_heads,
        feedforward_width=hidden,
    )


def shape_of(weights: Weights, name: str, n_axes: int) -> tuple[int, ...]:
    """Return the shape of one of our weights, which must have ``n_axes`` axes.

    Raises:
        WeightError: the weight is missing, is empty, or has another number of axes.
    """
    if name not in weights:
        raise WeightError(name, "is missing")
    shape = tuple(weights[name].shape)
    if len(shape) != n_axes or 0 in shape:
        raise WeightError(name, f"has the shape {shape}; {n_axes} axes are expected")
    return shape


def count_of(weights: Weights, pattern: str) -> int:
    """Count the weights of a numbered name, from 0."""
    n = 0
    while pattern.format(n) in weights:
        n += 1
    return n


class WeightError(InputError):
    """Error about a weight that does not tell the config.

    Args:
        name: our name of the weight.
        problem: rest of the sentence that begins with the name.
    """

    def __init__(self, name: str, problem: str) -> None:
        super().__init__(f"{name} {problem}")
        self.name = name
        self.problem = problem

    def __reduce__(self) -> "tuple[type[WeightError], tuple[str, str]]":
        return type(self), (self.name, self.problem)


@contextmanager
def errors_named(table: Table) -> Iterator[None]:
    """Make a ``WeightError`` inside use the file's name of the weight."""
    try:
        yield
    except WeightError as error:
        raise WeightError("/".join(table.theirs(error.name)) or error.name, error.problem) from error
