"""Models in files of ours: whole, or not at all."""

import json
import resource
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open

from zoedepth.config import to_dict
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import ENCODERS
from zoedepth.provenance import Provenance
from zoedepth.weights.load import load_model
from zoedepth.weights.save import save_model


def test_half_precision_file_is_half_the_size_and_loads_as_float32(tiny_model: ZoeDepth, file: Path, tmp_path: Path):
    half = tmp_path / "half.safetensors"
    save_model(tiny_model, half, dtype=torch.float16)
    assert half.stat().st_size < 0.6 * file.stat().st_size
    found = load_model(half).state_dict()
    for name, value in tiny_model.state_dict().items():
        assert found[name].dtype == value.dtype
        assert torch.equal(found[name], value.half().float())


def test_integers_of_a_network_survive_half_precision(tiny_model: ZoeDepth, tmp_path: Path):
    """Batch norm counts its batches in an integer, which float16 could not hold."""
    model = ZoeDepth(replace(tiny_model.config, encoder=ENCODERS["tf_efficientnet_lite0"]))
    counters = [value for value in model.state_dict().values() if value.dtype == torch.int64]
    for counter in counters:
        counter.fill_(1_000_001)
    save_model(model, tmp_path / "model.safetensors", dtype=torch.float16)
    loaded = load_model(tmp_path / "model.safetensors")
    found = [value for value in loaded.state_dict().values() if value.dtype == torch.int64]
    assert len(found) == len(counters) > 0
    assert all(value.item() == 1_000_001 for value in found)


def test_saving_leaves_the_model_as_it_is(tiny_model: ZoeDepth, tmp_path: Path):
    tiny_model.train()
    before = {name: value.clone() for name, value in tiny_model.state_dict().items()}
    save_model(tiny_model, tmp_path / "model.safetensors", dtype=torch.float16)
    assert tiny_model.training
    assert all(torch.equal(before[name], value) for name, value in tiny_model.state_dict().items())


def test_config_in_the_file_is_plain_json(tiny_model: ZoeDepth, file: Path):
    with safe_open(str(file), framework="pt") as opened:
        config = json.loads(opened.metadata()["config"])
    assert config == json.loads(json.dumps(to_dict(tiny_model.config)))


def test_the_same_model_gives_the_same_file(tiny_model: ZoeDepth, tmp_path: Path):
    """safetensors itself shuffles the texts of the header."""
    tiny_model.provenance = Provenance("mit", "rooms", {"rooms": {"rel": 0.1}})
    contents = set()
    for name in range(8):
        save_model(tiny_model, tmp_path / f"{name}.safetensors")
        contents.add((tmp_path / f"{name}.safetensors").read_bytes())
    assert len(contents) == 1


# --- failed saves -----------------------------------------------------------------------------------------------------


def test_save_that_fails_half_way_leaves_nothing_new_and_nothing_broken(tiny_model: ZoeDepth, file: Path):
    """The disk takes no more than a part of the file; the file that was there stays as it was."""
    before = file.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, limits[1]))
    try:
        with pytest.raises(Exception, match=r"(?i)too large|i/o"):
            save_model(tiny_model, file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_save_over_a_folder_leaves_nothing(tiny_model: ZoeDepth, tmp_path: Path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError):
        save_model(tiny_model, tmp_path / "folder")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
    assert list((tmp_path / "folder").iterdir()) == []


def test_save_takes_the_place_of_an_older_file(tiny_model: ZoeDepth, file: Path):
    with torch.no_grad():
        next(tiny_model.parameters()).add_(1)
    save_model(tiny_model, file)
    assert torch.equal(next(load_model(file).parameters()), next(tiny_model.parameters()))
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_weights_too_large_for_half_precision_are_refused(tiny_model: ZoeDepth, tmp_path: Path):
    """They would become infinite, and the file could not be loaded."""
    with torch.no_grad():
        next(tiny_model.parameters()).view(-1)[0] = 1e6
    with pytest.raises(InputError, match="float16"):
        save_model(tiny_model, tmp_path / "model.safetensors", dtype=torch.float16)
    assert list(tmp_path.iterdir()) == []
