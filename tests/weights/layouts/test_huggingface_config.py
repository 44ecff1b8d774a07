"""What ``config.json`` of transformers says, and what of it is not believed."""

import ast
import re
from pathlib import Path
from typing import Any

import pytest
import torch
from tests.twins import KITTI, NYU, twin, twin_config

from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.presets import PRESETS
from zoedepth.weights.layouts import huggingface


def released_k(max_depth: float) -> ModelConfig:
    """What is read from the folder of a full-size K whose config says this range."""
    lines = (Path(__file__).parent / "keys/huggingface-n.txt").read_text().splitlines()
    with torch.device("meta"):
        weights = {}
        for name, shape, _ in (re.fullmatch(r"(\S+) (\(.*\)) (\S+)", line).groups() for line in lines):
            weights[name] = torch.empty(ast.literal_eval(shape))
        for i, n in enumerate((32, 16, 8, 2)):  # normed: pairs of points
            weights[f"metric_head.attractors.{i}.conv2.weight"] = torch.empty(n, 128, 1, 1)
            weights[f"metric_head.attractors.{i}.conv2.bias"] = torch.empty(n)
    bins = [{"name": "nyu", "n_bins": 64, "min_depth": 1e-3, "max_depth": max_depth}]
    backbone = {"image_size": 384, "out_features": ["stage6", "stage12", "stage18", "stage24"]}
    config = {"bin_centers_type": "normed", "bin_configurations": bins, "backbone_config": backbone}
    return huggingface.read(weights, config, layout=5)[0]


def test_published_k_says_10_m_and_is_used_to_80_m():
    with pytest.warns(UserWarning, match="trained to 80 m"):
        config = released_k(10.0)
    assert config.domains == PRESETS["zoed-m12-k"].domains
    assert config == PRESETS["zoed-m12-k"]


def test_k_that_says_80_m_is_believed():
    assert [domain.max_depth for domain in released_k(80.0).domains] == [80.0]


def test_k_of_other_sizes_is_believed_too():
    """A small twin that says 10 m means it."""
    theirs = twin(twin_config(centers="normed"))
    config, _, _ = huggingface.read(theirs.state_dict(), theirs.config.to_dict(), layout=5)
    assert [domain.max_depth for domain in config.domains] == [10.0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"readout_type": "add"}, "readout_type"),
        ({"add_projection": True}, "add_projection"),
        ({"reassemble_factors": [4, 2, 1, 1]}, "reassemble_factors"),
        ({"bin_centers_type": "hybrid1"}, "hybrid1"),
        ({"bin_configurations": [NYU, KITTI, NYU]}, "3 heads"),
        ({"bin_configurations": "nyu"}, "bin_configurations"),
        ({"min_temp": "cold"}, "min_temp"),
        ({"backbone_config": {"model_type": "swin"}}, "swin"),
        ({"backbone_config": 3}, "backbone_config"),
        ({"backbone_config": {"image_size": "large"}}, "image_size"),
        ({"backbone_config": {"image_size": 64, "out_indices": [1, 2]}}, "four stages"),
    ],
)
def test_config_of_another_network_is_refused(change: dict[str, Any], message: str):
    theirs = twin(twin_config())
    with pytest.raises(InputError, match=message):
        huggingface.read(theirs.state_dict(), {**theirs.config.to_dict(), **change}, layout=5)
