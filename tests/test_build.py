"""The one way from a config to a network."""

import ast
from pathlib import Path

import pytest
import torch
from tests.baselines.test_baseline import CONFIGS

from zoedepth.baselines import BASELINES
from zoedepth.build import build_model
from zoedepth.config import BaselineConfig, ModelConfig
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.weights.load import load_model
from zoedepth.weights.save import save_model

SOURCE = Path(__file__).parents[1] / "src/zoedepth"


def formats(model: torch.nn.Module) -> set[bool]:
    """Whether the weights of convolutions lie channels last (True for those of one channel or pixel, too)."""
    weights = [value for value in model.parameters() if value.ndim == 4]
    return {value.is_contiguous(memory_format=torch.channels_last) for value in weights}


def test_a_config_becomes_its_network_in_training_mode(tiny_config: ModelConfig):
    model = build_model(tiny_config)
    assert type(model) is ZoeDepth
    assert model.config == tiny_config
    assert model.training
    assert formats(model) == {True}


@pytest.mark.parametrize("config", CONFIGS, ids=lambda config: type(config.network).__name__)
def test_a_config_of_a_baseline_becomes_the_baseline(config: BaselineConfig):
    with torch.device("meta"):
        model = build_model(config)
    assert type(model) is BASELINES[type(config.network)]
    assert model.config == config


def test_built_and_loaded_models_are_made_of_the_same_layers(tiny_config: ModelConfig, tmp_path: Path):
    model = build_model(tiny_config)
    save_model(model, tmp_path / "model.safetensors")
    loaded = load_model(tmp_path / "model.safetensors")
    assert [type(module) for module in loaded.modules()] == [type(module) for module in model.modules()]
    assert formats(loaded) == formats(model)


def test_nothing_else_in_the_package_builds_a_network():
    """Or one way would forget what another does to a model."""
    found = {
        f"{path.name}: {node.func.value.id if isinstance(node.func, ast.Subscript) else node.func.id}"
        for path in SOURCE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func).partition("[")[0] in ("ZoeDepth", "BASELINES")
    }
    assert found == {"build.py: ZoeDepth", "build.py: BASELINES"}
