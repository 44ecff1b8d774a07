"""Checkpoints of the baselines, as files, by the front door."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.weights.layouts.layouts import released

from zoedepth.build import build_model
from zoedepth.cli import main
from zoedepth.config import INDOOR, OUTDOOR, BaselineConfig, BtsNetworkConfig
from zoedepth.errors import InputWarning
from zoedepth.weights.checkpoint import read_checkpoint
from zoedepth.weights.layouts import adabins, bts, huggingface, localbins, newcrfs, original, pixelbins
from zoedepth.weights.load import load_model

RECOGNISE = {
    "bts": bts.is_bts,
    "adabins": adabins.is_adabins,
    "localbins": localbins.is_localbins,
    "pixelbins": pixelbins.is_pixelbins,
    "newcrfs": newcrfs.is_newcrfs,
    "original-nk": original.is_original,
    "huggingface-nk": lambda weights: huggingface.layout_of(weights) is not None,
}


@pytest.mark.parametrize("name", RECOGNISE)
def test_every_layout_is_recognised_by_its_own_names_only(name: str):
    weights = released(name)
    assert {other for other, is_theirs in RECOGNISE.items() if is_theirs(weights)} == {name}


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file as BTS writes them: the weights of a wrapped model, and numbers of numpy beside them."""
    torch.manual_seed(0)
    ours = build_model(BaselineConfig(BtsNetworkConfig("densenet121"))).state_dict()
    theirs = {f"module.{name}": value for name, value in bts.table(512).to_theirs(ours).items()}
    path = tmp_path_factory.mktemp("published") / "model-17500-best_abs_rel_0.12.pt"
    torch.save({"global_step": np.int64(17500), "model": theirs, "best_eval_measures_lower_better": np.zeros(6)}, path)
    return path


def test_file_is_loaded_by_its_content(published: Path):
    assert read_checkpoint(published).layout == "bts"
    with pytest.warns(InputWarning, match=r"does not say how far .*--compat 80m"):
        near = load_model(published)
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        far = load_model(published, compat=["80m"])
    assert near.config.network == BtsNetworkConfig("densenet121")
    assert (near.config.domains, far.config.domains) == ((INDOOR,), (OUTDOOR,))
    with torch.no_grad():
        pixels = torch.rand(1, 3, 64, 96)
        assert torch.allclose(far(pixels).depth, 8 * near(pixels).depth, rtol=1e-4)


def test_range_is_written_into_the_converted_file(published: Path, tmp_path: Path):
    target = tmp_path / "bts.safetensors"
    assert main(["convert", str(published), str(target), "--to", "zoedepth", "--compat", "80m"]) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        assert load_model(target).config == load_model(published, compat=["80m"]).config


@pytest.mark.parametrize("to", ["original", "huggingface"])
def test_others_layouts_have_no_baselines(published: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], to: str):
    target = tmp_path / ("model.pt" if to == "original" else "model")
    assert main(["convert", str(published), str(target), "--to", to]) == 2
    assert f"the {to} layout cannot hold baselines" in capsys.readouterr().err
    assert not target.exists()
