"""Both stages, small enough for a coffee break: rendered scenes of 96x128, a minute or two on two cores."""

from dataclasses import replace

from zoedepth.presets import MINIATURE, with_focal_of_size
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig

_MODEL = with_focal_of_size(replace(MINIATURE, size=(96, 128)), MINIATURE)
_SCENES = SourceConfig("scenes", crop="fit", max_zoom=1.2, rotate_degrees=2.0)
_OPTIM = OptimConfig(learning_rate=1e-3, encoder_factor=0.3, warmup=0.1, initial_division=20, clip=1.0)


def relative() -> TrainConfig:
    """Return the recipe of stage 1 in ``zoedepth demo-train``."""
    return TrainConfig(
        stage="relative",
        model=_MODEL,
        sources=(_SCENES,),
        steps=60,
        batch_size=8,
        optim=_OPTIM,
        holdout=12,
        validate_every=15,
        log_every=5,
    )


def metric() -> TrainConfig:
    """Return the recipe of stage 2 in ``zoedepth demo-train``, which starts from stage 1."""
    return replace(relative(), stage="metric", steps=120, domain_weight=1.0, ema_decay=0.95, validate_every=20)
