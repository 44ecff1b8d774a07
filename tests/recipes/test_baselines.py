"""The systems that the paper compares with take a step at tiny size."""

from pathlib import Path

import pytest
from tests.recipes.training import TRAINED, take_a_step

from zoedepth.config import ModelConfig
from zoedepth.recipes import RECIPES

SYSTEMS = ("bts", "adabins", "localbins", "pixelbins", "newcrfs", "dorn")


@pytest.mark.parametrize("name", TRAINED["baselines"])
def test_recipe_takes_a_step(name: str, tiny_config: ModelConfig, tmp_path: Path) -> None:
    take_a_step(name, tiny_config, tmp_path)


def test_systems_are_trained_on_depth_as_far_as_their_authors_do() -> None:
    nearest = {name: tuple(source.min_depth for source in RECIPES[f"{name}_nk"]().sources) for name in SYSTEMS}
    assert nearest == {**dict.fromkeys(SYSTEMS, (None, None)), "bts": (0.1, 1.0), "newcrfs": (0.1, 1.0)}


def test_momentum_of_bts_is_that_of_its_code_throughout() -> None:
    """AdamW's first beta, which other recipes let run through a cycle."""
    assert RECIPES["bts_n"]().optim.momentum == (0.9, 0.9)
    assert RECIPES["adabins_n"]().optim.momentum != (0.9, 0.9)
