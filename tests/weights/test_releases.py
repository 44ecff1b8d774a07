"""Where published weights are looked for."""

from pathlib import Path

import pytest
from tests.twins import KITTI, NYU, twin, twin_config

from zoedepth.presets import PRESETS
from zoedepth.weights.checkpoint import read_checkpoint, write_checkpoint
from zoedepth.weights.load import load_model
from zoedepth.weights.releases import RELEASES, download_folder


def test_files_are_kept_where_torch_hub_keeps_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("TORCH_HOME", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert download_folder() == tmp_path / "cache/torch/hub/checkpoints"
    monkeypatch.setenv("TORCH_HOME", "~/torch")
    assert download_folder() == Path.home() / "torch/hub/checkpoints"


def test_every_release_is_a_preset_and_only_the_small_model_is_in_the_package(tmp_path: Path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    assert RELEASES.keys() <= PRESETS.keys()
    assert [name for name, release in RELEASES.items() if release.present] == ["zoed-lite"]
    assert all((release.url is None) == (name == "zoed-lite") for name, release in RELEASES.items())


def test_file_put_there_by_hand_is_loaded_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    twin(twin_config(heads=(NYU, KITTI))).save_pretrained(tmp_path / "twin")
    path = RELEASES["zoed-m12-nk"].path
    path.parent.mkdir(parents=True)
    write_checkpoint(read_checkpoint(tmp_path / "twin"), path, to="original")
    assert RELEASES["zoed-m12-nk"].present
    assert load_model("zoed-m12-nk").config.domains[1].name == "outdoor"
