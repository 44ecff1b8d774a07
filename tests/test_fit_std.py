"""The factor on a model's standard deviation, fitted to photos and kept in its file."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from scripts.fit_std import main
from tests.folders import write_pairs

from zoedepth import load_model, save_model
from zoedepth.config import INDOOR, ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth


def test_the_file_has_the_factor_which_fits_a_second_time(
    tiny_config: ModelConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch.manual_seed(0)
    save_model(ZoeDepth(replace(tiny_config, domains=(INDOOR,))), tmp_path / "model.safetensors")
    data = (f"rooms={write_pairs(tmp_path / 'rooms', split='test', n=3)}",)
    main(model=str(tmp_path / "model.safetensors"), out=tmp_path / "fitted.safetensors", data=data, camera="none")
    before, after = load_model(tmp_path / "model.safetensors"), load_model(tmp_path / "fitted.safetensors")
    factor = after.config.domains[0].std_factor
    assert f"indoor: 3 photos, std_factor {factor:g}, within one std" in capsys.readouterr().out
    assert not 0.9 < factor < 1.1, "a new model's deviation fits by chance"
    assert after.config == replace(before.config, domains=(replace(INDOOR, std_factor=factor),))
    # Copied from file to file, never computed with: equal on every processor.
    assert all(torch.equal(value, after.state_dict()[name]) for name, value in before.state_dict().items())
    main(model=str(tmp_path / "fitted.safetensors"), out=tmp_path / "again.safetensors", data=data, camera="none")
    assert load_model(tmp_path / "again.safetensors").config.domains[0].std_factor == pytest.approx(factor, abs=2e-3)


def test_every_domain_needs_photos(tiny_config: ModelConfig, tmp_path: Path) -> None:
    save_model(ZoeDepth(tiny_config), tmp_path / "model.safetensors")
    data = (f"rooms={write_pairs(tmp_path / 'rooms', split='test', n=1)}",)
    with pytest.raises(InputError, match=r"no photo of known depth went to \['(indoor|outdoor)'\]"):
        main(model=str(tmp_path / "model.safetensors"), out=tmp_path / "fitted.safetensors", data=data, camera="none")
    assert not (tmp_path / "fitted.safetensors").exists()


def test_a_file_that_is_there_stays(tmp_path: Path) -> None:
    (tmp_path / "kept.safetensors").write_text("somebody's")
    with pytest.raises(InputError, match=r"kept\.safetensors is there already"):
        main(model="zoed-lite", out=tmp_path / "kept.safetensors", data=("rooms=nowhere",))
    assert (tmp_path / "kept.safetensors").read_text() == "somebody's"
