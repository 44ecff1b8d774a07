"""Every recipe builds, trains a model that has a name, and takes a step at tiny size."""

import dataclasses
import json
from pathlib import Path

import pytest
from tests.folders import write_disparity_pairs, write_pairs

from zoedepth.config import ModelConfig, from_dict, to_dict
from zoedepth.presets import PRESETS
from zoedepth.pretrained import load_model
from zoedepth.recipes import RECIPES
from zoedepth.train.config import TrainConfig
from zoedepth.train.metric import train_metric
from zoedepth.train.relative import train_relative


@pytest.mark.parametrize("name", RECIPES)
def test_recipe_trains_a_preset_and_is_the_same_every_time(name: str) -> None:
    config = RECIPES[name]()
    # At whatever size.
    alike = [preset for preset in PRESETS.values() if preset.encoder == config.model.encoder]
    assert config.model in [dataclasses.replace(preset, size=config.model.size) for preset in alike]
    assert RECIPES[name]() == config
    names = [source.name for source in config.sources]
    assert len(names) == len(set(names)) > 0


@pytest.mark.parametrize("name", RECIPES)
def test_recipe_survives_json(name: str) -> None:
    config = RECIPES[name]()
    assert from_dict(TrainConfig, json.loads(json.dumps(to_dict(config)))) == config


@pytest.mark.parametrize("name", RECIPES)
def test_recipe_takes_a_step(name: str, tiny_config: ModelConfig, tmp_path: Path) -> None:
    recipe = RECIPES[name]()
    config = dataclasses.replace(
        recipe,
        model=dataclasses.replace(
            recipe.model, encoder=tiny_config.encoder, decoder=tiny_config.decoder, size=(64, 96)
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
