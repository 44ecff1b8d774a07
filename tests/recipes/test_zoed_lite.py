"""The recipes of the model in the package take a step at tiny size."""

from pathlib import Path

import pytest
from tests.recipes.training import TRAINED, take_a_step

from zoedepth.build import build_model
from zoedepth.config import ModelConfig
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.recipes import RECIPES
from zoedepth.train.optim import build_optimizer


@pytest.mark.parametrize("name", TRAINED["zoed_lite"])
def test_recipe_takes_a_step(name: str, tiny_config: ModelConfig, tmp_path: Path) -> None:
    take_a_step(name, tiny_config, tmp_path)


def test_last_part_trains_neither_encoder_nor_router() -> None:
    recipe = RECIPES["zoed_lite_decoder"]()
    model = build_model(recipe.model)
    assert isinstance(model, ZoeDepth)
    build_optimizer(model, recipe.optim)
    still = {name.split(".")[0] for name, each in model.named_parameters() if not each.requires_grad}
    trained = {name.split(".")[0] for name, each in model.named_parameters() if each.requires_grad}
    assert {"encoder", "router"} <= still - trained
    assert {"decoder", "heads"} <= trained
    assert not any(each.requires_grad for each in model.decoder.project.parameters())
