"""The recipes of ``zoedepth demo-train`` take a step at tiny size."""

from pathlib import Path

import pytest
from tests.recipes.training import TRAINED, take_a_step

from zoedepth.config import ModelConfig


@pytest.mark.parametrize("name", TRAINED["demo"])
def test_recipe_takes_a_step(name: str, tiny_config: ModelConfig, tmp_path: Path) -> None:
    take_a_step(name, tiny_config, tmp_path)
