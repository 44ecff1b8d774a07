"""Train a recipe for one step at tiny size; say which recipes are trained so, and in what recipes are alike."""

import dataclasses
from pathlib import Path

from tests.baselines.base import ENCODER
from tests.folders import write_disparity_pairs, write_pairs

from zoedepth.config import (
    AnyModelConfig,
    AttractorConfig,
    BaselineConfig,
    BtsNetworkConfig,
    LocalBinsNetworkConfig,
    ModelConfig,
    NewCrfsConfig,
    NewCrfsNetworkConfig,
)
from zoedepth.presets import ZOED_LITE
from zoedepth.recipes import RECIPES
from zoedepth.train.config import OptimConfig, TrainConfig
from zoedepth.train.metric import train_metric
from zoedepth.train.relative import train_relative
from zoedepth.weights.load import load_model

TRAINED = {
    "zoed_lite": ("zoed_lite_relative", "zoed_lite"),
    "demo": ("demo_relative", "demo"),
    "relative": ("relative_m12", "relative_n"),
    "metric": (
        "zoed_m12_n", "zoed_m12_k", "zoed_m12_nk", "zoed_nk_nk_one_head", "zoed_m12_n_swin2_t",
    ),
    "ablations": (
        "table_2_dorn", "table_2_localbins", "table_2_pixelbins", "table_2_newcrfs", "table_5_naive",
        "table_5_splitter", "table_5_exponential", "table_5_softmax", "table_5_sum", "table_6_labeled",
        "table_6_auto", "three_heads",
    ),
    "baselines": ("bts_n", "adabins_n", "localbins_n", "pixelbins_n", "newcrfs_nk", "dorn_n"),
    "comparison": ("comparison", "comparison_bts"),
}  # fmt: skip
"""Module of ``zoedepth.recipes`` → those of its recipes that take a step here."""


def take_a_step(name: str, tiny: ModelConfig, folder: Path) -> None:
    """Train a recipe for a step of two images, and check that its result is a model of its config."""
    config = shrunk(RECIPES[name](), tiny)
    data = {}
    for source in config.sources:
        if source.name == "relative":
            data[source.name] = write_disparity_pairs(folder / source.name)
        else:
            domain = {"outdoor": "outdoor", "kitti": "outdoor"}.get(source.name, "indoor")
            size = (375, 1242) if source.kitti_crop else (48, 64)
            lenses = (0.8 * size[1],) if config.model.canonical_camera else ()
            data[source.name] = write_pairs(folder / source.name, n=1, size=size, domain=domain, focal_px=lenses)
    train = train_relative if config.stage == "relative" else train_metric
    last = train(config, data=data, out=folder / "out", init=None)
    assert last.name == "step_000001"
    assert load_model(last).config == config.model


def shrunk(recipe: TrainConfig, tiny: ModelConfig) -> TrainConfig:
    """Return a recipe with everything that takes time made small; a step of stage 1 has an image of every source."""
    n = len(recipe.sources) if recipe.stage == "relative" else 2
    return dataclasses.replace(
        recipe,
        model=_shrunk_model(recipe.model, tiny),
        sources=tuple(
            dataclasses.replace(source, window=source.window and (64, 96 if source.name == "nyu" else 128))
            for source in recipe.sources
        ),
        pictures=0,
        steps=1,
        batch_size=n,
        accumulate=1,
        n_workers=0,
        holdout=0,
    )


def aspects(recipe: TrainConfig) -> set[tuple]:
    """Return the parts of a recipe that decide which code its training runs.

    Fields that change numbers only are left out, and so are fields that other tests have: reading and augmentation.
    """
    model = recipe.model
    if isinstance(model, BaselineConfig):
        network: tuple = (type(model.network),)
    elif recipe.stage == "relative":
        network = (model.encoder.family,)
    else:
        head = model.head
        if isinstance(head, AttractorConfig):
            head = dataclasses.replace(head, n_attractors=(1, 1, 1, 1), alpha=1.0)
        network = (head, model.router, len(model.domains))
    loop = dataclasses.replace(
        recipe,
        model=ZOED_LITE,
        sources=(),
        optim=OptimConfig(),
        mix_by="image",
        domain_weight=float(recipe.domain_weight > 0),
        ema_decay=recipe.ema_decay and 0.5,
        **dict.fromkeys(("steps", "batch_size", "validate_every", "checkpoint_every", "keep_checkpoints"), 1),
        **dict.fromkeys(("log_every", "n_workers", "holdout", "pictures"), 1),
    )
    return {
        ("network", recipe.stage, *network),
        ("optimizer", recipe.optim.optimizer, recipe.optim.schedule),
        ("mixture", recipe.mix_by, len(recipe.sources) > 1, frozenset(source.crop for source in recipe.sources)),
        ("loop", loop),
        ("camera", recipe.stage == "metric" and model.canonical_camera),
    }


def _shrunk_model(model: AnyModelConfig, tiny: ModelConfig) -> AnyModelConfig:
    """Return the model at a size, and of widths, that take a step in no time; the kind of its encoder is kept."""
    if isinstance(model, ModelConfig):
        head = model.head
        if isinstance(head, NewCrfsConfig):
            head = dataclasses.replace(head, widths=(32, 16, 16, 8), attention_heads=(4, 2, 2, 1), seed_width=16)
        encoder = model.encoder
        if encoder.family == "beit":
            encoder = tiny.encoder
        elif encoder.family == "convolutional":
            encoder = dataclasses.replace(encoder, name=ENCODER)
        elif encoder.family == "swin":
            encoder = dataclasses.replace(encoder, size=(64, 64), width=16, depth=(1, 1, 1, 1), heads=(1, 1, 2, 2))
        decoder = tiny.decoder if encoder.family != "convolutional" else model.decoder
        size = encoder.size if encoder.family == "swin" else (64, 96)
        return dataclasses.replace(model, encoder=encoder, decoder=decoder, head=head, size=size)
    size = (65, 97) if model.one_size else (64, 96)
    network = dataclasses.replace(model.network, encoder=ENCODER)
    if isinstance(network, NewCrfsNetworkConfig):
        network = dataclasses.replace(network, widths=(32, 16, 16, 8), attention_heads=(4, 2, 2, 1))
    if isinstance(network, BtsNetworkConfig):
        network = dataclasses.replace(network, width=128)
    if isinstance(network, LocalBinsNetworkConfig):
        network = dataclasses.replace(network, n_windows=20)
    return dataclasses.replace(model, network=network, size=size)
