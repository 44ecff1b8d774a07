"""Checkpoints: whole or absent, the newest two, refused where they are damaged or of another configuration."""

import dataclasses
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.train import state as module
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig
from zoedepth.train.optim import build_optimizer
from zoedepth.train.state import TrainState, averaged, checkpoints
from zoedepth.weights.load import load_model

MakeConfig = Callable[..., TrainConfig]


def make_state(config: TrainConfig, *, seed: int = 0) -> TrainState:
    torch.manual_seed(seed)
    model = ZoeDepth(config.model)
    return TrainState(model, build_optimizer(model, config.optim), averaged(model, config.ema_decay))


def take_step(state: TrainState, *, seed: int = 1) -> None:
    """One optimizer step on random gradients."""
    generator = torch.Generator().manual_seed(seed + state.step)
    for parameter in state.model.parameters():
        parameter.grad = torch.randn(parameter.shape, generator=generator)
    state.optimizer.step()
    if state.ema is not None:
        state.ema.update_parameters(state.model)
    state.step += 1


def assert_equal(first: Any, second: Any) -> None:
    """Nested dicts and lists of tensors and numbers are the same, bit for bit."""
    assert type(first) is type(second)
    if isinstance(first, dict):
        assert first.keys() == second.keys()
        for key in first:
            assert_equal(first[key], second[key])
    elif isinstance(first, list | tuple):
        assert len(first) == len(second)
        for a, b in zip(first, second, strict=True):
            assert_equal(a, b)
    elif isinstance(first, torch.Tensor):
        assert torch.equal(first, second)
    else:
        assert first == second


@pytest.fixture(scope="module")
def config(make_config: MakeConfig) -> TrainConfig:
    return make_config()


