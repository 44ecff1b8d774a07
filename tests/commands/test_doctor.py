"""The look at an installation says what is missing, and whether it predicts."""

import json
from pathlib import Path

import pytest

from zoedepth import __version__
from zoedepth.cli import main
from zoedepth.commands import doctor
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth


@pytest.fixture(autouse=True)
def _tiny(tiny_model: ZoeDepth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tiny model predicts, and the folders are empty ones."""
    monkeypatch.setattr("zoedepth.weights.load.load_for_prediction", lambda name: tiny_model)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def test_an_installation_that_predicts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["versions"]["zoedepth"] == __version__
    assert found["versions"]["torch"]
    assert found["problem"] is None
    assert found["seconds"] >= 0
    weights = found["folders"]["weights"]
    assert weights["path"] == str(tmp_path / "torch" / "hub" / "checkpoints")
    assert weights["writable"]
    assert not (tmp_path / "torch").exists(), "to look makes nothing"
    assert main(["doctor"]) == 0
    text = capsys.readouterr().out
    assert f"zoedepth {__version__} in " in text
    assert "zoed-lite predicts: the second photo of 480x640 took" in text


def test_extras_that_are_missing_are_named_with_how_to_install_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "find_spec", lambda module: None if module in ("h5py", "nncf") else object())
    assert main(["doctor"]) == 0
    lines = [line.split("lacks") for line in capsys.readouterr().out.splitlines() if "pip install" in line]
    assert [[part.strip() for part in line] for line in lines] == [
        ["pip install 'zoedepth[data]'", "h5py"],
        ["pip install 'zoedepth[openvino]'", "nncf"],
    ]
    monkeypatch.setattr(doctor, "find_spec", lambda module: object())
    assert main(["doctor"]) == 0
    assert "All extras are installed." in capsys.readouterr().out


def test_one_that_does_not_predict_says_why_and_ends_with_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(name: str) -> None:
        raise InputError(f"the file of {name} is cut")

    monkeypatch.setattr("zoedepth.weights.load.load_for_prediction", broken)
    assert main(["doctor"]) == 1
    assert "zoed-lite DOES NOT PREDICT: InputError: the file of zoed-lite is cut" in capsys.readouterr().out
    assert main(["doctor", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["seconds"] is None


def test_a_folder_that_cannot_be_written_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("zoedepth.commands.doctor.os.access", lambda path, mode: False)  # root may write anywhere
    assert main(["doctor"]) == 0
    assert capsys.readouterr().out.count("CANNOT BE WRITTEN") == 3
