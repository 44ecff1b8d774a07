"""Stage 1: it learns from depth and disparity alike, goes on exactly, and its result starts stage 2."""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.folders import write_csv, write_disparity_pairs, write_pairs
from tests.train.runs import assert_same_checkpoint, log_of, on_reading, weights_of

from zoedepth.data.augment import to_disparity
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Sample
from zoedepth.errors import TrainingError
from zoedepth.losses import mean_counted, scale_and_shift_invariant
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.train import relative
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig
from zoedepth.train.metric import train_metric
from zoedepth.train.relative import RelativeModel, train_relative
from zoedepth.weights.load import load_model
from zoedepth.weights.save import save_model

MakeConfig = Callable[..., TrainConfig]
Data = dict[str, Path]


# AdamW's first steps are signs of gradients, which turn the last digit into a whole step: eps calms it.
CALM = OptimConfig(learning_rate=1e-3, encoder_factor=1.0, warmup=0.3, clip=1.0, eps=1.0)


@pytest.fixture(scope="module")
def config(make_config: MakeConfig) -> TrainConfig:
    """A run whose steps have two batches each."""
    return make_config("relative", batch_size=4, accumulate=2)


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
        steps=40,
        ema_decay=None,
        checkpoint_every=1000,
        optim=OptimConfig(learning_rate=5e-3, encoder_factor=1.0, warmup=0.2, initial_division=10, clip=1.0),
        seed=43,  # its weights learn both in either precision, with the first random numbers of torch 2.6 and of 2.14
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
    assert_same_checkpoint(finished / "step_000004", resumed)


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
    n_read = 0

    def spoil(sample: Sample) -> Sample:
        nonlocal n_read
        n_read += 1
        return dataclasses.replace(sample, image=sample.image * float("nan")) if n_read > 8 else sample

    on_reading(monkeypatch, spoil)
    with pytest.raises(TrainingError, match=r"step 3.*\.jpg"):
        train_relative(config, data=all_data, out=tmp_path, init=None)
    assert all(value.isfinite().all() for value in load_model(tmp_path / "step_000002").state_dict().values())


# ---------------------------------------------------------------------------------------------------- several batches


def test_accumulated_step_is_that_of_the_whole_batch(make_config: MakeConfig, data: Data, tmp_path: Path) -> None:
    results, logs = [], []
    for accumulate in (1, 2):
        config = make_config("relative", batch_size=4, steps=2, ema_decay=None, accumulate=accumulate, optim=CALM)
        out = tmp_path / str(accumulate)
        results.append(weights_of(train_relative(config, data=data, out=out)))
        logs.append(log_of(out))
    for name, value in results[0].items():
        torch.testing.assert_close(results[1][name], value, rtol=1e-4, atol=1e-6, msg=name)
    for one, two in zip(*logs, strict=True):
        assert one["step"] == two["step"]
        assert two["train/ssi"] == pytest.approx(one["train/ssi"], rel=1e-4)
        assert two["train/gradient_norm"] == pytest.approx(one["train/gradient_norm"], rel=1e-3)


# ---------------------------------------------------------------------------------------------------- many data sets


def weights_in(out: Path) -> list[list[float]]:
    """Return the logged weights of the three data sets, a row a step."""
    names = ("indoor", "outdoor", "relative")
    return [[line[f"train/weight/{name}"] for name in names] for line in log_of(out)]


def test_every_image_has_the_same_weight_unless_configured(
    make_config: MakeConfig, all_data: Data, tmp_path: Path
) -> None:
    sources = tuple(
        dataclasses.replace(source, weight=w) for source, w in zip(make_config().sources, (3, 2, 1), strict=True)
    )
    train_relative(make_config("relative", steps=1, batch_size=6, sources=sources), data=all_data, out=tmp_path)
    (line,) = log_of(tmp_path)
    assert weights_in(tmp_path) == [pytest.approx([3 / 6, 2 / 6, 1 / 6])]
    losses = [line[f"train/ssi/{name}"] for name in ("indoor", "outdoor", "relative")]
    assert line["train/ssi"] == pytest.approx((3 * losses[0] + 2 * losses[1] + losses[2]) / 6)


