"""Stage 2 of the paper take a step at tiny size."""

from pathlib import Path

import pytest
from tests.recipes.training import TRAINED, take_a_step

from zoedepth.config import ModelConfig
from zoedepth.recipes import RECIPES


@pytest.mark.parametrize("name", TRAINED["metric"])
def test_recipe_takes_a_step(name: str, tiny_config: ModelConfig, tmp_path: Path) -> None:
    take_a_step(name, tiny_config, tmp_path)


def test_steps_are_five_epochs_of_the_released_loaders() -> None:
    """Last batches count though they are not full; of NYU and KITTI, batches take turns, and NYU has more."""
    steps = {name: RECIPES[name]().steps for name in ("zoed_m12_n", "zoed_m12_k", "zoed_m12_nk")}
    assert steps == {"zoed_m12_n": 7_575, "zoed_m12_k": 7_240, "zoed_m12_nk": 15_160}


def test_only_a_random_decoder_has_the_full_rate_on_both_and_the_loss_is_taken_at_the_truth() -> None:
    names = [name for name, make in RECIPES.items() if name.startswith("zoed_") and make().loss_size == "truth"]
    assert {"zoed_x_n", "zoed_m12_k", "zoed_nk_nk", "zoed_m12_n_swin2_t"} <= set(names)
    both = {name: RECIPES[name]().optim.decoder_factor for name in names if len(RECIPES[name]().sources) == 2}
    assert {name for name, factor in both.items() if factor == 1} == {"zoed_x_nk", "zoed_x_nk_one_head"}
    assert set(both.values()) == {0.1, 1}
