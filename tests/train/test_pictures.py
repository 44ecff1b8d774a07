"""Pictures of a training: known and predicted depth on one scale of colours."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from zoedepth.config import ModelConfig
from zoedepth.data.sample import Sample
from zoedepth.geometry.camera import Intrinsics
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.train import pictures
from zoedepth.train.pictures import data_sheet, predictions_sheet


@pytest.fixture
def panels(monkeypatch: pytest.MonkeyPatch) -> list[tuple[np.ndarray, str]]:
    """The (picture, caption) of every panel that is drawn from here on."""
    drawn: list[tuple[np.ndarray, str]] = []
    draw = pictures.panel

    def spy(image: np.ndarray, *, caption: str, **options: object) -> np.ndarray:
        drawn.append((image, caption))
        return draw(image, caption=caption, **options)

    monkeypatch.setattr(pictures, "panel", spy)
    return drawn


@pytest.fixture
def colored(monkeypatch: pytest.MonkeyPatch) -> list[tuple[np.ndarray, dict[str, object]]]:
    """The (map, options) of every map that is coloured from here on."""
    maps: list[tuple[np.ndarray, dict[str, object]]] = []
    colorize = pictures.colorize
    monkeypatch.setattr(pictures, "colorize", lambda x, **options: maps.append((x, options)) or colorize(x, **options))
    return maps


def sample(kind: str = "depth", *, known: float = 0.5) -> Sample:
    """A photo of 64x96 whose depth grows from 1 to 5 with the columns, known on the left."""
    target = torch.linspace(1, 5, 96).expand(1, 64, 96).clone()
    mask = torch.arange(96).expand(1, 64, 96) < 96 * known
    image = torch.rand(3, 64, 96, generator=torch.Generator().manual_seed(0))
    return Sample(image, target, mask, kind, "indoor", "a" * 50 + ".jpg")


def test_a_row_has_photo_truth_and_prediction_on_one_scale(tiny_model: ZoeDepth, panels, colored) -> None:
    tiny_model.train()
    sheet = predictions_sheet(tiny_model, [sample(), sample()], stage="metric")
    assert tiny_model.training, "the model is left in the mode it was in"
    assert [caption for _, caption in panels[:3]] == [
        "…" + "a" * 35 + ".jpg indoor", "depth, known at 50%", "predicted depth",
    ]  # fmt: skip
    assert len(panels) == 6
    # 64x96 at the width of a panel.
    assert all(image.shape == (213, 320, 3) for image, _ in panels)
    assert sheet.shape[1] > 3 * 320
    (truth, scale), (predicted, same) = colored[:2]
    assert scale == same
    assert np.isnan(truth[:, 160:]).all()
    assert truth[0, 0] == pytest.approx(1, abs=0.02)
    assert scale["vmin"] == pytest.approx(1.02, abs=0.05)
    assert scale["vmax"] == pytest.approx(2.98, abs=0.1)
    tiny_model.eval()
    assert not np.isnan(predicted).any()


def test_prediction_takes_the_head_of_the_label_where_there_are_several(
    tiny_config: ModelConfig, tiny_model: ZoeDepth, colored
) -> None:
    for domain in ("indoor", "outdoor", "attic"):
        predictions_sheet(tiny_model, [replace(sample(), domain=domain)], stage="metric")
    indoor, outdoor, routed = (colored[i][0] for i in (1, 3, 5))
    assert not np.array_equal(indoor, outdoor)
    assert any(np.array_equal(routed, other) for other in (indoor, outdoor))
    one = ZoeDepth(replace(tiny_config, domains=tiny_config.domains[:1])).eval()
    predictions_sheet(one, [replace(sample(), domain="attic")], stage="metric")  # its one head takes any


def test_prediction_of_a_model_in_one_camera_is_for_the_camera_of_the_photo(tiny_config: ModelConfig, colored) -> None:
    torch.manual_seed(0)
    domains = (replace(tiny_config.domains[0], focal_px=80.0),)
    model = ZoeDepth(replace(tiny_config, domains=domains, canonical_camera=True, pad=False)).eval()
    known = replace(sample(), camera=Intrinsics(120.0, 120.0, 47.5, 31.5))
    predictions_sheet(model, [known, sample()], stage="metric")
    np.testing.assert_allclose(colored[1][0], 1.5 * colored[3][0], rtol=1e-5)


def test_stage_1_shows_disparity_with_the_prediction_fitted_to_it(tiny_model: ZoeDepth, panels, colored) -> None:
    predictions_sheet(tiny_model, [sample()], stage="relative")
    assert [caption for _, caption in panels[1:]] == ["disparity, known at 50%", "predicted disparity"]
    (truth, _), (predicted, _) = colored
    known = ~np.isnan(truth)
    assert truth[0, 0] == pytest.approx(1, abs=0.02)
    assert truth[0, 159] == pytest.approx(1 / 3, abs=0.02)
    # Least squares: the mean error is 0, and no error goes with the prediction.
    error = (predicted - truth)[known]
    assert error.mean() == pytest.approx(0, abs=1e-4)
    assert (error * predicted[known]).mean() == pytest.approx(0, abs=1e-3)


def test_disparity_is_shown_as_it_is(tiny_model: ZoeDepth, colored) -> None:
    predictions_sheet(tiny_model, [sample("disparity")], stage="relative")
    assert colored[0][0][0, 159] == pytest.approx(3, abs=0.03)


@pytest.mark.parametrize(("stage", "what"), [("relative", "disparity"), ("metric", "depth")])
def test_photo_without_known_depth_is_shown_all_the_same(tiny_model: ZoeDepth, panels, stage: str, what: str) -> None:
    predictions_sheet(tiny_model, [sample(known=0)], stage=stage)
    assert [caption for _, caption in panels[1:]] == [f"no known {what}"]


def test_data_is_shown_without_a_model(panels) -> None:
    data_sheet([sample(), sample("disparity")])
    assert [caption for _, caption in panels if "known" in caption] == [
        "depth, known at 50%",
        "disparity, known at 50%",
    ]
    assert len(panels) == 4
