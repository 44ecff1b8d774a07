"""Stage 2: it learns, it is reproducible, and an interrupted run goes on as if nothing had happened."""

import dataclasses
import math
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Literal

import pytest
import torch
import torch.nn.functional as F
from tests.baselines.base import ENCODER
from tests.folders import write_pairs
from tests.train.runs import assert_same_checkpoint, log_of, on_reading, weights_of

from zoedepth.config import EncoderConfig, ModelConfig, RouterConfig
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Batch, Sample, collate
from zoedepth.errors import InputError, TrainingError
from zoedepth.model.zoedepth import DepthOutput, ZoeDepth
from zoedepth.presets import PRESETS
from zoedepth.train import metric, relative
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig
from zoedepth.train.metric import filling, metric_losses, train_metric
from zoedepth.train.relative import train_relative
from zoedepth.train.state import checkpoints
from zoedepth.weights.load import load_model
from zoedepth.weights.save import save_model

MakeConfig = Callable[..., TrainConfig]
Data = dict[str, Path]

CALM = SourceConfig("indoor", rotate_degrees=0.0, color_probability=0.0)
"""A source that leaves photos as they are, but for mirroring."""


@pytest.fixture(scope="module")
def config(make_config: MakeConfig, tiny_config: ModelConfig) -> TrainConfig:
    """A run whose router draws random numbers (dropout) in every step."""
    router = RouterConfig("trained", classifier="transformer", width=16)
    return make_config(model=dataclasses.replace(tiny_config, router=router))


