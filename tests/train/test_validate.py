"""Validation while training: the paper's protocol in stage 2, disparity with scale and shift given in stage 1."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.folders import write_disparity_pairs, write_pairs
from torch.utils.data import Subset

from zoedepth.config import ModelConfig, RouterConfig
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Sample
from zoedepth.evaluation.predictions import ModelSource, Prediction
from zoedepth.evaluation.protocols import Protocol
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.train import validate as module
from zoedepth.train.validate import validate


def rmse(data: PairDataset, rows: slice, columns: slice, shares: tuple[float, ...]) -> float:
    """The mean over the photos of the RMSE inside of a crop, where a prediction is off by a share of the depth."""
    found = []
    for sample, share in zip(data, shares, strict=True):
        known = sample.target[0, rows, columns][sample.mask[0, rows, columns]].numpy().astype(np.float64)
        found.append(share * np.sqrt(np.mean(known**2)))
    return float(np.mean(found))


@pytest.fixture
def too_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """Predictions that are 10 % too far for the first photo and 30 % for the others, from the indoor head."""

    def predict(source: ModelSource, sample: Sample, protocol: Protocol) -> tuple[Prediction, Sample]:
        assert not source.model.training
        factor = 1.1 if sample.name.endswith("0.jpg") else 1.3
        return Prediction(factor * sample.target[0].numpy(), domain="indoor"), sample

    monkeypatch.setattr(module, "predict", predict)


def test_stage_2_has_the_mean_metrics_of_the_images_and_the_share_that_is_routed_right(
    tiny_model: ZoeDepth, tmp_path: Path, too_far: None
) -> None:
    rooms = PairDataset(write_pairs(tmp_path / "rooms", n=2, size=(480, 640)))
    streets = PairDataset(write_pairs(tmp_path / "streets", n=1, size=(352, 1216), domain="outdoor"))
    found = validate(tiny_model.train(), {"rooms": rooms, "streets": streets}, stage="metric")
    assert tiny_model.training
    # The crops of Eigen and Garg for these sizes. Predictions are float32, whose rounding is 1e-6 of such an error.
    off_in_rooms = rmse(rooms, slice(45, 471), slice(41, 601), (0.1, 0.3))
    off_in_streets = rmse(streets, slice(143, 349), slice(43, 1172), (0.1,))
    assert found == {
        "validation/rooms/rel": pytest.approx(0.2),
        "validation/rooms/rmse": pytest.approx(off_in_rooms, rel=1e-5),
        "validation/rooms/delta1": 0.5,
        "validation/rooms/router": 1,
        "validation/streets/rel": pytest.approx(0.1),
        "validation/streets/rmse": pytest.approx(off_in_streets, rel=1e-5),
        "validation/streets/delta1": 1,
        "validation/streets/router": 0,
    }
    assert validate(tiny_model.eval(), {"rooms": rooms}, stage="metric").keys() <= found.keys()
    assert not tiny_model.training


def test_photos_without_a_pixel_to_score_have_no_metrics(tiny_model: ZoeDepth, tmp_path: Path) -> None:
    path = write_pairs(tmp_path / "rooms", n=2, without_truth=(1,))
    some, none = PairDataset(path), Subset(PairDataset(path), [1])
    found = validate(tiny_model, {"some": some, "none": none}, stage="metric")
    assert {name for name in found if "/none/" in name} == {"validation/none/router"}
    alone = validate(tiny_model, {"some": Subset(some, [0])}, stage="metric")
    assert found["validation/some/rel"] == alone["validation/some/rel"] > 0


def test_model_in_one_camera_is_told_the_camera_where_it_is_known(
    tiny_config: ModelConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []

    def predict(source: ModelSource, sample: Sample, protocol: Protocol) -> tuple[Prediction, Sample]:
        told.append(source.camera)
        return Prediction(sample.target[0].numpy()), sample

    monkeypatch.setattr(module, "predict", predict)
    data = PairDataset(write_pairs(tmp_path / "rooms", n=2, focal_px=(50.0,)))
    domains = (replace(tiny_config.domains[0], focal_px=80.0),)
    for canonical in (True, False):
        model = ZoeDepth(replace(tiny_config, domains=domains, canonical_camera=canonical)).eval()
        validate(model, {"rooms": data}, stage="metric")
    assert told == ["data", "none", "none", "none"]


@pytest.mark.parametrize("kind", ["depth", "disparity"])
def test_stage_1_has_the_error_of_disparity_after_scale_and_shift(
    tiny_model: ZoeDepth, tmp_path: Path, kind: str
) -> None:
    write = write_pairs if kind == "depth" else write_disparity_pairs
    data = PairDataset(write(tmp_path / "photos", n=2))
    found = validate(tiny_model, {"photos": data}, stage="relative")
    errors = []
    for sample in data:
        known = sample.mask[0].numpy()
        truth = sample.target[0].numpy().astype(np.float64)[known]
        truth = 1 / truth if kind == "depth" else truth
        truth = (truth - truth.min()) / (truth.max() - truth.min())
        said = Predictor(tiny_model, pad=False, upsampling="bilinear").relative(sample.image)[known].astype(np.float64)
        errors.append(np.sqrt(np.mean((np.polyval(np.polyfit(said, truth, 1), said) - truth) ** 2)))
    assert found == {"validation/photos/disparity_rmse": pytest.approx(np.mean(errors), rel=1e-4)}
    assert 0.01 < np.mean(errors) < 0.5


def test_stage_1_without_any_known_depth_has_no_metric(tiny_model: ZoeDepth, tmp_path: Path) -> None:
    data = PairDataset(write_pairs(tmp_path / "empty", n=1, without_truth=(0,)))
    assert validate(tiny_model, {"empty": data}, stage="relative") == {}


def test_labeled_router_is_told_the_domain(tiny_config: ModelConfig, tmp_path: Path) -> None:
    labeled = replace(tiny_config, router=RouterConfig("labeled"))
    rooms = PairDataset(write_pairs(tmp_path / "rooms", n=1))
    found = validate(ZoeDepth(labeled).eval(), {"rooms": rooms}, stage="metric")
    assert found.keys() == {f"validation/rooms/{metric}" for metric in ("rel", "rmse", "delta1")}
