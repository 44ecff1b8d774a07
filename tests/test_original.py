"""Programs that import what the README of isl-org/ZoeDepth imports run as they are."""

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from tests.models import random_model
from tests.servers import FileServer

from zoedepth import original, read_depth
from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.original import colorize, get_config
from zoedepth.torchhub import OriginalInterface

_URL = "url::https://github.com/isl-org/ZoeDepth/releases/download/v1.0/ZoeD_M12_"


@pytest.fixture
def built(tiny_config: ModelConfig, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, dict[str, Any]]]:
    """The arguments of the models that are built; a tiny one is."""
    calls: list[tuple[str, dict[str, Any]]] = []

    def build(preset: str, **arguments: Any) -> OriginalInterface:
        calls.append((preset, arguments))
        return OriginalInterface(random_model(tiny_config))

    monkeypatch.setattr(original, "build", build)
    return calls


@pytest.fixture(autouse=True)
def fresh_modules() -> None:
    for name in [name for name in sys.modules if name.startswith(("zoedepth.models", "zoedepth.utils"))]:
        del sys.modules[name]


@pytest.mark.filterwarnings("error")
def test_the_readme_of_the_original_runs(built: list[tuple[str, dict[str, Any]]], tmp_path: Path) -> None:
    from zoedepth.models.builder import build_model
    from zoedepth.utils.config import get_config
    from zoedepth.utils.misc import colorize, get_image_from_url, pil_to_batched_tensor, save_raw_16bit

    colours = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    Image.fromarray(colours).save(tmp_path / "photo.png")
    zoe = build_model(get_config("zoedepth_nk", "infer")).to("cpu")
    with FileServer((tmp_path / "photo.png").read_bytes()) as server:
        photo = get_image_from_url(f"{server.url}/photo.png")
    assert np.array_equal(photo, colours)
    pixels = pil_to_batched_tensor(photo)
    torch.testing.assert_close(pixels[0].permute(1, 2, 0), torch.tensor(colours) / 255)
    depth = zoe.infer(pixels)
    assert depth.shape == (1, 1, 48, 64)
    save_raw_16bit(depth, tmp_path / "raw.png")
    np.testing.assert_allclose(read_depth(tmp_path / "raw.png"), depth[0, 0].detach().numpy(), atol=0.6 / 256)
    assert colorize(depth).shape == (48, 64, 4)
    assert built == [
        (
            "zoed-m12-nk",
            {
                "pretrained": f"{_URL}NK.pt",
                "midas_model_type": "DPT_BEiT_L_384",
                "config_mode": "infer",
                "compat": (),
            },
        )
    ]


@pytest.mark.parametrize(
    ("arguments", "preset", "weights", "mode"),
    [
        ({"model_name": "zoedepth", "mode": "infer"}, "zoed-m12-n", f"{_URL}N.pt", "infer"),
        ({"model_name": "zoedepth", "mode": "eval", "dataset": "nyu"}, "zoed-m12-n", f"{_URL}N.pt", "eval"),
        (
            {"model_name": "zoedepth", "mode": "infer", "config_version": "kitti", "dataset": "kitti"},
            "zoed-m12-k",
            f"{_URL}K.pt",
            "infer",
        ),
        (
            {"model_name": "zoedepth", "mode": "infer", "pretrained_resource": "local::mine.pt"},
            "zoed-m12-n",
            "local::mine.pt",
            "infer",
        ),
        ({"model_name": "zoedepth", "mode": "infer", "pretrained_resource": None}, "zoed-m12-n", False, "infer"),
    ],
)
def test_configurations_name_the_model_and_its_weights(
    built: list[tuple[str, dict[str, Any]]], arguments: dict[str, Any], preset: str, weights: object, mode: str
) -> None:
    original.build_model(get_config(**arguments))
    assert [(name, values["pretrained"], values["config_mode"]) for name, values in built] == [(preset, weights, mode)]


def test_a_configuration_can_be_changed_as_an_object_and_as_a_dictionary(
    built: list[tuple[str, dict[str, Any]]],
) -> None:
    config = get_config("zoedepth", "infer")
    config.pretrained_resource = "local::mine.pt"
    assert config["pretrained_resource"] == "local::mine.pt"
    config["mode"] = "eval"
    original.build_model(config)
    assert (built[0][1]["pretrained"], built[0][1]["config_mode"]) == ("local::mine.pt", "eval")
    with pytest.raises(AttributeError, match="the configuration has no n_bins, but model, mode"):
        config.n_bins  # noqa: B018 - to look is what raises


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"model_name": "midas", "mode": "infer"}, "no model 'midas'.*give 'zoedepth'"),
        (
            {"model_name": "zoedepth_nk", "mode": "infer", "config_version": "kitti"},
            "'zoedepth_nk' with config_version",
        ),
        ({"model_name": "zoedepth"}, "mode 'train' is not for loading.*`zoedepth train`"),
        ({"model_name": "zoedepth", "mode": "infer", "dataset": "mix"}, "dataset must be 'nyu', 'kitti' or None"),
        ({"model_name": "zoedepth", "mode": "infer", "n_bins": 32}, "n_bins cannot be set here"),
    ],
)
def test_what_is_not_here_is_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        get_config(**arguments)


def test_options_that_change_nothing_are_taken() -> None:
    config = get_config("zoedepth", "infer", train_midas=False, use_pretrained_midas=0, force_keep_ar=True)
    assert config == get_config("zoedepth", "infer")


@pytest.mark.parametrize(
    "name", ["zoedepth.utils.geometry", "zoedepth.models.zoedepth.zoedepth_v1", "zoedepth.trainers.builder"]
)
def test_other_modules_of_the_original_say_where_to_look(name: str) -> None:
    with pytest.raises(ModuleNotFoundError, match=r"is a module of isl-org/ZoeDepth.*docs/switching\.md"):
        importlib.import_module(name)


def test_colours_are_those_of_a_range_and_the_background_is_where_nothing_is_known() -> None:
    value = np.array([[[0.0, 1.0, 2.0], [-99.0, np.nan, 3.0]]])
    rgba = colorize(value, vmin=0, vmax=2)
    assert (rgba.shape, rgba.dtype) == ((2, 3, 4), np.uint8)
    assert rgba[0, 0].tolist() == [255, 255, 255, 255]  # gray_r: the nearest is white
    assert rgba[0, 2].tolist() == rgba[1, 2].tolist() == [0, 0, 0, 255]
    assert abs(int(rgba[0, 1, 0]) - 127) <= 1
    assert rgba[1, 0].tolist() == rgba[1, 1].tolist() == [128, 128, 128, 255]
    masked = colorize(torch.ones(1, 1, 2, 2), invalid_mask=np.eye(2) > 0, background_color=(1, 2, 3, 4))
    assert masked[0, 0].tolist() == [1, 2, 3, 4]
    assert masked[0, 1, 3] == 255
    assert np.all(colorize(np.full((2, 2), -99.0)) == (128, 128, 128, 255))
