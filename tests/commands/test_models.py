"""The listing of models."""

import json
from pathlib import Path

import pytest

from zoedepth.cli import main
from zoedepth.weights.releases import RELEASES


class TestModels:
    @pytest.fixture(autouse=True)
    def empty_home(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("TORCH_HOME", str(tmp_path))

    def test_all_with_licence_source_and_presence(self, tmp_path: Path, capsys):
        assert main(["models", "--json"]) == 0
        found = {entry["name"]: entry for entry in map(json.loads, capsys.readouterr().out.splitlines())}
        assert set(found) == set(RELEASES)
        assert found["zoed-lite"]["present"]
        assert not found["zoed-m12-nk"]["present"]
        assert found["zoed-m12-nk"]["url"].startswith("https://github.com/isl-org/ZoeDepth/releases/")
        assert found["zoed-m12-nk"]["licence"] == "MIT"
        path = Path(found["zoed-m12-nk"]["path"])
        assert path == tmp_path / "hub" / "checkpoints" / "ZoeD_M12_NK.pt"
        path.parent.mkdir(parents=True)
        path.touch()
        assert main(["models", "--json"]) == 0
        again = {entry["name"]: entry for entry in map(json.loads, capsys.readouterr().out.splitlines())}
        assert again["zoed-m12-nk"]["present"]

    def test_text(self, capsys):
        assert main(["models"]) == 0
        text = capsys.readouterr().out
        for name, release in RELEASES.items():
            assert name in text
            assert release.what in text
        assert max(map(len, text.splitlines()[:-1])) <= 90, "the last line is a path"
