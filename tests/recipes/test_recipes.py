"""Every recipe builds, trains a model that has a name, and is like one that takes a step in the tests beside this."""

import json

import pytest
from tests.recipes.training import TRAINED, aspects

from zoedepth.config import BaselineConfig, from_dict, to_dict
from zoedepth.presets import BASELINES, MINIATURE, PRESETS
from zoedepth.recipes import RECIPES
from zoedepth.train.config import TrainConfig


@pytest.mark.parametrize("name", RECIPES)
def test_recipe_trains_a_preset_and_is_the_same_every_time(name: str) -> None:
    config = RECIPES[name]()
    model = config.model
    if isinstance(model, BaselineConfig):
        kinds = {type(preset.network) for preset in BASELINES.values()}
        assert model in BASELINES.values() or (name.startswith("comparison_") and type(model.network) in kinds)
    else:  # at whatever size, with whatever head, router and domains
        alike = [preset for preset in (*PRESETS.values(), MINIATURE) if preset.encoder == model.encoder]
        assert (model.decoder, model.antialias, model.pad) in [(p.decoder, p.antialias, p.pad) for p in alike]
    assert RECIPES[name]() == config
    names = [source.name for source in config.sources]
    assert len(names) == len(set(names)) > 0


@pytest.mark.parametrize("name", RECIPES)
def test_recipe_survives_json(name: str) -> None:
    config = RECIPES[name]()
    assert from_dict(TrainConfig, json.loads(json.dumps(to_dict(config)))) == config


def test_every_recipe_is_like_those_that_take_a_step() -> None:
    trained = [name for names in TRAINED.values() for name in names]
    covered = set().union(*(aspects(RECIPES[name]()) for name in trained))
    missing = {name: aspects(make()) - covered for name, make in RECIPES.items()}
    assert {name: found for name, found in missing.items() if found} == {}
