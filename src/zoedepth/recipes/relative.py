"""Stage 1 of the paper: MiDaS's relative pre-training on twelve data sets, on NYU and KITTI, and on NYU alone.

Not run: there was no GPU and no such data. The numbers are MiDaS's (DPT section 4.1; MiDaS v3.1 section 3);
docs/paper.md says which numbers were never published.
"""

import math
from dataclasses import replace

from zoedepth.presets import PRESETS
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig

# No change of colours, no rotation: random crops and mirror images only.
_DENSE = SourceConfig("", crop="fit", rotate_degrees=0.0, color_probability=0.0)
_CURATED = ("redweb", "hrwsi", "blendedmvs")
_OTHERS = ("diml-indoor", "movies3d", "megadepth", "wsvd", "tartanair", "apolloscape", "irs")

STEPS_OF_AN_EPOCH = 72_000 // 16
"""Steps in an epoch of DPT: 72,000 images. (Its text says 72,000 steps, but its training time says images.)"""


def _sources(*names: str) -> tuple[SourceConfig, ...]:
    # KITTI's lidar has no neighbours to compare, so no gradient term (DPT).
    return tuple(replace(_DENSE, name=name, sparse=name == "kitti", gradient_term=name != "kitti") for name in names)


def _recipe(*names: str) -> TrainConfig:
    return TrainConfig(
        stage="relative",
        model=PRESETS["dpt-beit-large-384"],
        sources=_sources(*names),
        steps=60 * STEPS_OF_AN_EPOCH,
        batch_size=16,
        optim=OptimConfig(
            learning_rate=1e-4,
            encoder_factor=0.1,
            schedule="constant",
            weight_decay=0.0,
            momentum=(0.9, 0.9),
            clip=math.inf,
        ),
        task_weights="pareto",
        validate_every=STEPS_OF_AN_EPOCH,
        checkpoint_every=1000,
        n_workers=8,
    )


def m12_curated() -> TrainConfig:
    """Return the recipe of the first half of M12: the three curated sets, NYU and KITTI, from ImageNet.

    ``zoedepth train relative_m12_curated --data redweb=... hrwsi=... blendedmvs=... nyu=... kitti=... --out
    runs/m12-curated --init imagenet``
    """
    return _recipe(*_CURATED, "nyu", "kitti")


def m12() -> TrainConfig:
    """Return the recipe of the second half of M12: all twelve sets, from the first half.

    ``zoedepth train relative_m12 --data redweb=... (and the others) --out runs/m12 --init
    runs/m12-curated/step_270000``
    """
    return _recipe(*_CURATED, *_OTHERS, "nyu", "kitti")


def nk() -> TrainConfig:
    """Return the recipe on NYU and KITTI, for ZoeD-NK-*.

    ``zoedepth train relative_nk --data nyu=... kitti=... --out runs/nk --init imagenet``
    """
    return _recipe("nyu", "kitti")


def n() -> TrainConfig:
    """Return the recipe on NYU alone, for ZoeD-N-N.

    ``zoedepth train relative_n --data nyu=... --out runs/n --init imagenet``
    """
    return _recipe("nyu")


def k() -> TrainConfig:
    """Return the recipe on KITTI alone, for ZoeD-K-K.

    ``zoedepth train relative_k --data kitti=... --out runs/k --init imagenet``
    """
    return _recipe("kitti")
