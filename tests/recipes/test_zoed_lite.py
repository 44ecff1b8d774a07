"""The recipes of the model in the package take a step at tiny size."""

from pathlib import Path

import pytest
from tests.recipes.training import TRAINED, take_a_step

from zoedepth.config import ModelConfig


@pytest.mark.parametrize("name", TRAINED["zoed_lite"])
def test_recipe_takes_a_step(name: str, tiny_config: ModelConfig, tmp_path: Path) -> None:
    take_a_step(name, tiny_config, tmp_path)
