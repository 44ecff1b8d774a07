"""Stage 1: it learns from depth and disparity alike, goes on exactly, and its result starts stage 2."""

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file
from tests.folders import write_csv, write_disparity_pairs, write_pairs

from zoedepth.data.augment import to_disparity
from zoedepth.data.pairs import PairDataset
from zoedepth.errors import TrainingError
from zoedepth.losses import mean_counted, scale_and_shift_invariant
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig
from zoedepth.train.metric import train_metric
from zoedepth.train.relative import RelativeModel, train_relative
from zoedepth.weights.load import load_model, save_model

MakeConfig = Callable[..., TrainConfig]
Data = dict[str, Path]


def log_of(out: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def config(make_config: MakeConfig) -> TrainConfig:
    return make_config("relative")


@pytest.fixture(scope="module")
def all_data(data: Data, stills: Path) -> Data:
    return {**data, "relative": stills}


@pytest.fixture(scope="module")
def finished(config: TrainConfig, all_data: Data, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run, never interrupted, to be read only: checkpoints after steps 2 and 4."""
    out = tmp_path_factory.mktemp("finished")
    train_relative(config, data=all_data, out=out, init=None)
    return out


def test_two_photos_are_learned_by_heart(make_config: MakeConfig, tmp_path: Path) -> None:
    calm = SourceConfig("indoor", rotate_degrees=0.0, color_probability=0.0)
    config = make_config(
        "relative",
        sources=(calm, dataclasses.replace(calm, name="relative")),
        steps=60,
        ema_decay=None,
        checkpoint_every=1000,
        optim=OptimConfig(learning_rate=5e-3, encoder_factor=1.0, warmup=0.2, initial_division=10, clip=1.0),
    )
    data = {
        "indoor": write_pairs(tmp_path / "indoor", n=1, size=(64, 64)),
        "relative": write_disparity_pairs(tmp_path / "stills", n=1, size=(64, 64)),
    }

    last = train_relative(config, data=data, out=tmp_path / "out", init=None)

    losses = [line["train/ssi"] for line in log_of(tmp_path / "out")]
    assert sum(losses[-5:]) < 0.5 * sum(losses[:5])
    model = RelativeModel(load_model(last))
    for path in data.values():
        sample = to_disparity()(PairDataset(path)[0], np.random.default_rng())  # draws nothing
        with torch.no_grad():
            relative = model(sample.image[None])
        # Near is large: the prediction goes with disparity, not with depth.
        pairs = torch.stack([relative[0][sample.mask], sample.target[sample.mask]])
        assert torch.corrcoef(pairs)[0, 1] > 0.7


def test_relative_depth_is_that_of_the_whole_model_at_the_photos_size(tiny_model: ZoeDepth) -> None:
    pixels = torch.rand(2, 3, 64, 96)
    with torch.no_grad():
        torch.testing.assert_close(RelativeModel(tiny_model)(pixels), tiny_model(pixels).relative)


@pytest.mark.parametrize(("trim", "gradient_weight"), [(0.2, 0.5), (0.0, 0.5), (0.2, 0.0)])
def test_loss_is_the_scale_and_shift_invariant_one_with_the_configured_terms(
    make_config: MakeConfig, tmp_path: Path, trim: float, gradient_weight: float
) -> None:
    # One photo of the network's size that is its own mirror image: every sample of it is the same.
    half = np.random.default_rng(0).integers(0, 256, (64, 32), dtype=np.uint8)
    stored = np.concatenate([half, half[:, ::-1]], axis=1)
    Image.fromarray(stored).save(tmp_path / "photo.png")
    path = write_csv(tmp_path / "train.csv", [{"image": "photo.png", "disparity": "photo.png"}])
    source = SourceConfig("relative", rotate_degrees=0.0, color_probability=0.0)
    config = make_config("relative", sources=(source,), steps=1, trim=trim, gradient_weight=gradient_weight)
    torch.manual_seed(3)
    start = ZoeDepth(config.model).train()
    save_model(start, tmp_path / "start.safetensors")

    train_relative(config, data={"relative": path}, out=tmp_path / "out", init=str(tmp_path / "start.safetensors"))

    target = torch.tensor(stored)[None, None].float()
    with torch.no_grad():
        relative = RelativeModel(start)(target.expand(-1, 3, -1, -1) / 255)
    # Scale and shift of the target do not matter.
    losses = scale_and_shift_invariant(relative, target, target > 0, trim=trim, gradient_weight=gradient_weight)
    loss = mean_counted(*losses)
    assert loss > 0.1
    assert log_of(tmp_path / "out")[0]["train/ssi"] == pytest.approx(loss.item(), rel=1e-3)


def test_heads_and_router_are_left_as_they_are(config: TrainConfig, all_data: Data, tmp_path: Path) -> None:
    config = dataclasses.replace(config, ema_decay=None)
    start = ZoeDepth(config.model)
    save_model(start, tmp_path / "start.safetensors")
    last = train_relative(config, data=all_data, out=tmp_path / "out", init=str(tmp_path / "start.safetensors"))

    before, after = start.state_dict(), load_model(last).state_dict()
    changed = {name.split(".")[0] for name in before if not torch.equal(before[name], after[name])}
    assert changed == {"encoder", "decoder"}


def test_resumed_run_equals_the_uninterrupted_one_bit_for_bit(
    config: TrainConfig, all_data: Data, finished: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(finished / "step_000002", out / "step_000002")
    shutil.copytree(finished / "step_000004", out / ".step_000004.part")
    (out / ".step_000004.part" / "train.pt").write_bytes(b"half a file")

    resumed = train_relative(config, data=all_data, out=out, init=None)

    assert resumed == out / "step_000004"
    saved = [torch.load(folder / "step_000004" / "train.pt", weights_only=True) for folder in (finished, out)]
    leaves = [torch.utils._pytree.tree_leaves(values) for values in saved]
    for a, b in zip(*leaves, strict=True):
        assert torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b
    results = [load_file(folder / "step_000004" / "model.safetensors") for folder in (finished, out)]
    assert all(torch.equal(value, results[1][name]) for name, value in results[0].items())


def test_result_starts_the_second_stage(make_config: MakeConfig, data: Data, finished: Path, tmp_path: Path) -> None:
    # A rate of nearly nothing shows where the second stage starts from.
    config = make_config(steps=1, ema_decay=None, optim=OptimConfig(learning_rate=1e-12))
    last = train_metric(config, data=data, out=tmp_path, init=str(finished / "step_000004"))
    first, second = load_model(finished / "step_000004"), load_model(last)
    for part in ("encoder", "decoder"):
        for name, value in getattr(first, part).state_dict().items():
            torch.testing.assert_close(getattr(second, part).state_dict()[name], value, atol=1e-9, rtol=1e-6)


def test_depth_of_an_unknown_domain_is_welcome(make_config: MakeConfig, tmp_path: Path) -> None:
    path = write_pairs(tmp_path / "attic", n=2, domain="outdoor")
    path.write_text(path.read_text().replace("outdoor", "attic"))
    train_relative(make_config("relative", steps=1), data={"relative": path}, out=tmp_path / "out", init=None)
    assert log_of(tmp_path / "out")[0]["train/ssi"] > 0


def test_loss_that_is_not_finite_stops_with_the_photos_named_and_checkpoints_intact(
    config: TrainConfig, all_data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, n_read = PairDataset.__getitem__, 0

    def spoil(dataset: PairDataset, index: int) -> object:
        nonlocal n_read
        n_read += 1
        sample = original(dataset, index)
        return dataclasses.replace(sample, image=sample.image * float("nan")) if n_read > 4 else sample

    monkeypatch.setattr(PairDataset, "__getitem__", spoil)
    with pytest.raises(TrainingError, match=r"step 3.*\.jpg"):
        train_relative(config, data=all_data, out=tmp_path, init=None)
    assert all(value.isfinite().all() for value in load_model(tmp_path / "step_000002").state_dict().values())
