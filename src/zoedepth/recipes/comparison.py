"""Every head and every baseline on equal terms: one small encoder, NYU's 795 labelled training pairs, 100 steps.

``python -m benchmarks.heads --nyu nyu --out runs/heads`` trains and scores them all; docs/results.md has the table.
By hand: ``zoedepth train comparison --head newcrfs --data nyu=nyu --out runs/newcrfs
--init imagenet``, ``zoedepth train comparison_bts --data nyu=nyu --out runs/bts --init imagenet``.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from zoedepth.config import INDOOR, BaselineConfig, LocalBinsNetworkConfig
from zoedepth.presets import BASELINES, MINIATURE
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig

SIZE = (160, 224)
"""(height, width): a third of NYU's."""


def head() -> TrainConfig:
    """Return the recipe of a head on the DPT decoder of ``zoed-lite``: the head of ``--head``, or else its own."""
    return TrainConfig(
        stage="metric",
        model=replace(MINIATURE, domains=(INDOOR,), size=SIZE),
        sources=(SourceConfig("nyu", crop="fit", rotate_degrees=2.0, color_probability=0.8),),
        steps=100,
        batch_size=8,
        optim=OptimConfig(learning_rate=5e-4, encoder_factor=0.3, warmup=0.1, initial_division=20, clip=1.0),
        pictures=0,
        checkpoint_every=100,
        keep_checkpoints=1,
    )


def baseline(name: str) -> TrainConfig:
    """Return the recipe of a baseline with the same encoder.

    DORN's sides are larger by one: they must be 8 n + 1. LocalBins has a tenth of its windows.
    """
    preset = BASELINES[f"{name}-n"]
    size = (SIZE[0] + 1, SIZE[1] + 1) if name == "dorn" else SIZE
    network = replace(preset.network, encoder=MINIATURE.encoder.name)
    if isinstance(network, LocalBinsNetworkConfig):
        network = replace(network, n_windows=20)
    return replace(head(), model=BaselineConfig(network, domains=(INDOOR,), size=size, antialias=True))


COMPARISON: dict[str, Callable[[], TrainConfig]] = {
    "comparison": head,
    **{
        f"comparison_{name}": partial(baseline, name)
        for name in ("bts", "adabins", "localbins", "pixelbins", "newcrfs", "dorn")
    },
}
"""Name on the command line → function."""
