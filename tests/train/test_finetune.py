"""Fine-tuning on somebody's own data: what is found, what is chosen, what comes out."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.folders import write_csv, write_disparity_pairs, write_pairs

from zoedepth.cli import main
from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.opening import open_dataset
from zoedepth.train.finetune import plan
from zoedepth.train.survey import survey
from zoedepth.weights.load import load_model, save_model


@pytest.fixture
def init(tiny_model: ZoeDepth, tmp_path: Path) -> str:
    """A two-domain model to start from."""
    path = tmp_path / "init.safetensors"
    save_model(tiny_model, path)
    return str(path)


def write_sparse(folder: Path, *, n: int = 3) -> Path:
    """Photos with 2 % known pixels at 4 to 6 m, of a domain of their own."""
    rng = np.random.default_rng(0)
    (folder / "image").mkdir(parents=True)
    rows = []
    for index in range(n):
        stored = np.where(rng.random((64, 96)) < 0.02, rng.uniform(4000, 6000, (64, 96)), 0).astype(np.uint16)
        Image.fromarray(rng.integers(0, 255, (64, 96, 3), np.uint8)).save(folder / f"image/{index}.jpg")
        Image.fromarray(stored).save(folder / f"image/{index}.png")
        rows.append(
            {"image": f"image/{index}.jpg", "depth": f"image/{index}.png", "depth_scale": 1000, "domain": "warehouse"}
        )
    return write_csv(folder / "train.csv", rows)


def test_survey_finds_ranges_sizes_and_density(tmp_path: Path):
    found, samples = survey(open_dataset(write_pairs(tmp_path / "rooms", n=3)), name="rooms")
    assert (found.n, found.n_seen, found.sizes, found.count) == (3, 3, ((64, 96),), {"indoor": 3})
    assert found.known == pytest.approx(7 / 8)
    assert 1.0 <= found.near["indoor"] < 2.5 and 4 < found.far["indoor"] <= 5.0  # noqa: PT018  # one range
    assert not found.sparse
    assert len(samples) == 3


def test_survey_sees_scattered_points(tmp_path: Path):
    found, _ = survey(open_dataset(write_sparse(tmp_path)), name="lidar")
    assert found.sparse
    assert found.known == pytest.approx(0.02, abs=0.006)


def test_data_without_metres_or_without_depth_is_an_error(tmp_path: Path):
    with pytest.raises(InputError, match="stills has disparity"):
        survey(open_dataset(write_disparity_pairs(tmp_path / "stills")), name="stills")
    empty = write_pairs(tmp_path / "empty", n=2, without_truth=(0, 1))
    with pytest.raises(InputError, match=r"no depth is known in any of 2 photos of \['indoor'\]"):
        survey(open_dataset(empty), name="empty")


def test_plan_fits_the_data(init: str, tmp_path: Path, tiny_config: ModelConfig):
    path = write_pairs(tmp_path / "rooms", n=20)
    chosen = plan({"rooms": str(path)}, init=init, out=tmp_path / "out")
    config = chosen.config
    assert config.model == tiny_config
    assert config.holdout == 2
    assert [source.name for source in config.sources] == ["rooms"]
    assert not config.sources[0].sparse
    # Forty and some epochs of 18 pairs, four at once.
    assert config.steps == pytest.approx(40 * (30 / 18) ** 0 * 18 / 4, rel=0.01)
    assert config.domain_weight == 0
    assert (tmp_path / "out/data.jpg").is_file()


def test_more_data_means_fewer_epochs(init: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from zoedepth.train.finetune import _steps

    assert _steps(30, 4) == 300
    assert _steps(1000, 4) == pytest.approx(40 * (30 / 1000) ** 0.4 * 250, rel=0.01)
    assert _steps(24231, 16) == round(5 * 24231 / 16)  # the paper's five epochs


def test_too_few_pairs_are_an_error(init: str, tmp_path: Path):
    path = write_pairs(tmp_path / "rooms", n=1)
    with pytest.raises(InputError, match="a holdout of 1 leaves none"):
        plan({"rooms": str(path)}, init=init, out=tmp_path / "out")


def test_finetuning_writes_a_better_model_its_card_and_the_comparison(init: str, tmp_path: Path, capsys):
    path = write_pairs(tmp_path / "rooms", n=6, size=(480, 640))  # Eigen's crop leaves something of this size
    out = tmp_path / "out"
    arguments = ["train", "finetune", "--data", f"rooms={path}", "--init", init, "--out", str(out), "--steps", "60"]
    assert main([*arguments, "--learning-rate", "0.004", "--holdout", "2"]) == 0
    printed = capsys.readouterr()
    assert "6 pairs, 640x480; depth known at 88% (dense)" in printed.err
    assert "before" in printed.out
    assert "after" in printed.out
    measured = json.loads((out / "metrics.json").read_text())["rooms"]
    assert measured["before"]["n_scored"] == measured["after"]["n_scored"] == 2
    assert measured["after"]["metrics"]["rel"] < 0.8 * measured["before"]["metrics"]["rel"]
    assert load_model(out / "model.safetensors").config == load_model(init).config
    card = (out / "README.md").read_text()
    assert "rooms (4 pairs)" in card
    assert f"{measured['after']['metrics']['rel']:.3f}" in card
    # Again: everything is there, nothing is trained.
    assert main([*arguments, "--learning-rate", "0.004", "--holdout", "2"]) == 0
    assert len((out / "run/log.jsonl").read_text().splitlines()) > 0


def test_third_domain_of_scattered_depth_is_added_and_learned(init: str, tmp_path: Path, capsys):
    path, out = write_sparse(tmp_path / "lidar", n=4), tmp_path / "out"
    arguments = ["train", "finetune", "--data", f"lidar={path}", "--init", init, "--out", str(out), "--steps", "30"]
    assert main([*arguments, "--learning-rate", "0.003", "--holdout", "1"]) == 0
    error = capsys.readouterr().err
    assert "(scattered points)" in error
    assert "There is no photo of indoor, outdoor in the data" in error
    model = load_model(out / "model.safetensors")
    assert [domain.name for domain in model.config.domains] == ["indoor", "outdoor", "warehouse"]
    assert model.config.domains[2].max_depth == 8.0
    measured = json.loads((out / "metrics.json").read_text())["lidar"]
    assert measured["after"]["router"] == 1
    assert measured["after"]["metrics"]["rel"] < measured["before"]["metrics"]["rel"]


def test_unit_and_domain_that_the_data_does_not_say_are_given(init: str, tmp_path: Path, capsys):
    for index in range(3):
        for folder, picture in (
            ("images", np.zeros((48, 64, 3), np.uint8)),
            ("depth", np.full((48, 64), 500, np.uint16)),
        ):
            (tmp_path / "mine" / folder).mkdir(parents=True, exist_ok=True)
            Image.fromarray(picture).save(tmp_path / f"mine/{folder}/{index}.png")
    arguments = ["train", "finetune", "--data", str(tmp_path / "mine"), "--init", init, "--steps", "1"]
    assert main([*arguments, "--out", str(tmp_path / "a"), "--domain", "attic"]) == 2  # 500 of what?
    assert "depth_scale" in capsys.readouterr().err
    arguments += ["--depth-scale", "200", "--domain", "attic", "--out", str(tmp_path / "b")]
    assert main(arguments) == 0
    assert "attic 2.50 to 2.5 m" in capsys.readouterr().err
    assert [domain.name for domain in load_model(tmp_path / "b/model.safetensors").config.domains][2] == "attic"
