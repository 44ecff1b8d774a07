"""Every recipe builds, trains a model that has a name, and takes a step at tiny size."""

import dataclasses
import json
from pathlib import Path

import pytest
from tests.folders import write_disparity_pairs, write_pairs

from zoedepth.config import (
    AnyModelConfig,
    BaselineConfig,
    BtsNetworkConfig,
    ModelConfig,
    NewCrfsConfig,
    NewCrfsNetworkConfig,
    from_dict,
    to_dict,
)
from zoedepth.presets import BASELINES, PRESETS
from zoedepth.recipes import RECIPES
from zoedepth.train.config import TrainConfig
from zoedepth.train.metric import train_metric
from zoedepth.train.relative import train_relative
from zoedepth.weights.load import load_model


@pytest.mark.parametrize("name", RECIPES)
def test_recipe_trains_a_preset_and_is_the_same_every_time(name: str) -> None:
    config = RECIPES[name]()
    model = config.model
    if isinstance(model, BaselineConfig):
        kinds = {type(preset.network) for preset in BASELINES.values()}
        assert model in BASELINES.values() or (name.startswith("comparison_") and type(model.network) in kinds)
    else:  # at whatever size, with whatever head, router and domains
        alike = [preset for preset in PRESETS.values() if preset.encoder == model.encoder]
        assert (model.decoder, model.antialias, model.pad) in [(p.decoder, p.antialias, p.pad) for p in alike]
    assert RECIPES[name]() == config
    names = [source.name for source in config.sources]
    assert len(names) == len(set(names)) > 0


@pytest.mark.parametrize("name", RECIPES)
def test_recipe_survives_json(name: str) -> None:
    config = RECIPES[name]()
    assert from_dict(TrainConfig, json.loads(json.dumps(to_dict(config)))) == config


def _tiny(model: AnyModelConfig, tiny: ModelConfig) -> AnyModelConfig:
    """The same at a size, and of widths, that take a step in no time."""
    if isinstance(model, ModelConfig):
        head = model.head
        if isinstance(head, NewCrfsConfig):
            head = dataclasses.replace(head, widths=(32, 16, 16, 8), attention_heads=(4, 2, 2, 1), seed_width=16)
        return dataclasses.replace(model, encoder=tiny.encoder, decoder=tiny.decoder, head=head, size=(64, 96))
    size = (65, 97) if model.one_size else (64, 96)
    network = dataclasses.replace(model.network, encoder="tf_efficientnet_lite0")
    if isinstance(network, NewCrfsNetworkConfig):
        network = dataclasses.replace(network, widths=(32, 16, 16, 8), attention_heads=(4, 2, 2, 1))
    if isinstance(network, BtsNetworkConfig):
        network = dataclasses.replace(network, width=128)
    return dataclasses.replace(model, network=network, size=size)


@pytest.mark.parametrize("name", RECIPES)
def test_recipe_takes_a_step(name: str, tiny_config: ModelConfig, tmp_path: Path) -> None:
    recipe = RECIPES[name]()
    config = dataclasses.replace(
        recipe,
        model=_tiny(recipe.model, tiny_config),
        sources=tuple(
            dataclasses.replace(source, window=source.window and (64, 96 if source.name == "nyu" else 128))
            for source in recipe.sources
        ),
        pictures=0,
        steps=1,
        batch_size=2,
        accumulate=1,
        n_workers=0,
        holdout=0,
    )
    data = {}
    for source in config.sources:
        if source.name == "relative":
            data[source.name] = write_disparity_pairs(tmp_path / source.name)
        else:
            domain = {"outdoor": "outdoor", "kitti": "outdoor"}.get(source.name, "indoor")
            size = (375, 1242) if source.kitti_crop else (48, 64)
            data[source.name] = write_pairs(tmp_path / source.name, n=1, size=size, domain=domain)

    train = train_relative if config.stage == "relative" else train_metric
    last = train(config, data=data, out=tmp_path / "out", init=None)

    assert last.name == "step_000001"
    assert load_model(last).config == config.model
