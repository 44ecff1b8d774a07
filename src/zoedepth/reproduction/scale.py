"""How large a reproduction is: as in the paper, or small enough for two processor cores and one evening a table."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from zoedepth.config import (
    AnyModelConfig,
    AttractorConfig,
    BaselineConfig,
    EncoderConfig,
    LocalBinsNetworkConfig,
    ModelConfig,
    RouterConfig,
)
from zoedepth.presets import MINIATURE, PRESETS, with_encoder, with_focal_of_size
from zoedepth.recipes import RECIPES
from zoedepth.reproduction.tables import BaseName, Row
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig

SIZE = (160, 224)
"""(height, width) of the small comparisons."""
STEPS = 400
"""Steps of a small training for each of its data sets. At 100 the order of the rows means nothing."""
BATCH = 8
"""Samples in a step of a small training."""


@dataclass(frozen=True)
class Scale:
    """The size of a reproduction: how rows are trained, and with what pre-training."""

    name: str
    adapt: Callable[[Row], TrainConfig]
    """Makes the configuration of a row's training, but for its seed."""
    pretrain: Callable[[BaseName, ModelConfig], tuple[TrainConfig, ...]]
    """Makes the trainings, one after the other, of a pre-training for a model."""


def full(row: Row) -> TrainConfig:
    """Return a row's configuration as the paper has it."""
    config = row.config()
    if row.encoder is None or not isinstance(config.model, ModelConfig):
        return config
    return replace(config, model=with_encoder(config.model, row.encoder))


_STAGES: Mapping[BaseName, tuple[str, ...]] = {
    "X": (),
    "N": ("relative_n",),
    "K": ("relative_k",),
    "NK": ("relative_nk",),
    "M12": ("relative_m12_curated", "relative_m12"),
}


def full_base(base: BaseName, model: ModelConfig) -> tuple[TrainConfig, ...]:
    """Return the pre-trainings as the paper has them; none for X."""
    relative = relative_model(model, PRESETS["dpt-beit-large-384"].size)
    return tuple(replace(RECIPES[name](), model=relative) for name in _STAGES[base])


_OPTIM = OptimConfig(learning_rate=5e-4, encoder_factor=0.3, warmup=0.1, initial_division=20, clip=1.0)


def small(row: Row) -> TrainConfig:
    """Return the small twin of a row: the same head, router and routing, on an EfficientNet-Lite at 160x224.

    All small rows have one encoder, decoder, optimizer and augmentation: those of the recipe ``comparison``.
    """
    config = row.config()
    twin = replace(
        config,
        model=_small_model(config.model, row.encoder or MINIATURE.encoder.name),
        sources=tuple(
            replace(source, crop="fit", window=None, rotate_degrees=1.0, color_probability=0.8)
            for source in config.sources
        ),
        steps=STEPS * len(config.sources),
        batch_size=BATCH,
        optim=_OPTIM,
        loss_size="network",
        freeze_batch_norm=True,
    )
    return _quiet(twin)


_SMALL_SOURCES: Mapping[BaseName, tuple[str, ...]] = {
    "X": (),
    "N": ("nyu",),
    "K": ("kitti",),
    "NK": ("nyu", "kitti"),
    "M12": ("nyu", "kitti", "relative", "scenes"),
}
"""Pre-training → data sets; M12 stands for all that there is."""


def small_base(base: BaseName, model: ModelConfig) -> tuple[TrainConfig, ...]:
    """Return the small pre-training: one run over the data sets of the base; none for X."""
    names = _SMALL_SOURCES[base]
    if not names:
        return ()
    sources = tuple(
        SourceConfig(
            name, crop="fit", max_zoom=1.5, kitti_crop=name == "kitti", sparse=name == "kitti",
            gradient_term=name != "kitti", color_probability=0.8,
        )
        for name in names
    )  # fmt: skip
    optim = replace(_OPTIM, learning_rate=1e-3)
    config = TrainConfig("relative", relative_model(model, SIZE), sources, steps=STEPS, batch_size=BATCH, optim=optim)
    return (_quiet(config),)


FULL = Scale("full", full, full_base)
SMALL = Scale("small", small, small_base)


def _quiet(config: TrainConfig) -> TrainConfig:
    """Return a configuration without validation and pictures, that saves often: it may be killed at any moment.

    It computes in float32 everywhere: "auto" is bfloat16 on some of the machines that may share the rows.
    """
    return replace(
        config,
        precision="32-true",
        validate_every=10**6,
        pictures=0,
        checkpoint_every=50,
        keep_checkpoints=1,
        n_workers=2,
    )


def relative_model(model: ModelConfig, size: tuple[int, int]) -> ModelConfig:
    """Return encoder and decoder of a model, without heads: the same for all rows that differ in the head alone.

    Args:
        model: the model of a row.
        size: (height, width) to train at; a Swin takes its own only.
    """
    size = model.encoder.size if model.one_size else size
    return replace(model, domains=(), head=AttractorConfig(), router=RouterConfig(), size=size)


def _small_model(model: AnyModelConfig, encoder: str) -> AnyModelConfig:
    if isinstance(model, BaselineConfig):
        network = replace(model.network, encoder=encoder)
        if isinstance(network, LocalBinsNetworkConfig):
            network = replace(network, n_windows=20)  # a tenth
        size = (SIZE[0] + 1, SIZE[1] + 1) if model.one_size else SIZE
        return replace(model, network=network, size=size, antialias=True)
    small = replace(
        model, encoder=_encoder(encoder), decoder=MINIATURE.decoder, size=SIZE, antialias=True, pad=False
    )  # fmt: skip
    return with_focal_of_size(small, model)


def _encoder(name: str) -> EncoderConfig:
    return with_encoder(MINIATURE, name).encoder
