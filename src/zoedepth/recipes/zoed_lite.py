"""The trainings of ``zoed-lite``, the model in the package: stage 1, then stage 2 on small photos, then at its size."""

from dataclasses import replace

from zoedepth.presets import ZOED_LITE, with_focal_of_size
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig

_INDOOR = SourceConfig(
    "indoor",
    weight=3,
    crop="fit",
    max_zoom=1.5,
    rotate_degrees=4.0,
    color_probability=0.8,
    gamma=(0.8, 1.25),
    brightness=(0.6, 1.4),
    saturation=(0.4, 1.4),
)
_OUTDOOR = replace(_INDOOR, name="outdoor", weight=1, kitti_crop=True, max_zoom=1.25, rotate_degrees=1.0)

_SYNTHETIC = replace(_INDOOR, name="synthetic", weight=3)


def relative() -> TrainConfig:
    """Return the recipe of stage 1: from ImageNet weights, on depth and disparity together.

    ``zoedepth train zoed_lite_relative --data indoor=nyu outdoor=kitti relative=relative --out runs/relative --init
    imagenet``: 17 minutes on two cores (AVX-512, AMX); the loss ends near 0.41. ``synthetic=synthetic:all`` adds
    rendered scenes.
    """
    return TrainConfig(
        stage="relative",
        model=ZOED_LITE,
        sources=(_INDOOR, _OUTDOOR, replace(_INDOOR, name="relative", weight=1), _SYNTHETIC),
        steps=250,
        optim=OptimConfig(learning_rate=1e-3, encoder_factor=0.3, warmup=0.1, initial_division=20, clip=1.0),
    )


def small_metric() -> TrainConfig:
    """Return the recipe of the first part of stage 2: many steps on small photos, three of seven of them rendered.

    ``zoedepth train zoed_lite_small --data indoor=nyu outdoor=kitti synthetic=scenes --out runs/small --init
    runs/relative/step_000250``, where scenes has 4,000 of ``synthetic:all?fov=35-100``: 64 minutes on two cores
    (AVX-512, AMX). The file in the package had other heads in this part; docs/zoed-lite.md says which.
    """
    return replace(
        metric(),
        model=with_focal_of_size(replace(ZOED_LITE, size=(160, 224)), ZOED_LITE),
        sources=_sources(indoor=3, outdoor=1, synthetic=3),
        steps=4000,
        optim=_optim(8e-4),
        ema_decay=0.999,
    )


def metric() -> TrainConfig:
    """Return the recipe of the second part of stage 2: at the final size, mostly on photos.

    ``zoedepth train zoed_lite --data indoor=nyu outdoor=kitti synthetic=scenes --out runs/lite --init
    runs/rescaled.safetensors``, which ``scripts/rescale_decoder.py`` made of ``runs/small/step_004000``: 50 minutes on
    one thread (AVX-512, AMX) of a busy machine. Without the rescaling the decoder's maps are too large for new heads.
    """
    return TrainConfig(
        stage="metric",
        model=ZOED_LITE,
        sources=_sources(indoor=4, outdoor=2, synthetic=1),
        steps=1200,
        batch_size=8,
        optim=_optim(5e-4),
        domain_weight=1.0,
        log_gradient_weight=1.5,
        spread_weight=1.0,
        ema_decay=0.99,
    )


def longer_metric() -> TrainConfig:
    """Return the recipe of the third part of stage 2: the second one again, longer and at a lower rate.

    ``zoedepth train zoed_lite_longer --data indoor=nyu outdoor=kitti synthetic=scenes --out runs/longer --init
    runs/lite/step_001200``: 80 minutes on one thread (AVX-512, AMX) of a busy machine.
    """
    return replace(metric(), steps=2200, optim=_optim(3e-4), ema_decay=0.998)


def decoder_metric() -> TrainConfig:
    """Return the recipe of the fourth part of stage 2: the third one again, for the decoder and the heads alone.

    The encoder, the projections of its maps and the router are frozen: with all weights trained, rooms of another kind
    become worse, and photos that are unlike those of both data sets go to another head (docs/log.md).

    ``zoedepth train zoed_lite_decoder --data indoor=nyu outdoor=kitti synthetic=scenes --out runs/decoder --init
    runs/longer/step_002200``: 104 minutes on one thread (AMD EPYC, AVX2, float32) of a busy machine.
    """
    longer = longer_metric()
    still = replace(longer.optim, encoder_factor=0.0, frozen=("router*", "decoder.project*"))
    return replace(longer, optim=still)


def _sources(*, indoor: int, outdoor: int, synthetic: int) -> tuple[SourceConfig, ...]:
    """Return the data sets of stage 2, with these weights. A zoom stands for a change of the lens, so it is wide."""
    return (
        replace(_INDOOR, weight=indoor, max_zoom=2.0, zoom_probability=0.5),
        replace(_OUTDOOR, weight=outdoor, max_zoom=1.5, zoom_probability=0.5),
        replace(_SYNTHETIC, weight=synthetic),
    )


def _optim(learning_rate: float) -> OptimConfig:
    return OptimConfig(learning_rate=learning_rate, encoder_factor=0.3, warmup=0.1, initial_division=20, clip=1.0)
