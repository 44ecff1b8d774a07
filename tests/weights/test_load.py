"""The one door for models: names, files, folders and ids."""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tests.servers import FileServer

from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import PRESETS
from zoedepth.weights import load
from zoedepth.weights.load import available_models, find, is_here, load_model, pinned, weights_of
from zoedepth.weights.releases import RELEASES
from zoedepth.weights.save import save_model


def pixels() -> torch.Tensor:
    return torch.rand(2, 3, 64, 64, generator=torch.Generator().manual_seed(0))


# --- there and back ---------------------------------------------------------------------------------------------------


def test_every_bit_of_the_weights_comes_back(tiny_model: ZoeDepth, file: Path):
    loaded = load_model(file)
    assert loaded.config == tiny_model.config
    assert not loaded.training
    saved, found = tiny_model.state_dict(), loaded.state_dict()
    assert saved.keys() == found.keys()
    assert all(torch.equal(saved[name], found[name]) and saved[name].dtype == found[name].dtype for name in saved)
    with torch.no_grad():  # sums may be rounded otherwise: convolutions go by how weights lie in memory
        torch.testing.assert_close(loaded(pixels()).depth, tiny_model(pixels()).depth, rtol=1e-5, atol=1e-5)


def test_folder_with_a_model_is_loaded(tiny_model: ZoeDepth, file: Path):
    assert load_model(file.parent).config == tiny_model.config
    assert load_model(str(file)).config == tiny_model.config


# --- names ------------------------------------------------------------------------------------------------------------


