"""``zoedepth demo-train``: scenes, both stages, a table and a picture; typed again it goes on."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from zoedepth.cli import main
from zoedepth.recipes import demo
from zoedepth.train.config import TrainConfig
from zoedepth.weights.load import load_model


def test_demo_trains_both_stages_and_shows_what_came_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def small(recipe: Callable[[], TrainConfig]) -> Callable[[], TrainConfig]:
        config = replace(recipe(), model=replace(recipe().model, size=(64, 96)), steps=4, batch_size=2, holdout=2)
        return lambda: replace(config, validate_every=2, log_every=1, n_workers=0, pictures=1)

    monkeypatch.setattr(demo, "relative", small(demo.relative))
    monkeypatch.setattr(demo, "metric", small(demo.metric))
    command = ["demo-train", "--out", str(tmp_path), "--scenes", "6"]
    (tmp_path / "predictions.jpg").write_text("mine")
    assert main(command) == 2
    assert "predictions.jpg is not from zoedepth" in capsys.readouterr().err
    (tmp_path / "predictions.jpg").unlink()
    assert main(command) == 0
    printed = capsys.readouterr()
    assert [word for word in ("relative", "metric", "disparity RMSE", "REL") if word not in printed.out] == []
    assert "step_000004" in printed.err
    assert load_model(tmp_path / "metric/step_000004").config.size == (64, 96)
    with Image.open(tmp_path / "predictions.jpg") as picture:
        assert picture.size[0] > 3 * 320
    files = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.suffix in (".tar", ".pt")}
    assert main(command) == 0
    assert {path: path.stat().st_mtime_ns for path in files} == files, "nothing is rendered or trained again"