@pytest.fixture(scope="module")
def finished(config: TrainConfig, data: Data, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of that run, never interrupted, to be read only: checkpoints after steps 2 and 4."""
    out = tmp_path_factory.mktemp("finished")
    train_metric(config, data=data, out=out, init=None)
    return out


@pytest.fixture
def out(finished: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return shutil.copytree(finished, tmp_path / "out")


# ---------------------------------------------------------------------------------------------------- it learns


def test_two_photos_are_learned_by_heart(make_config: MakeConfig, tmp_path: Path) -> None:
    config = make_config(
        sources=(CALM, dataclasses.replace(CALM, name="outdoor")),
        steps=40,
        ema_decay=None,
        checkpoint_every=1000,
        optim=OptimConfig(learning_rate=5e-3, encoder_factor=1.0, warmup=0.2, initial_division=10, clip=1.0),
    )
    one_of_each = {
        name: write_pairs(tmp_path / name, n=1, size=(64, 64), domain=name) for name in ("indoor", "outdoor")
    }

    last = train_metric(config, data=one_of_each, out=tmp_path / "out", init=None)

    losses = [line["train/silog"] for line in log_of(tmp_path / "out")]
    assert len(losses) == 40
    assert sum(losses[-5:]) < 0.4 * sum(losses[:5])
    routing = [line["train/domain"] for line in log_of(tmp_path / "out")]
    assert routing[-1] < 0.2 < routing[0]
    model = load_model(last)
    for index, path in enumerate(one_of_each.values()):
        sample = PairDataset(path)[0]
        with torch.no_grad():
            output = model(sample.image[None])
        error = (output.depth[0][sample.mask] / sample.target[sample.mask] - 1).abs().mean()
        assert output.domain.item() == index
        assert error < 0.4  # all 0.7 m, as at the start, is 0.7 to 0.98


def weighing(domain_weight: float) -> TrainConfig:
    return TrainConfig("metric", PRESETS["zoed-lite"], (), steps=1, domain_weight=domain_weight)


def test_loss_terms_are_those_of_the_batch() -> None:
    depth = torch.full((2, 1, 4, 4), 2.0)
    target = torch.full((2, 1, 4, 4), 1.0)
    logits = torch.tensor([[0.0, 0.0], [0.0, 0.0]])
    output = DepthOutput(depth, depth, torch.tensor([0, 1]), logits, std=None, bin_centers=None, probability=None)
    batch = Batch(
        torch.zeros(2, 3, 4, 4), target, target > 0, torch.tensor([0, 1]), torch.tensor([0, 0]), ["a", "b"], "depth"
    )

    terms = metric_losses(output, batch, weighing(3.0), ())

    # All pixels are off by ln 2, so the variance is 0: 10 sqrt(0.15) ln 2. Two equal scores: 3 ln 2.
    assert terms["silog"].item() == pytest.approx(10 * 0.15**0.5 * 0.693147, rel=1e-4)
    assert terms["domain"].item() == pytest.approx(3 * 0.693147, rel=1e-5)
    assert set(metric_losses(output, batch, weighing(0.0), ())) == {"silog"}
    assert set(metric_losses(output._replace(domain_logits=None), batch, weighing(3.0), ())) == {"silog"}


def test_terms_of_edges_and_of_doubt_are_weighed_and_leave_scattered_depth_out() -> None:
    depth = torch.tensor([1.0, 1.0, 2.0, 2.0]).expand(2, 1, 4, 4)
    target = torch.ones(2, 1, 4, 4)
    output = DepthOutput(depth, depth, torch.tensor([0, 0]), None, std=depth / 2, bin_centers=None, probability=None)
    batch = Batch(depth, target, target > 0, torch.tensor([0, 0]), torch.tensor([0, 1]), ["a", "b"], "depth")
    sources = (CALM, dataclasses.replace(CALM, name="lidar", gradient_term=False))
    config = dataclasses.replace(weighing(0.0), log_gradient_weight=2.0, spread_weight=3.0)

    terms = metric_losses(output, batch, config, sources)

    # Of 16 pixels 4 have a neighbour to the right that is farther by ln 2. At the second stride the 4 pixels are two
    # pairs off by ln 2; beyond that nothing has a neighbour. The lidar's image does not count.
    assert terms["log_gradient"].item() == pytest.approx(2 * 0.693147 * (4 / 16 + 2 / 4), rel=1e-5)
    # Half of the pixels are right, the others off by 1 m at 2 m. s / d is 1/2 everywhere, and the floor of 0.02.
    ratio = math.hypot(0.5, 0.02)
    assert terms["spread"].item() == pytest.approx(3 * (math.log(ratio) + 0.5 / (2 * ratio)), rel=1e-5)
    assert set(metric_losses(output._replace(std=None), batch, config, sources)) == {"silog", "log_gradient"}


def test_prediction_is_brought_to_the_size_of_each_truth() -> None:
    depth = torch.linspace(1, 4, 16).reshape(1, 1, 4, 4).repeat(2, 1, 1, 1)
    small, large = torch.rand(1, 6, 5) + 1, torch.rand(1, 8, 12) + 1
    samples = [Sample(depth[0], target, target > 0, "depth", "", name) for target, name in ((small, "a"), (large, "b"))]
    batch = collate(samples, domains=("any",))
    assert batch.target.shape == (2, 1, 8, 12)
    output = DepthOutput(depth, depth, torch.tensor([0, 0]), None, std=None, bin_centers=None, probability=None)

    found = metric_losses(output, batch, weighing(0.0), ())["silog"]

    resized = [
        F.interpolate(depth[:1], tuple(target.shape[1:]), mode="bilinear", align_corners=True).flatten()
        for target in (small, large)
    ]
    residual = torch.cat(resized).log() - torch.cat([small.flatten(), large.flatten()]).log()
    assert found.item() == pytest.approx(10 * (residual.var() + 0.15 * residual.mean() ** 2).sqrt().item(), rel=1e-4)
    for i, sample in enumerate(samples):
        assert all(map(torch.equal, batch.truth(i), (sample.target, sample.mask)))


@pytest.mark.parametrize("kind", ["labeled", "auto"])
def test_other_routers_train(
    make_config: MakeConfig, tiny_config: ModelConfig, data: Data, tmp_path: Path, kind: Literal["labeled", "auto"],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    model = dataclasses.replace(tiny_config, router=RouterConfig(kind, width=16))
    config = make_config(model=model, steps=2, route_by_label=kind == "labeled", domain_weight=0.0)
    labels: list[object] = []
    forward = ZoeDepth.forward

    def spy(
        self: ZoeDepth, pixels: torch.Tensor, *, domain: torch.Tensor | None = None, return_std: bool = False
    ) -> DepthOutput:
        labels.append(domain if domain is None else domain.tolist())
        return forward(self, pixels, domain=domain, return_std=return_std)

    monkeypatch.setattr(ZoeDepth, "forward", spy)
    train_metric(config, data=data, out=tmp_path, init=None)
    assert labels == [[0, 1] if kind == "labeled" else None] * 2
    assert [set(line) & {"train/silog", "train/domain"} for line in log_of(tmp_path)] == [{"train/silog"}] * 2


@pytest.mark.parametrize("stage", [metric, relative])
def test_processes_exchange_gradients_once_a_step(
    make_config: MakeConfig, data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: ModuleType
) -> None:
    complete: list[bool] = []
    original = stage.backward

    def spy(*arguments: object, **keywords: bool) -> None:
        complete.append(keywords["complete"])
        original(*arguments, **keywords)

    monkeypatch.setattr(stage, "backward", spy)
    name = "metric" if stage is metric else "relative"
    train = train_metric if stage is metric else train_relative
    train(make_config(name, batch_size=6, accumulate=3, steps=2), data=data, out=tmp_path)
    assert complete == [False, False, True] * 2


def test_model_of_one_domain_trains_on_any_data(
    make_config: MakeConfig, tiny_config: ModelConfig, data: Data, tmp_path: Path
) -> None:
    model = dataclasses.replace(tiny_config, domains=tiny_config.domains[1:])
    last = train_metric(make_config(model=model, steps=1), data=data, out=tmp_path / "out", init=None)
    assert len(load_model(last).heads) == 1


def test_batches_of_one_data_set_each_alternate(
    make_config: MakeConfig, data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read_domains = []
    on_reading(monkeypatch, lambda sample: read_domains.append(sample.domain) or sample)
    train_metric(make_config(mix_by="batch", batch_size=3), data=data, out=tmp_path / "out", init=None)
    assert read_domains == [*["indoor"] * 3, *["outdoor"] * 3] * 2


def test_each_data_set_has_its_own_lines_where_they_alternate(
    make_config: MakeConfig, data: Data, tmp_path: Path
) -> None:
    """Else every second step would always tell of the same one, under a name that says nothing of it."""
    train_metric(make_config(mix_by="batch", steps=5, log_every=2), data=data, out=tmp_path, init=None)
    told = [(line["step"], name) for line in log_of(tmp_path) for name in line if name.startswith("train/silog")]
    assert told == [
        (2, "train/silog/outdoor"), (3, "train/silog/indoor"), (4, "train/silog/outdoor"), (5, "train/silog/indoor"),
    ]  # fmt: skip
    assert "train/domain/indoor" in log_of(tmp_path)[1]


# ---------------------------------------------------------------------------------------------------- the same again


def test_same_seed_gives_the_same_result_in_whichever_order_data_is_given(
    config: TrainConfig, data: Data, finished: Path, tmp_path: Path
) -> None:
    torch.rand(3)  # numbers drawn before do not matter
    again = train_metric(config, data=dict(reversed(data.items())), out=tmp_path, init=None)
    assert_same_checkpoint(finished / "step_000004", again)


def test_resumed_run_equals_the_uninterrupted_one_bit_for_bit(
    config: TrainConfig, data: Data, finished: Path, out: Path
) -> None:
    # As a run that was killed while it wrote its last checkpoint leaves its folder.
    part = out / ".step_000004.part"
    (out / "step_000004").rename(part)
    (part / "train.pt").write_bytes(b"half a file")

    resumed = train_metric(config, data=data, out=out, init=None)

    assert resumed == out / "step_000004"
    assert_same_checkpoint(finished / "step_000004", resumed)
    assert [line["step"] for line in log_of(out)] == [1, 2, 3, 4]
    assert not part.exists()


@pytest.mark.parametrize("after", [1, 3])
def test_interrupted_run_keeps_its_checkpoints_and_goes_on(
    config: TrainConfig, data: Data, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    n_read = 0

    def interrupt(sample: Sample) -> Sample:
        nonlocal n_read
        n_read += 1
        if n_read > after * config.batch_size:
            raise KeyboardInterrupt
        return sample

    with monkeypatch.context() as patch:
        on_reading(patch, interrupt)
        with pytest.raises(KeyboardInterrupt):
            train_metric(config, data=data, out=tmp_path, init=None)
    assert [path.name for path in checkpoints(tmp_path)] == ([] if after == 1 else ["step_000002"])
    assert [line["step"] for line in log_of(tmp_path)] == list(range(1, after + 1))

    resumed = train_metric(config, data=data, out=tmp_path, init=None)
    assert_same_checkpoint(finished / "step_000004", resumed)
    assert [line["step"] for line in log_of(tmp_path)] == [1, 2, 3, 4]


def test_signal_finishes_the_step_and_writes_a_checkpoint_from_which_the_run_goes_on(
    config: TrainConfig, data: Data, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = dataclasses.replace(config, checkpoint_every=100)
    n_read = 0

    def interrupt(sample: Sample) -> Sample:
        nonlocal n_read
        n_read += 1
        if n_read == config.batch_size + 1:  # the first sample of step 2
            signal.raise_signal(signal.SIGTERM)
        return sample

    before = signal.getsignal(signal.SIGTERM)
    with monkeypatch.context() as patch:
        on_reading(patch, interrupt)
        with pytest.raises(KeyboardInterrupt, match="step 2 is saved"):
            train_metric(config, data=data, out=tmp_path)
    assert signal.getsignal(signal.SIGTERM) is before
    assert [path.name for path in checkpoints(tmp_path)] == ["step_000002"]
    resumed = train_metric(config, data=data, out=tmp_path)
    whole = weights_of(finished / "step_000004")
    assert all(torch.equal(value, whole[name]) for name, value in weights_of(resumed).items())


def test_finished_run_is_left_as_it_is(config: TrainConfig, data: Data, out: Path) -> None:
    last = out / "step_000004"
    before = (last / "train.pt").read_bytes()
    assert train_metric(config, data=data, out=out, init=None) == last
    assert (last / "train.pt").read_bytes() == before
    assert [line["step"] for line in log_of(out)] == [1, 2, 3, 4]


def test_line_of_the_log_that_was_cut_off_does_not_hinder_resuming(config: TrainConfig, data: Data, out: Path) -> None:
    with (out / "log.jsonl").open("a") as file:
        file.write('{"step": 5, "train/si')
    train_metric(config, data=data, out=out, init=None)
    assert [line["step"] for line in log_of(out)] == [1, 2, 3, 4]


def test_run_of_another_configuration_is_refused_and_the_field_named(
    config: TrainConfig, data: Data, out: Path
) -> None:
    before = (out / "step_000004" / "train.pt").read_bytes()
    with pytest.raises(InputError, match="batch_size"):
        train_metric(dataclasses.replace(config, batch_size=4), data=data, out=out, init=None)
    assert (out / "step_000004" / "train.pt").read_bytes() == before


# ---------------------------------------------------------------------------------------------------- what is saved


def test_result_is_the_moving_average_and_loads_like_any_model(config: TrainConfig, finished: Path) -> None:
    model = load_model(finished / "step_000004")
    saved = torch.load(finished / "step_000004" / "train.pt", weights_only=True)

    assert model.config == config.model
    result = dict(model.state_dict())
    for name, value in result.items():
        assert torch.equal(value, saved["ema"][f"module.{name}"]), name
    assert any(not torch.equal(value, saved["model"][name]) for name, value in result.items())


def test_log_has_every_part_of_the_loss_and_the_norm_of_the_gradients(finished: Path) -> None:
    for line in log_of(finished):
        assert {name for name in line if name.startswith("train/")} == {
            "train/silog", "train/domain", "train/gradient_norm",
        }  # fmt: skip
        assert line["train/gradient_norm"] > 0


def test_held_out_photos_are_validated_not_trained_on(
    make_config: MakeConfig, data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names: list[str] = []
    on_reading(monkeypatch, lambda sample: names.append(Path(sample.name).name) or sample)
    config = make_config(steps=3, batch_size=4, holdout=1, validate_every=2)
    train_metric(config, data=data, out=tmp_path, init=None)

    lines = [line for line in log_of(tmp_path) if "validation/indoor/rel" in line]
    assert [line["step"] for line in lines] == [2, 3]
    expected = {f"validation/{name}/{metric}" for name in data for metric in ("rel", "rmse", "delta1", "router")}
    assert all({key for key in line if key.startswith("validation/")} == expected for line in lines)
    # Read were steps 1 and 2, a validation, step 3, a validation.
    held_out = ["train_003.jpg", "train_001.jpg"]  # the last indoor and the last outdoor one
    assert names[8:10] == held_out
    assert names[14:] == held_out
    trained = names[:8] + names[10:14]
    # Indoor and outdoor take turns.
    assert set(trained[0::2]) == {"train_000.jpg", "train_001.jpg", "train_002.jpg"}
    assert set(trained[1::2]) == {"train_000.jpg"}


def test_loss_that_is_not_finite_stops_with_the_photos_named_and_checkpoints_intact(
    config: TrainConfig, data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names: list[str] = []

    def spoil(sample: Sample) -> Sample:
        names.append(sample.name)
        fourth_step = len(names) > 3 * config.batch_size
        return dataclasses.replace(sample, image=sample.image * float("nan")) if fourth_step else sample

    on_reading(monkeypatch, spoil)
    with pytest.raises(TrainingError, match="step 4") as raised:
        train_metric(config, data=data, out=tmp_path, init=None)

    assert all(name in str(raised.value) for name in names[6:8])
    (kept,) = checkpoints(tmp_path)
    assert kept.name == "step_000002"
    assert all(value.isfinite().all() for value in load_model(kept).state_dict().values())


def test_depth_that_is_not_a_number_is_unknown(
    make_config: MakeConfig, data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def spoil(sample: Sample) -> Sample:
        target = sample.target.clone()
        target[0, ::2] = float("nan")
        return dataclasses.replace(sample, target=target)

    on_reading(monkeypatch, spoil)
    last = train_metric(make_config(steps=2), data=data, out=tmp_path, init=None)
    assert all(value.isfinite().all() for value in load_model(last).state_dict().values())


def test_photos_without_any_depth_leave_a_finite_model(make_config: MakeConfig, tmp_path: Path) -> None:
    empty = write_pairs(tmp_path / "empty", n=3, without_truth=(0, 1, 2))
    last = train_metric(make_config(steps=2, holdout=1), data={"indoor": empty}, out=tmp_path / "out", init=None)
    assert [line["train/silog"] for line in log_of(tmp_path / "out") if "train/silog" in line] == [0, 0]
    assert all(value.isfinite().all() for value in load_model(last).state_dict().values())


# ---------------------------------------------------------------------------------------------------- what is frozen


@pytest.fixture(scope="module")
def lite_config(tiny_config: ModelConfig) -> ModelConfig:
    """timm's smallest EfficientNet, which has batch norms, under the tiny decoder and heads."""
    encoder = EncoderConfig(ENCODER, "convolutional", size=(224, 224))
    return dataclasses.replace(tiny_config, encoder=encoder)


@pytest.mark.parametrize("frozen", [True, False])
def test_batch_norm_statistics_stay_where_they_are_frozen(
    make_config: MakeConfig, lite_config: ModelConfig, data: Data, tmp_path: Path, frozen: bool
) -> None:
    torch.manual_seed(5)
    start = ZoeDepth(lite_config)
    save_model(start, tmp_path / "start.safetensors")
    config = make_config(model=lite_config, steps=2, freeze_batch_norm=frozen, ema_decay=None)

    last = train_metric(config, data=data, out=tmp_path / "out", init=str(tmp_path / "start.safetensors"))

    before, after = start.state_dict(), load_model(last).state_dict()
    statistics = [name for name in before if "running_" in name]
    assert len(statistics) > 20
    assert all(torch.equal(before[name], after[name]) for name in statistics) == frozen
    assert any(not torch.equal(before[n], after[n]) for n, _ in start.encoder.named_parameters(prefix="encoder"))


def test_frozen_encoder_stays_while_the_rest_learns(make_config: MakeConfig, data: Data, tmp_path: Path) -> None:
    optim = OptimConfig(learning_rate=1e-3, encoder_factor=0.0, position_factor=0.0, warmup=0.3)
    config = make_config(steps=2, optim=optim, ema_decay=None)
    torch.manual_seed(5)
    start = ZoeDepth(config.model)
    save_model(start, tmp_path / "start.safetensors")

    last = train_metric(config, data=data, out=tmp_path / "out", init=str(tmp_path / "start.safetensors"))

    model = load_model(last)
    for name, value in start.encoder.state_dict().items():
        assert torch.equal(value, model.encoder.state_dict()[name]), name
    for part in ("decoder", "heads", "router"):
        before, after = getattr(start, part).state_dict(), getattr(model, part).state_dict()
        assert any(not torch.equal(before[name], after[name]) for name in before), part


def test_places_of_photos_of_several_sizes_are_those_of_each() -> None:
    """The targets of a batch are padded to one size; losses that look at places see each fill its map."""
    target, mask = torch.zeros(2, 1, 4, 4), torch.zeros(2, 1, 4, 4, dtype=torch.bool)
    target[0, 0, :2] = torch.tensor([[1.0, 2, 3, 4], [5, 6, 7, 8]])
    mask[0, 0, :2] = True
    target[1], mask[1] = 9, True
    sizes, zeros = torch.tensor([[2, 4], [4, 4]]), torch.zeros(2, dtype=torch.long)
    batch = Batch(torch.zeros(2, 3, 4, 4), target, mask, zeros, zeros, ["a", "b"], "depth", sizes)
    found, known = filling(batch)
    assert found[0, 0].tolist() == [[1, 2, 3, 4]] * 2 + [[5, 6, 7, 8]] * 2
    assert known.all()
    assert (found[1] == 9).all()
    assert filling(batch._replace(sizes=None))[0] is target