class TestPinned:
    def test_a_training_stands_for_its_newest_checkpoint_of_now(self, file: Path, tmp_path: Path):
        for step in ("step_000001", "step_000002"):
            (tmp_path / "run" / step).mkdir(parents=True)
            (tmp_path / "run" / step / "model.safetensors").write_bytes(file.read_bytes())
        assert pinned(str(tmp_path / "run")) == tmp_path / "run" / "step_000002"
        assert pinned(str(file)) == str(file)

    def test_a_folder_that_is_called_as_a_published_model_does_not_stand_in_its_way(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        """As --out zoed-lite makes one."""
        monkeypatch.chdir(tmp_path)
        (tmp_path / "zoed-lite").mkdir()
        assert pinned("zoed-lite") == "zoed-lite"


def test_the_hubs_copy_stands_for_a_published_model_where_it_is_the_same(monkeypatch: pytest.MonkeyPatch):
    """Its file for ZoeD-K says another size of photos."""
    monkeypatch.setenv("TORCH_HOME", "nowhere")
    monkeypatch.setattr(load, "cached", lambda _: True)
    monkeypatch.setattr(load, "fetch", lambda repo: Path(repo))
    monkeypatch.setattr(load, "download", lambda url, *_, **__: Path("downloaded"))
    assert [find(f"zoed-m12-{kind}") for kind in ("n", "k", "nk")] == [
        Path("Intel/zoedepth-nyu"), Path("downloaded"), Path("Intel/zoedepth-nyu-kitti"),
    ]  # fmt: skip
    here = {name for name, release in RELEASES.items() if is_here(release)}
    assert {"zoed-lite", "zoed-m12-n", "zoed-m12-nk"} <= here
    assert "zoed-m12-k" not in here


class TestWeightsOf:
    def test_a_copy_has_the_same_wherever_it_lies_and_whatever_lies_beside_it(self, file: Path, tmp_path: Path):
        other = tmp_path / "elsewhere" / "other.safetensors"
        other.parent.mkdir()
        other.write_bytes(file.read_bytes())
        (other.parent / "config.json").write_text("{}")
        assert weights_of(other, pad=False) == weights_of(file, pad=False)

    def test_a_folder_counts_with_its_configuration(self, file: Path, tmp_path: Path):
        weights = tmp_path / "folder" / "model.safetensors"
        weights.parent.mkdir()
        weights.write_bytes(file.read_bytes())
        without = weights_of(weights.parent, pad=False)
        assert weights_of(weights, pad=False) == without
        (weights.parent / "config.json").write_text("{}")
        assert weights_of(weights.parent, pad=False) != without

    def test_an_exported_file_needs_nothing_beside_it(self, tmp_path: Path):
        (tmp_path / "room.onnx").write_bytes(b"graph and weights")
        alone = weights_of(tmp_path / "room.onnx", pad=False)
        (tmp_path / "room.safetensors").write_bytes(b"what it was made from")
        assert weights_of(tmp_path / "room.onnx", pad=False) == alone

    def test_a_published_model_is_known_by_its_name_wherever_its_files_are(self):
        assert weights_of("zoed-m12-n", pad=True) != weights_of("zoed-m12-k", pad=True)

    def test_other_weights_and_options_have_another(self, tiny_model: ZoeDepth, file: Path):
        found = [weights_of(file, pad=False), weights_of(file, pad=True), weights_of(file, compat=["10m"], pad=False)]
        other = copy.deepcopy(tiny_model)
        with torch.no_grad():
            next(other.parameters()).add_(1e-3)
        save_model(other, file)
        found.append(weights_of(file, pad=False))
        assert len(set(found)) == 4


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(InputError, match="no model named 'zoed-m13-n'") as caught:
        load_model("zoed-m13-n")
    assert available_models()
    assert all(name in str(caught.value) for name in available_models())


def test_model_of_the_paper_without_weights_says_so():
    with pytest.raises(InputError, match="zoed-x-n is a model of the paper whose weights nobody published"):
        load_model("zoed-x-n")


def test_available_models_are_presets():
    assert set(available_models()) <= set(PRESETS)


@pytest.mark.parametrize("name", ["model.safetensors", "folder/zoed-lite"])
def test_missing_file_is_named(tmp_path: Path, name: str):
    with pytest.raises(InputError, match=f"no file .*{name}"):
        load_model(tmp_path / name)


def test_folder_without_a_model_is_named(tmp_path: Path):
    with pytest.raises(InputError, match=tmp_path.name):
        load_model(tmp_path)


def test_published_model_is_downloaded_once_and_says_how_far_it_is(
    file: Path, tiny_model: ZoeDepth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    told = []
    with FileServer(file.read_bytes()) as server:
        monkeypatch.setitem(RELEASES, "zoed-m12-n", replace(RELEASES["zoed-m12-n"], url=server.url, hub_id=None))
        for _ in range(2):
            model = load_model("zoed-m12-n", progress=lambda *now: told.append(now))
            assert model.config == tiny_model.config
        assert len(server.requests) == 1
    size = file.stat().st_size
    assert (told[0], told[-1]) == (("zoed-m12-n", 0, size), ("zoed-m12-n", size, size))


# --- trainings --------------------------------------------------------------------------------------------------------


def test_folder_of_a_training_is_its_newest_checkpoint(tiny_model: ZoeDepth, tmp_path: Path):
    for number, bias in ((90, 1.0), (1000, 2.0), (200, 3.0)):
        tiny_model.encoder.network.cls_token.data.fill_(bias)
        save_model(tiny_model, tmp_path / f"run/step_{number:06d}/model.safetensors")
    (tmp_path / "run/step_002000").mkdir()  # half written
    for folder in (tmp_path / "run", tmp_path):  # that of a fine-tuning has the run in it
        assert find(folder) == tmp_path / "run/step_001000"
        assert (load_model(folder).encoder.network.cls_token == 2).all()
    save_model(tiny_model, tmp_path / "model.safetensors")
    assert find(tmp_path) == tmp_path, "weights of its own go first"


# --- the quickest way to depth ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{"compat": ("squeeze",)}, {"precision": "bfloat16"}, {"device": "cuda"}, {}])
def test_what_only_torch_can_do_is_loaded_with_torch(options: dict[str, Any], monkeypatch: pytest.MonkeyPatch):
    asked: list[object] = []
    monkeypatch.setattr(load, "load_model", lambda name, **_: asked.append(name))
    monkeypatch.setattr(load, "has_accelerator", lambda: True)
    load.load_for_prediction("zoed-lite", **options)
    assert asked == ["zoed-lite"]


def test_without_its_runtime_the_model_in_the_package_is_loaded_with_torch(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(load, "find_spec", lambda _: None)
    assert isinstance(load.load_for_prediction("zoed-lite", device="cpu"), ZoeDepth)


def test_files_and_models_without_a_graph_are_loaded_as_ever(file: Path):
    assert isinstance(load.load_for_prediction(file, device="cpu"), ZoeDepth)
    assert isinstance(load.load_for_prediction(str(file), device="cpu"), ZoeDepth)
