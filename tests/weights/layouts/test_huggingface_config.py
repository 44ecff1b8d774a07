"""What ``config.json`` of transformers says, and what of it is not believed."""

import ast
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tests.twins import KITTI, NYU, twin, twin_config

from zoedepth.config import Domain, ModelConfig
from zoedepth.errors import InputError
from zoedepth.presets import PRESETS, in_training_cameras
from zoedepth.weights.layouts import huggingface


def released_k(max_depth: float, *, preprocessor: Any = None, **said: Any) -> ModelConfig:
    """What is read from the folder of a full-size K whose config says this range, and more of its head."""
    lines = (Path(__file__).parent / "keys/huggingface-n.txt").read_text().splitlines()
    with torch.device("meta"):
        weights = {}
        for name, shape, _ in (re.fullmatch(r"(\S+) (\(.*\)) (\S+)", line).groups() for line in lines):
            weights[name] = torch.empty(ast.literal_eval(shape))
        for i, n in enumerate((32, 16, 8, 2)):  # normed: pairs of points
            weights[f"metric_head.attractors.{i}.conv2.weight"] = torch.empty(n, 128, 1, 1)
            weights[f"metric_head.attractors.{i}.conv2.bias"] = torch.empty(n)
    bins = [{"name": "nyu", "n_bins": 64, "min_depth": 1e-3, "max_depth": max_depth, **said}]
    backbone = {"image_size": 384, "out_features": ["stage6", "stage12", "stage18", "stage24"]}
    config = {"bin_centers_type": "normed", "bin_configurations": bins, "backbone_config": backbone}
    return huggingface.read(weights, config, layout=5, preprocessor=preprocessor)[0]


def test_published_k_says_10_m_and_is_used_to_80_m():
    with pytest.warns(UserWarning, match="trained to 80 m"):
        config = released_k(10.0)
    assert config.domains == PRESETS["zoed-m12-k"].domains
    assert config == PRESETS["zoed-m12-k"]


def test_k_that_says_80_m_is_believed():
    """Of the published file people correct the range, and not the name of the head: K is KITTI's with any."""
    assert released_k(80.0) == PRESETS["zoed-m12-k"]
    (kitti,) = PRESETS["zoed-m12-k"].domains
    assert released_k(60.0).domains == (replace(kitti, max_depth=60.0),)
    assert released_k(60.0, name="kitti").domains == (replace(kitti, max_depth=60.0),)


def test_k_of_our_own_is_believed_in_all():
    """Only our files have a focal length, or a head of another name."""
    assert released_k(10.0, focal_px=415.58).domains == (Domain("indoor", 1e-3, 10.0, 415.58),)
    assert released_k(10.0, name="garden").domains == (Domain("garden", 1e-3, 10.0),)


def test_how_photos_are_resized_and_padded_is_that_of_the_preprocessor():
    theirs = twin(twin_config())

    def read(**preprocessor: Any) -> tuple[str, bool]:
        found, _, _ = huggingface.read(
            theirs.state_dict(), theirs.config.to_dict(), layout=5, preprocessor=preprocessor
        )
        return found.resize, found.pad

    assert read() == ("keep-aspect", True)
    assert read(keep_aspect_ratio=False, do_pad=False) == ("squeeze", False)
    for name in ("keep_aspect_ratio", "do_pad"):
        with pytest.raises(InputError, match=f"{name} in preprocessor_config.json must be true or false, not 'no'"):
            read(**{name: "no"})


def test_k_is_known_however_its_photos_are_resized():
    k = released_k(80.0, preprocessor={"keep_aspect_ratio": False, "do_pad": False})
    assert k == in_training_cameras(replace(PRESETS["zoed-m12-k"], resize="squeeze", pad=False))


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