@pytest.fixture(scope="module")
def saved_once(config: TrainConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint for tests that only read it."""
    return make_state(config).save(tmp_path_factory.mktemp("run"), config)


@pytest.fixture
def saved(saved_once: Path, tmp_path: Path) -> Path:
    """A checkpoint to damage."""
    return shutil.copytree(saved_once, tmp_path / saved_once.name)


@pytest.fixture(scope="module")
def any_state(config: TrainConfig) -> TrainState:
    """For tests in which nothing is loaded into it."""
    return make_state(config)


def test_loaded_state_is_the_saved_one_bit_for_bit(config: TrainConfig, tmp_path: Path) -> None:
    saved = make_state(config)
    for _ in range(3):
        take_step(saved)
    saved.task_weights = torch.tensor([0.25, 0.75])
    torch.manual_seed(77)
    torch.rand(5)
    folder = saved.save(tmp_path, config)
    drawn = torch.rand(4)

    loaded = make_state(config, seed=9)
    loaded.load(folder, config)

    assert torch.equal(torch.rand(4), drawn)
    assert loaded.step == 3
    assert_equal(loaded.task_weights, saved.task_weights)
    assert_equal(loaded.model.state_dict(), saved.model.state_dict())
    assert_equal(loaded.optimizer.state_dict(), saved.optimizer.state_dict())
    assert loaded.ema is not None
    assert saved.ema is not None
    assert_equal(loaded.ema.state_dict(), saved.ema.state_dict())
    take_step(saved)
    take_step(loaded)
    assert_equal(loaded.model.state_dict(), saved.model.state_dict())
    assert_equal(loaded.ema.state_dict(), saved.ema.state_dict())


class _Scaling:
    """A precision with a state, as float16's is."""

    def __init__(self, scale: float) -> None:
        self.scale = scale

    def state_dict(self) -> dict[str, float]:
        return {"scale": self.scale}

    def load_state_dict(self, values: dict[str, float]) -> None:
        self.scale = values["scale"]


def test_the_factor_of_the_loss_goes_on_where_it_was(config: TrainConfig, saved_once: Path, tmp_path: Path) -> None:
    state = make_state(config)
    state.precision = _Scaling(512.0)
    folder = state.save(tmp_path, config)
    state.precision = _Scaling(65536.0)
    state.load(folder, config)
    assert state.precision.scale == 512
    state.load(saved_once, config)  # of a precision without a state
    assert state.precision.scale == 512


def test_weights_of_the_data_sets_go_to_the_device_of_the_model(
    config: TrainConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = make_state(config)
    state.task_weights = torch.tensor([0.25, 0.75])
    folder = state.save(tmp_path, config)
    # The device that every machine has besides the processor.
    monkeypatch.setattr(module, "_device", lambda model: torch.device("meta"))
    state.load(folder, config)
    assert state.task_weights.device.type == "meta"


def test_average_follows_with_its_decay(config: TrainConfig) -> None:
    state = make_state(config)
    expected = None
    for _ in range(3):
        take_step(state)
        weight = state.model.encoder.network.cls_token.detach().clone()
        # The first step is taken as it is.
        expected = weight if expected is None else 0.9 * expected + 0.1 * weight
    torch.testing.assert_close(state.result.encoder.network.cls_token.detach(), expected)


def test_average_follows_the_statistics_of_batch_norms_too() -> None:
    norm = torch.nn.BatchNorm1d(1, momentum=1.0)
    average = averaged(norm, 0.75)
    assert average is not None
    for mean in (4.0, 8.0):  # the first is taken as it is
        norm(torch.tensor([[mean - 1], [mean + 1]]))
        average.update_parameters(norm)
    assert average.module.running_mean.item() == 0.75 * 4 + 0.25 * 8


def test_result_is_the_average_where_there_is_one(make_config: MakeConfig) -> None:
    with_average, without = make_state(make_config()), make_state(make_config(ema_decay=None))
    assert with_average.result is not with_average.model
    assert without.result is without.model


@pytest.mark.parametrize("ema_decay", [None, 0.9])
def test_model_file_of_a_checkpoint_is_the_result_for_load_model(
    make_config: MakeConfig, tmp_path: Path, ema_decay: float | None
) -> None:
    config = make_config(ema_decay=ema_decay)
    state = make_state(config)
    for _ in range(2):
        take_step(state)
    folder = state.save(tmp_path, config)

    for source in (folder, folder / "model.safetensors"):
        model = load_model(source)
        assert model.config == config.model
        assert not model.training
        assert_equal(dict(model.state_dict()), dict(state.result.state_dict()))
    same = torch.equal(model.encoder.network.cls_token, state.model.encoder.network.cls_token)
    assert same == (ema_decay is None)


def test_folder_holds_the_newest_two_oldest_first(config: TrainConfig, tmp_path: Path) -> None:
    state = make_state(config)
    for _ in range(4):
        take_step(state)
        state.save(tmp_path, config)
    assert [path.name for path in checkpoints(tmp_path)] == ["step_000003", "step_000004"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["step_000003", "step_000004"]


def test_checkpoints_are_in_the_order_of_their_steps_however_many(config: TrainConfig, tmp_path: Path) -> None:
    state = make_state(config)
    for step in (999_998, 999_999, 1_000_000):
        state.step = step
        newest = state.save(tmp_path, config)
    assert checkpoints(tmp_path)[-1] == newest
    assert len(checkpoints(tmp_path)) == 2


def test_saving_a_step_again_replaces_it(config: TrainConfig, tmp_path: Path) -> None:
    state = make_state(config)
    state.save(tmp_path, config)
    with torch.no_grad():
        state.result.encoder.network.cls_token.fill_(3.0)
    folder = state.save(tmp_path, config)
    assert checkpoints(tmp_path) == [folder]
    assert (load_model(folder).encoder.network.cls_token == 3).all()


def test_half_written_checkpoint_does_not_count_and_is_no_hindrance(config: TrainConfig, tmp_path: Path) -> None:
    state = make_state(config)
    folder = state.save(tmp_path, config)
    take_step(state)
    part = tmp_path / ".step_000001.part"
    part.mkdir()
    (part / "train.pt").write_bytes(b"half")
    (part / "stale").write_bytes(b"of an older run")
    (tmp_path / "step_000009").mkdir()

    assert checkpoints(tmp_path) == [folder]
    newest = state.save(tmp_path, config)
    assert checkpoints(tmp_path) == [folder, newest]
    assert sorted(path.name for path in newest.iterdir()) == ["meta.json", "model.safetensors", "train.pt"]
    assert not part.exists()


def test_folder_that_is_not_there_has_no_checkpoints(tmp_path: Path) -> None:
    assert checkpoints(tmp_path / "nowhere") == []


def test_failed_save_leaves_the_checkpoints_as_they_were(config: TrainConfig, tmp_path: Path) -> None:
    state = make_state(config)
    folder = state.save(tmp_path, config)
    take_step(state)
    # What cannot be pickled cannot be saved: the write stops half way.
    state.optimizer.param_groups[0]["callback"] = lambda: None
    with pytest.raises(Exception, match="pickle"):  # AttributeError or PicklingError, by the version of Python
        state.save(tmp_path, config)
    assert checkpoints(tmp_path) == [folder]
    make_state(config).load(folder, config)


def test_files_are_on_the_disk_before_the_checkpoint_has_its_name(
    config: TrainConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or a power cut could leave a whole name with half of its files."""
    done: list[str] = []
    sync, rename = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda file: done.append("sync") or sync(file))
    monkeypatch.setattr(os, "replace", lambda old, new: done.append(Path(new).name) or rename(old, new))
    make_state(config).save(tmp_path, config)
    assert done[-1] == "step_000000"
    assert done[-4:-1] == ["sync"] * 3


HARMLESS = {
    "n_workers": 5,
    "log_every": 7,
    "validate_every": 7,
    "keep_checkpoints": 5,
    "pictures": 5,
    "checkpoint_every": 7,
    "check": "off",
}


def other_values(config: TrainConfig) -> dict[str, object]:
    """Another value for each field of TrainConfig that decides what is computed."""
    model = dataclasses.replace(config.model, antialias=not config.model.antialias)
    return {
        "stage": "relative",
        "model": model,
        "sources": (SourceConfig("indoor", weight=2), *config.sources[1:]),
        "steps": config.steps + 1,
        "batch_size": config.batch_size + 1,
        "optim": dataclasses.replace(config.optim, weight_decay=0.5),
        "mix_by": "batch",
        "accumulate": config.batch_size,
        "task_weights": "pareto",
        "pareto_every": 5,
        "pareto_parameters": "all",
        "pareto_normalizer": "loss+",
        "gradient_checkpointing": True,
        "domain_weight": 2.0,
        "chamfer_weight": 2.0,
        "window_chamfer_weight": 2.0,
        "log_gradient_weight": 2.0,
        "spread_weight": 2.0,
        "route_by_label": False,
        "trim": 0.5,
        "loss_size": "truth",
        "gradient_weight": 0.0,
        "freeze_batch_norm": False,
        "ema_decay": 0.5,
        "precision": "bf16-mixed",
        "holdout": 1,
        "holdouts": (1, 2, 3),
        "seed": 1,
    }


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(TrainConfig)])
def test_every_field_but_the_harmless_must_agree_and_is_named(
    config: TrainConfig, saved_once: Path, any_state: TrainState, name: str
) -> None:
    if name in HARMLESS:
        any_state.load(saved_once, dataclasses.replace(config, **{name: HARMLESS[name]}))
        return
    # KeyError: a new field needs another value above.
    changed = dataclasses.replace(config, **{name: other_values(config)[name]})
    with pytest.raises(InputError, match=rf"\['{name}'\]"):
        any_state.load(saved_once, changed)


def test_other_data_is_another_run(
    config: TrainConfig, saved_once: Path, any_state: TrainState, tmp_path: Path
) -> None:
    folder = any_state.save(tmp_path, config, {"data": {"indoor": "nyu"}})
    any_state.load(folder, config, {"data": {"indoor": "nyu"}})
    with pytest.raises(InputError, match=r"\['data'\] differ"):
        any_state.load(folder, config, {"data": {"indoor": "kitchen"}})
    any_state.load(saved_once, config, {"data": {"indoor": "nyu"}})  # from before it was written down


@pytest.mark.parametrize("file", ["meta.json", "train.pt"])
@pytest.mark.parametrize("damage", ["missing", "empty", "truncated", "garbage"])
def test_damaged_checkpoint_is_an_error_that_names_it(
    config: TrainConfig, saved: Path, any_state: TrainState, file: str, damage: str
) -> None:
    path = saved / file
    content = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes({"empty": b"", "truncated": content[: len(content) // 2], "garbage": b"no checkpoint"}[damage])
    with pytest.raises(InputError, match="step_000000"):
        any_state.load(saved, config)


def test_checkpoint_with_a_field_of_another_version_is_an_error_that_names_both(
    config: TrainConfig, saved: Path, any_state: TrainState
) -> None:
    path = saved / "meta.json"
    path.write_text(path.read_text().replace('"trim"', '"trimmed"'))
    with pytest.raises(InputError, match="trimmed") as raised:
        any_state.load(saved, config)
    assert "step_000000" in str(raised.value)


def test_state_of_another_model_in_a_checkpoint_is_an_error_that_names_it(
    config: TrainConfig, tiny_config: ModelConfig, saved: Path, tmp_path: Path
) -> None:
    one_domain = dataclasses.replace(config, model=dataclasses.replace(tiny_config, domains=tiny_config.domains[:1]))
    other = make_state(one_domain).save(tmp_path / "other", one_domain)
    shutil.copy(other / "train.pt", saved / "train.pt")
    with pytest.raises(InputError, match="step_000000"):
        make_state(config).load(saved, config)


def test_checkpoint_never_runs_code(config: TrainConfig, saved: Path, any_state: TrainState, tmp_path: Path) -> None:
    torch.save({"model": Executes(str(tmp_path / "executed"))}, saved / "train.pt")
    with pytest.raises(InputError, match="step_000000"):
        any_state.load(saved, config)
    assert not (tmp_path / "executed").exists()


class Executes:
    """Creates a file when it is unpickled."""

    def __init__(self, path: str) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path(self.path),)


def test_rates_of_a_group_are_saved_with_it(make_config: MakeConfig, tmp_path: Path) -> None:
    config = make_config(optim=OptimConfig(encoder_factor=0.5))
    folder = make_state(config).save(tmp_path, config)
    loaded = make_state(config)
    loaded.load(folder, config)
    assert {group["name"]: group["factor"] for group in loaded.optimizer.param_groups}["encoder"] == 0.5


def test_copies_of_checkpoints_under_other_names_are_none(make_config: MakeConfig, tmp_path: Path) -> None:
    config = make_config()
    state = make_state(config)
    folder = state.save(tmp_path, config)
    for name in (f"{folder.name}_best", f"{folder.name}_1", "step_"):
        shutil.copytree(folder, tmp_path / name)
    assert checkpoints(tmp_path) == [folder]
    take_step(state)
    newest = state.save(tmp_path, config)
    assert checkpoints(tmp_path) == [folder, newest]
