"""``ZoeDepth.from_pretrained``."""

from pathlib import Path

import pytest
from tests.baselines import test_pixelbins
from tests.baselines.base import build as build_baseline

import zoedepth
from zoedepth.errors import InputError
from zoedepth.weights.exported import ExportedModel
from zoedepth.weights.load import load_model
from zoedepth.weights.pretrained import ZoeDepth
from zoedepth.weights.save import save_model


def test_from_pretrained_loads_a_zoedepth(tiny_model: ZoeDepth, tmp_path: Path):
    save_model(tiny_model, tmp_path / "model.safetensors")
    model = zoedepth.ZoeDepth.from_pretrained(tmp_path / "model.safetensors")
    assert type(model) is ZoeDepth is zoedepth.ZoeDepth
    assert model.config == tiny_model.config
    assert zoedepth.ZoeDepth.from_pretrained("zoed-lite").config == load_model("zoed-lite").config


def test_from_pretrained_refuses_a_baseline(tmp_path: Path):
    save_model(build_baseline(test_pixelbins.TINY), tmp_path / "bins.safetensors")
    with pytest.raises(InputError, match=r"bins.safetensors is one of the baselines.*zoedepth.load_model"):
        ZoeDepth.from_pretrained(tmp_path / "bins.safetensors")


def test_from_pretrained_refuses_an_exported_file(monkeypatch: pytest.MonkeyPatch):
    class Exported(ExportedModel):
        def __init__(self) -> None:
            pass

        def run(self, inputs: object, *, std: bool) -> dict:
            raise AssertionError("it is refused before anything is run")

    monkeypatch.setattr("zoedepth.weights.load.load_exported", lambda *_, **__: Exported())
    with pytest.raises(InputError, match=r"model.onnx is an exported model.*zoedepth.load_model"):
        ZoeDepth.from_pretrained("model.onnx")
