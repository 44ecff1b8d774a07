"""``zoedepth verify``: what it prints, writes and returns."""

from pathlib import Path

import pytest
from tests.reproduction.released import write_released

from zoedepth.cli import main
from zoedepth.config import ModelConfig


def test_command_says_what_is_missing_and_its_code_does_too(
    tiny_config: ModelConfig,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "no-cache"))
    folder = tmp_path / "files"
    write_released(folder, tiny_config)
    assert main(["verify", str(folder), "--out", str(tmp_path / "out")]) == 1
    shown = capsys.readouterr()
    assert "ZoeD-M12-NK" in shown.out
    assert "not there: kitti: no folder" in shown.err
    text = (tmp_path / "out" / "verify.md").read_text()
    assert "Not there:" in text
    assert "- zoed-m12-nk: no ZoeD_M12_NK.pt" in text
    assert main(["verify", str(folder), "--out", str(tmp_path / "out")]) == 1  # its own report is replaced
    (tmp_path / "out" / "verify.md").write_text("mine")
    assert main(["verify", str(folder), "--out", str(tmp_path / "out")]) == 2
    assert (tmp_path / "out" / "verify.md").read_text() == "mine"
    assert "verify.md is not from zoedepth" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert main(["verify", str(tmp_path / "empty"), "--out", str(tmp_path / "out")]) == 2
    assert "there is nothing to verify" in capsys.readouterr().err