@pytest.mark.parametrize("fields", [{}, {"precision": "bf16-mixed", "pareto_parameters": "all"}])
def test_pareto_weights_lower_the_norm_of_the_gradient(
    make_config: MakeConfig, all_data: Data, tmp_path: Path, fields: dict[str, object]
) -> None:
    """Under mixed precision Fabric guards against backward passes that it does not know."""
    norms = []
    for task_weights in ("images", "pareto"):
        config = make_config("relative", steps=1, batch_size=6, task_weights=task_weights, **fields)
        out = tmp_path / task_weights
        train_relative(config, data=all_data, out=out)
        norms.append(log_of(out)[0]["train/gradient_norm"])
    (weights,) = weights_in(out)
    assert sum(weights) == pytest.approx(1, abs=1e-5)
    assert min(weights) >= 0
    assert weights != pytest.approx([1 / 3] * 3, abs=0.01)
    assert norms[1] < norms[0]


def test_pareto_weights_outlive_an_interruption(make_config: MakeConfig, all_data: Data, tmp_path: Path) -> None:
    """Solved for at every third step: between them, a resumed run needs the last solution."""
    config = make_config("relative", steps=4, batch_size=6, task_weights="pareto", pareto_every=3)
    whole = train_relative(config, data=all_data, out=tmp_path / "whole")

    shutil.copytree(tmp_path / "whole/step_000002", tmp_path / "out/step_000002")
    resumed = train_relative(config, data=all_data, out=tmp_path / "out")
    assert_same_checkpoint(whole, resumed)
    weights = weights_in(tmp_path / "whole")
    assert all(sum(row) == pytest.approx(1, abs=1e-5) for row in weights)
    assert weights[1] == weights[0] == weights[2]
    assert weights[3] != weights[2]
    assert weights_in(tmp_path / "out") == weights[2:]


def test_pareto_weights_are_solved_for_again_where_a_data_set_has_none(
    make_config: MakeConfig, all_data: Data, tmp_path: Path
) -> None:
    """A batch of two has two of the three data sets, in turn."""
    config = make_config("relative", steps=3, batch_size=2, task_weights="pareto", pareto_every=100)
    last = train_relative(config, data=all_data, out=tmp_path)
    for line in log_of(tmp_path):
        present = [value for name, value in line.items() if name.startswith("train/weight/")]
        assert len(present) == 2
        assert sum(present) == pytest.approx(1, abs=1e-5)
    kept = torch.load(last / "train.pt", weights_only=True)["task_weights"]
    assert kept.isnan().sum() == 1


def test_pareto_weights_of_the_data_sets_in_a_batch_add_up_to_one(
    make_config: MakeConfig, all_data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second batch has two of the three data sets that the first was solved for."""
    monkeypatch.setattr(relative, "pareto_weights", lambda *_: torch.tensor([0.5, 0.3, 0.2]))
    sources = (SourceConfig("indoor", weight=2), SourceConfig("outdoor"), SourceConfig("relative"))
    config = make_config("relative", sources=sources, steps=2, batch_size=3, task_weights="pareto", pareto_every=100)
    train_relative(config, data=all_data, out=tmp_path)
    first, second = ({k: v for k, v in line.items() if k.startswith("train/weight/")} for line in log_of(tmp_path))
    assert list(first.values()) == pytest.approx([0.5, 0.3, 0.2])
    assert second == {
        "train/weight/indoor": pytest.approx(5 / 8),
        "train/weight/outdoor": pytest.approx(3 / 8),
    }


def test_batch_without_any_known_depth_changes_nothing(make_config: MakeConfig, tmp_path: Path) -> None:
    empty = {name: write_pairs(tmp_path / name, n=1, without_truth=(0,)) for name in ("indoor", "outdoor")}
    optim = OptimConfig(weight_decay=0.0)
    for task_weights in ("images", "pareto"):
        config = make_config("relative", steps=1, task_weights=task_weights, optim=optim, ema_decay=None)
        torch.manual_seed(0)
        start = ZoeDepth(config.model)
        save_model(start, tmp_path / "start.safetensors")
        last = train_relative(config, data=empty, out=tmp_path / task_weights, init=str(tmp_path / "start.safetensors"))
        after = load_model(last).state_dict()
        assert all(torch.equal(value, after[name]) for name, value in start.state_dict().items())
        assert log_of(tmp_path / task_weights)[0]["train/ssi"] == 0


def test_gradient_term_can_be_left_out_for_a_source(make_config: MakeConfig, data: Data, tmp_path: Path) -> None:
    losses = []
    for term in (True, False):
        config = make_config("relative", steps=1)
        sources = tuple(dataclasses.replace(source, gradient_term=term) for source in config.sources)
        config = dataclasses.replace(config, sources=sources)
        train_relative(config, data={"indoor": data["indoor"]}, out=tmp_path / str(term))
        losses.append(log_of(tmp_path / str(term))[0]["train/ssi"])
    assert losses[1] < 0.9 * losses[0]
