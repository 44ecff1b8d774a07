"""The systems that the paper compares with, as their authors trained them: on NYU (n), on KITTI (k), on both (nk).

``zoedepth train adabins_n --data nyu=... --out runs/adabins --init imagenet``. The paper's Table 1 has those of NYU,
Table 2 those of both. Expected on NYU: BTS REL 0.110, AdaBins 0.103, LocalBins 0.099, NeWCRFs 0.095, DORN 0.115. Not
run: there was no GPU and no such data. Rates, crops and losses are those of their code; docs/paper.md has the rest.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

from zoedepth.presets import BASELINES
from zoedepth.recipes.metric import KITTI_IMAGES, NYU_IMAGES
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig

_NYU = SourceConfig("nyu", crop="window", window=(416, 544), rotate_degrees=2.5)
_KITTI = SourceConfig(
    "kitti", crop="window", window=(352, 704), kitti_crop=True, sparse=True, brightness=(0.9, 1.1)
)  # fmt: skip

# Encoder and decoder have the same rates: AdaBins sets a tenth for the encoder, but its one-cycle overrides it.
_CYCLE = OptimConfig(
    learning_rate=3.57e-4, encoder_factor=1.0, weight_decay=0.1, warmup=0.3, initial_division=25, final_division=100
)
_OPTIM = {
    "bts": OptimConfig(
        learning_rate=1e-4,
        encoder_factor=1.0,
        schedule="polynomial",
        final_division=10,
        decay_encoder_only=True,
        eps=1e-3,
        momentum=(0.9, 0.9),
        clip=float("inf"),
        frozen=("encoder.*conv0*", "encoder.*norm*"),
    ),
    "adabins": _CYCLE,
    "localbins": replace(_CYCLE, warmup=0.7, initial_division=1, final_division=1e4),
    "pixelbins": replace(_CYCLE, learning_rate=2e-4, weight_decay=0.01, clip=1.0),
    # No weight decay: NeWCRFs' code reads one, but does not give it to Adam.
    "newcrfs": OptimConfig(
        learning_rate=2e-5,
        encoder_factor=1.0,
        weight_decay=0.0,
        schedule="polynomial",
        final_division=10,
        momentum=(0.9, 0.9),
        clip=float("inf"),
    ),
    "dorn": OptimConfig(
        optimizer="sgd",
        learning_rate=1e-3,
        encoder_factor=0.1,
        weight_decay=5e-4,
        schedule="polynomial",
        final_division=1e6,
        momentum=(0.9, 0.9),
        clip=float("inf"),
        frozen=("encoder.*bn*",),
    ),
}
_EPOCHS = {"bts": 50, "adabins": 25, "localbins": 10, "pixelbins": 25, "newcrfs": 50, "dorn": 37}
_BATCH = {"bts": 16, "adabins": 16, "localbins": 16, "pixelbins": 16, "newcrfs": 8, "dorn": 3}


def baseline(name: str, data: Literal["n", "k", "nk"]) -> TrainConfig:
    """Return the recipe of a baseline on one of the three."""
    nyu, kitti = _NYU, _KITTI
    if name == "localbins":
        nyu = replace(nyu, window=(480, 640), rotate_degrees=1.0)
    elif name == "newcrfs":
        nyu, kitti = replace(nyu, window=(480, 640)), replace(kitti, window=(352, 1120))
    elif name == "dorn":
        nyu, kitti = (replace(source, crop="squeeze", window=None, rotate_degrees=0.0) for source in (nyu, kitti))
    if name in ("bts", "newcrfs"):
        nyu, kitti = replace(nyu, min_depth=0.1), replace(kitti, min_depth=1.0)
    sources = {"n": (nyu,), "k": (kitti,), "nk": (nyu, kitti)}[data]
    n_images = {"n": NYU_IMAGES, "k": KITTI_IMAGES, "nk": 2 * NYU_IMAGES}[data]
    steps = _EPOCHS[name] * n_images // _BATCH[name]
    return TrainConfig(
        stage="metric",
        model=BASELINES[f"{name}-{data}"],
        sources=sources,
        steps=steps,
        batch_size=_BATCH[name],
        optim=_OPTIM[name],
        mix_by="batch" if len(sources) > 1 else "image",
        freeze_batch_norm=name in ("bts", "dorn"),
        validate_every=steps // 100,
        n_workers=8,
    )


BASELINE_RECIPES: dict[str, Callable[[], TrainConfig]] = {
    f"{name}_{data}": partial(baseline, name, data) for name in _OPTIM for data in ("n", "k", "nk")
}
"""Name on the command line → function."""
