"""Stage 2 of the paper: the models of its model table, ZoeD-{relative pre-training}-{metric fine-tuning}.

``zoedepth train zoed_m12_n --data nyu=... --out runs/zoed-m12-n --init runs/m12/step_270000``, and likewise for the
others: ``--data`` names the data sets of the metric fine-tuning, ``--init`` is the result of the relative pre-training
(``imagenet`` for X). Models of the same data differ in nothing else, except that a decoder which starts from random
weights has the full learning rate. Five epochs in batches of 16. Expected on NYU, by the paper's Table 1: ZoeD-X-N
REL 0.082, ZoeD-M12-N 0.075, ZoeD-M12-NK 0.077. Not run: there was no GPU and no such data.
"""

import math

from zoedepth.presets import TRAINED
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig

NYU_IMAGES, KITTI_IMAGES = 24_231, 23_158
"""Number of lines in the lists that the released code trains on; the paper says 24 and 26 thousand."""

# Released: whole photos squeezed to the network's size, mirrored, turned by up to a degree, their colours changed.
_NYU = SourceConfig("nyu")
_KITTI = SourceConfig("kitti", kitti_crop=True, sparse=True, brightness=(0.9, 1.1))


def nyu(preset: str) -> TrainConfig:
    """Return the recipe of a ZoeD-*-N."""
    return _recipe(preset, (_NYU,), steps=5 * math.ceil(NYU_IMAGES / 16))


def kitti(preset: str) -> TrainConfig:
    """Return the recipe of a ZoeD-*-K."""
    return _recipe(preset, (_KITTI,), steps=5 * math.ceil(KITTI_IMAGES / 16))


def nyu_and_kitti(preset: str) -> TrainConfig:
    """Return the recipe of a ZoeD-*-NK: batches of the two data sets in turn; the smaller one is repeated."""
    return _recipe(
        preset,
        (_NYU, _KITTI),
        steps=5 * 2 * (math.ceil(NYU_IMAGES / 16) + 1),  # as released: 1516 batches of each, in every epoch
        # Released: a tenth of the rate for a decoder that is pre-trained, the full rate for a random one.
        optim=OptimConfig(learning_rate=2.512e-4, decoder_factor=1.0 if preset.startswith("zoed-x-") else 0.1),
    )


def _recipe(
    preset: str,
    sources: tuple[SourceConfig, ...],
    *,
    steps: int,
    optim: OptimConfig | None = None,
) -> TrainConfig:
    return TrainConfig(
        stage="metric",
        model=TRAINED[preset],
        sources=sources,
        steps=steps,
        batch_size=16,
        optim=optim or OptimConfig(),
        mix_by="batch" if len(sources) > 1 else "image",
        loss_size="truth",
        validate_every=steps // 20,
        n_workers=8,
    )
