"""What the stages share: which data a run takes, how it is augmented, what is frozen, and the guard of the weights."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.folders import write_pairs
from torch import nn

from zoedepth.config import ModelConfig
from zoedepth.data.augment import augment
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Batch, Sample
from zoedepth.errors import InputError, TrainingError
from zoedepth.presets import BASELINES
from zoedepth.train.config import SourceConfig, TrainConfig
from zoedepth.train.log import Log
from zoedepth.train.loop import Run, freeze_batch_norm
from zoedepth.train.sources import augmentations, load_sources

MakeConfig = Callable[..., TrainConfig]
Data = dict[str, Path]


# ---------------------------------------------------------------------------------------------------- data


def test_data_finds_its_source_by_name(make_config: MakeConfig, data: Data) -> None:
    training, validation = load_sources(make_config(), data)
    assert [(source.name, len(subset)) for source, subset in training] == [("indoor", 4), ("outdoor", 2)]
    assert validation == {}


def test_last_pairs_are_held_out(make_config: MakeConfig, data: Data) -> None:
    training, validation = load_sources(make_config(holdout=1), data)
    assert [len(subset) for _, subset in training] == [3, 1]
    assert [sample.name for sample in validation["indoor"]] == [str(Path("image/train_003.jpg"))]
    assert [sample.name for sample in validation["outdoor"]] == [str(Path("image/train_001.jpg"))]


def test_disparity_is_held_out_too(make_config: MakeConfig, stills: Path) -> None:
    training, validation = load_sources(make_config("relative", holdout=1), {"relative": stills})
    assert [len(subset) for _, subset in training] == [2]
    assert [sample.name for sample in validation["relative"]] == [str(Path("image/still_002.jpg"))]


def test_unsuitable_data_is_an_error_that_says_why(
    make_config: MakeConfig, data: Data, stills: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"nyu.*indoor.*outdoor"):
        load_sources(make_config(), {"nyu": data["indoor"]})
    with pytest.raises(InputError, match="no data"):
        load_sources(make_config(), {})
    with pytest.raises(InputError, match=r"stills.*disparity"):
        load_sources(make_config(), {"relative": stills})
    with pytest.raises(InputError, match="holdout of 2 leaves none"):
        load_sources(make_config(holdout=2), data)
    attic = write_pairs(tmp_path, n=1)
    attic.write_text(attic.read_text().replace(",indoor", ",attic"))
    with pytest.raises(InputError, match=r"attic.*indoor"):
        load_sources(make_config(), {"indoor": attic})


# ---------------------------------------------------------------------------------------------------- augmentation

PLAIN = SourceConfig("indoor", rotate_degrees=0.0, color_probability=0.0)


def outdoor_sample(size: tuple[int, int] = (375, 1242)) -> Sample:
    """Depth grows with the columns, 1 to 100 m."""
    target = torch.linspace(1, 100, size[1]).expand(1, *size).clone()
    return Sample(torch.full((3, *size), 0.5), target, target > 0, "depth", "outdoor", "")


@pytest.mark.parametrize("stage", ["relative", "metric"])
@pytest.mark.parametrize("crop", ["fit", "squeeze"])
def test_samples_come_at_the_models_size(make_config: MakeConfig, crop: str, stage: str) -> None:
    source = dataclasses.replace(PLAIN, crop=crop, max_zoom=2.0, kitti_crop=True)
    result = augment(outdoor_sample(), augmentations(source, make_config(stage)), np.random.default_rng(0))
    assert result.image.shape == (3, 64, 64)
    assert result.kind == ("disparity" if stage == "relative" else "depth")


def test_depth_beyond_the_range_of_its_domain_is_unknown(make_config: MakeConfig) -> None:
    result = augment(outdoor_sample(), augmentations(PLAIN, make_config()), np.random.default_rng(0))
    assert 75 < result.target[result.mask].max() < 80
    indoor = dataclasses.replace(outdoor_sample(), domain="indoor")
    result = augment(indoor, augmentations(PLAIN, make_config()), np.random.default_rng(0))
    assert 8 < result.target[result.mask].max() < 10


def test_kitti_crop_leaves_the_top_and_the_sides_out(make_config: MakeConfig) -> None:
    sample = outdoor_sample()
    whole = augment(sample, augmentations(PLAIN, make_config()), np.random.default_rng(0))
    cropped = augment(
        sample, augmentations(dataclasses.replace(PLAIN, kitti_crop=True), make_config()), np.random.default_rng(0)
    )
    # 13 of 1242 columns at the left: 13 / 1241 * 99 m more than 1 m, and half a column of the small picture.
    assert whole.target.min() == pytest.approx(1 + 99 / 64 / 2, abs=0.2)
    assert cropped.target.min() == pytest.approx(1 + 13 / 1241 * 99 + 97 / 64 / 2, abs=0.2)


def test_every_number_of_a_source_changes_its_samples(make_config: MakeConfig) -> None:
    changes: dict[str, object] = {
        "crop": "fit",
        "kitti_crop": True,
        "rotate_degrees": 10.0,
        "color_probability": 1.0,
    }
    with_colors: dict[str, object] = {
        "gamma": (2.0, 2.0),
        "brightness": (0.5, 0.5),
        "channel_gain": (0.5, 0.5),
        "saturation": (0.0, 0.0),
    }
    with_fit: dict[str, object] = {"max_zoom": 3.0}
    with_zoom: dict[str, object] = {"zoom_probability": 0.0}
    cases = [
        (PLAIN, changes),
        (dataclasses.replace(PLAIN, color_probability=1.0), with_colors),
        (dataclasses.replace(PLAIN, crop="fit"), with_fit),
        (dataclasses.replace(PLAIN, crop="fit", max_zoom=3.0), with_zoom),
        (dataclasses.replace(PLAIN, crop="window"), {"window": (32, 96)}),
    ]
    tested = {name for _, values in cases for name in values}
    # Fails where a new field has no case. The others are the mixture's, the reader's or the loss's; sparse has its own.
    elsewhere = {"name", "weight", "gradient_term", "domain", "depth_scale", "sparse"}
    assert {field.name for field in dataclasses.fields(SourceConfig)} - elsewhere == tested

    rng = np.random.default_rng(0)
    sample = outdoor_sample()
    sample = dataclasses.replace(sample, image=torch.tensor(rng.random(sample.image.shape), dtype=torch.float32))

    def result(source: SourceConfig) -> torch.Tensor:
        augmented = augment(sample, augmentations(source, make_config()), np.random.default_rng(0))
        return torch.cat([augmented.image, augmented.target])

    for source, values in cases:
        for name, value in values.items():
            assert not torch.equal(result(source), result(dataclasses.replace(source, **{name: value}))), name


# ---------------------------------------------------------------------------------------------------- the step


def test_batch_norms_are_put_into_evaluation_and_still_learn() -> None:
    network = nn.Sequential(nn.Conv2d(3, 4, 1), nn.BatchNorm2d(4), nn.Sequential(nn.BatchNorm1d(4), nn.Dropout()))
    network.train()
    freeze_batch_norm(network)
    assert [module.training for module in network.modules()] == [True, True, False, True, False, True]
    assert all(parameter.requires_grad for parameter in network.parameters())


@pytest.fixture
def run(make_config: MakeConfig, data: Data, tmp_path: Path) -> Run:
    return Run(make_config(), part=lambda model: model, data=data, out=tmp_path, init=None, devices=1, n_nodes=1)


def weights_of(run: Run) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in run.state.model.state_dict().items()}


def batch_of(run: Run) -> Batch:
    return next(iter(run.batches()))


def assert_weights_are(run: Run, before: dict[str, torch.Tensor]) -> None:
    for name, value in run.state.model.state_dict().items():
        assert torch.equal(value, before[name]), name


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_loss_that_is_not_finite_stops_before_it_reaches_the_weights(run: Run, value: float) -> None:
    with run:
        before, batch = weights_of(run), batch_of(run)
        loss = value * sum(parameter.sum() for parameter in run.network.parameters())
        with pytest.raises(TrainingError, match=r"step 1.*\.jpg"):
            run.learn(loss, batch, {})
        assert_weights_are(run, before)


def test_gradient_that_is_not_finite_stops_before_it_reaches_the_weights(run: Run) -> None:
    with run:
        before, batch = weights_of(run), batch_of(run)
        # The root of 0 is 0 and has an infinite slope.
        loss = torch.sqrt(0 * sum(parameter.sum() for parameter in run.network.parameters()))
        with pytest.raises(TrainingError, match=r"step 1.*\.jpg"):
            run.learn(loss, batch, {})
        assert_weights_are(run, before)


def test_gradients_are_clipped_to_their_norm_and_the_norm_before_is_logged(run: Run) -> None:
    with run:
        batch = batch_of(run)
        parameters = list(run.network.parameters())
        seen: list[torch.Tensor] = []
        run.optimizer.optimizer.register_step_pre_hook(
            lambda *_: seen.append(torch.stack([p.grad.norm() for p in parameters]).norm())
        )
        run.learn(sum(3 * parameter.sum() for parameter in parameters), batch, {})
    norm = json.loads((run.out / "log.jsonl").read_text().splitlines()[0])["train/gradient_norm"]
    n_weights = sum(parameter.numel() for parameter in parameters)
    assert norm == pytest.approx(3 * n_weights**0.5, rel=1e-4)
    assert seen[0].item() == pytest.approx(run.config.optim.clip, rel=1e-3)


# ---------------------------------------------------------------------------------------------------- the log


def test_log_of_later_steps_is_forgotten_on_resuming(make_config: MakeConfig, tmp_path: Path) -> None:
    config = make_config(steps=9)
    log = Log(tmp_path, config, first_step=0, active=True)
    for step in range(1, 6):
        log.write(step, {"train/loss": step / 8})
    log.close()
    log = Log(tmp_path, config, first_step=3, active=True)
    log.write(4, {"train/loss": 44.0})
    log.close()

    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [(line["step"], line["train/loss"]) for line in lines] == [(1, 0.125), (2, 0.25), (3, 0.375), (4, 44.0)]


def test_processes_but_the_first_write_nothing(make_config: MakeConfig, tmp_path: Path) -> None:
    log = Log(tmp_path / "run", make_config(), first_step=0, active=False)
    log.write(1, {"train/loss": 1.0})
    log.close()
    assert not (tmp_path / "run").exists()


def test_samples_of_a_run_do_not_depend_on_the_number_of_workers(
    make_config: MakeConfig, data: Data, tmp_path: Path
) -> None:
    seen = []
    for n_workers in (0, 2):
        config = make_config(n_workers=n_workers)
        out = tmp_path / str(n_workers)
        with Run(config, part=lambda model: model, data=data, out=out, init=None, devices=1, n_nodes=1) as run:
            seen.append(list(run.batches()))
    assert len(seen[0]) == 4
    for first, second in zip(*seen, strict=True):
        assert first.names == second.names
        assert torch.equal(first.pixels, second.pixels)
        assert torch.equal(first.target, second.target)


def test_steps_that_make_no_sense_are_errors(make_config: MakeConfig, tiny_config: ModelConfig) -> None:
    for wrong in ({"steps": 0}, {"batch_size": 0}):
        with pytest.raises(InputError, match="steps and batch_size"):
            make_config(**wrong)
    with pytest.raises(InputError, match="mix_by"):
        make_config("relative", mix_by="batch")


def test_data_set_read_by_a_run_is_that_of_its_train_list(make_config: MakeConfig, data: Data) -> None:
    folder = data["indoor"].parent
    training, _ = load_sources(make_config(), {"indoor": folder})
    assert len(training[0][1]) == len(PairDataset(folder / "train.csv"))


def test_windows_go_with_the_network_and_with_their_batch(make_config: MakeConfig) -> None:
    window = dataclasses.replace(PLAIN, crop="window", window=(32, 64))
    with pytest.raises(InputError, match="multiples of 32"):
        make_config(sources=(dataclasses.replace(window, window=(40, 64)),))
    with pytest.raises(InputError, match="mix_by must be 'batch'"):
        make_config(sources=(window, dataclasses.replace(window, name="other", window=(64, 64))))
    make_config(sources=(window, dataclasses.replace(window, name="other", window=(64, 64))), mix_by="batch")


def test_baselines_have_no_first_stage(make_config: MakeConfig) -> None:
    with pytest.raises(InputError, match="stage 1 is for ZoeDepth"):
        make_config("relative", model=BASELINES["bts-n"])
