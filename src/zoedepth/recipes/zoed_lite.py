"""Both stages of ``zoed-lite``, the model in the package."""

from dataclasses import replace

from zoedepth.presets import ZOED_LITE
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


CANONICAL = replace(
    ZOED_LITE,
    decoder=replace(ZOED_LITE.decoder, upsampling="convex"),
    # The place and the temperature of the log-binomial come to rest at their bounds, and the deviation says nothing.
    head=replace(ZOED_LITE.head, probability="softmax"),
    canonical_camera=True,
    # Scaled to the camera of NYU or KITTI, what a wide lens sees is farther than these sets reach.
    domains=tuple(replace(domain, max_depth=2 * domain.max_depth) for domain in ZOED_LITE.domains),
)
"""``zoed-lite`` in one canonical camera: data of any lens teach it, and any lens is right where it is known."""


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


def metric() -> TrainConfig:
    """Return the recipe of stage 2, which starts from stage 1.

    ``zoedepth train zoed_lite --data indoor=nyu outdoor=kitti --out runs/lite --init runs/relative/step_000250``: 64
    minutes on two cores (AVX-512, AMX), busy with other work as well. NYU test REL 0.179, delta1 0.742 (795 training
    images); KITTI 2015 later drives REL 0.123, delta1 0.833 (110 training images).
    """
    return TrainConfig(
        stage="metric",
        model=ZOED_LITE,
        sources=(
            replace(_INDOOR, max_zoom=1.4, zoom_probability=0.5),
            replace(_OUTDOOR, zoom_probability=0.5),
            _SYNTHETIC,
        ),
        steps=1400,
        batch_size=8,
        optim=OptimConfig(learning_rate=8e-4, encoder_factor=0.3, warmup=0.1, initial_division=20, clip=1.0),
        domain_weight=1.0,
        ema_decay=0.99,
    )


def canonical_relative() -> TrainConfig:
    """Return the recipe of stage 1 for the canonical camera. Disparity has no scale, so it needs no cameras.

    ``zoedepth train zoed_lite_canonical_relative --data indoor=nyu outdoor=kitti relative=relative
    synthetic="synthetic:all?fov=35-100" --out runs/relative --init imagenet``. Not run.
    """
    return replace(relative(), model=CANONICAL)


def canonical_metric() -> TrainConfig:
    """Return the recipe of stage 2 in the canonical camera: a wider zoom, since it stands for a change of the lens.

    ``zoedepth train zoed_lite_canonical --data indoor=nyu outdoor=kitti synthetic="synthetic:all?fov=35-100" --out
    runs/lite --init runs/relative/step_000250``. Not run.
    """
    return replace(
        metric(),
        model=CANONICAL,
        sources=(
            replace(_INDOOR, max_zoom=2.0, zoom_probability=0.5),
            replace(_OUTDOOR, max_zoom=1.5, zoom_probability=0.5),
            _SYNTHETIC,
        ),
    )
