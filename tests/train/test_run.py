"""A run: built from nothing or from its last checkpoint, with all parts that the stages train with."""

import json
import os
import signal
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tests.folders import write_pairs
from tests.train.runs import assert_same_checkpoint, weights_of

from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.train import metric
from zoedepth.train import run as module
from zoedepth.train.config import TrainConfig
from zoedepth.train.identity import start_state
from zoedepth.train.metric import train_metric
from zoedepth.train.processes import launch_fabric
from zoedepth.train.relative import RelativeModel
from zoedepth.train.report import report
from zoedepth.train.run import Run, last_checkpoint, set_up
from zoedepth.train.state import checkpoints
from zoedepth.weights.save import save_model

StartRun = Callable[..., Run]
Data = dict[str, Path]


def test_a_new_run_starts_at_the_first_step_with_weights_of_its_seed(
    start_run: StartRun, data: Data, capsys: pytest.CaptureFixture[str]
) -> None:
    torch.rand(3)  # numbers drawn before do not matter
    run, same, other = start_run(), start_run(), start_run(seed=4)
    assert "metric from random weights: steps 0 to 4, 6 images" in capsys.readouterr().err
    assert run.state.step == 0
    assert [source.name for source in run.sources] == ["indoor", "outdoor"]
    assert run.validation == {}
    assert run.identity["data"] == {name: str(path) for name, path in data.items()}
    assert run.identity["init"] == [None, None]
    weights = [each.state.model.state_dict() for each in (run, same, other)]
    assert all(torch.equal(value, weights[1][name]) for name, value in weights[0].items())
    assert any(not torch.equal(value, weights[2][name]) for name, value in weights[0].items())


def test_a_run_with_checkpoints_goes_on_from_the_newest(
    start_run: StartRun, capsys: pytest.CaptureFixture[str]
) -> None:
    first = start_run()
    for step in (1, 2):
        first.state.step = step
        with torch.no_grad():
            first.state.model.encoder.network.cls_token.fill_(step)
        first.state.save(first.out, first.config, first.identity)
    names = [batch.names for batch in first.batches]
    capsys.readouterr()
    run = start_run()
    assert run.state.step == 2
    assert (run.state.model.encoder.network.cls_token == 2).all()
    assert [batch.names for batch in run.batches] == names[2:]
    assert "metric from step_000002 of" in capsys.readouterr().err
    assert last_checkpoint(run) == run.out / "step_000002"


def test_another_precision_of_another_machine_is_said(start_run: StartRun, capsys: pytest.CaptureFixture[str]) -> None:
    first = start_run(precision="32-true")
    first.state.step = 1
    saved = first.state.save(first.out, first.config, first.identity)
    start_run(precision="32-true")
    assert "was the precision" not in capsys.readouterr().err
    meta = json.loads((saved / "meta.json").read_text())
    assert meta["precision"] == "32-true"
    (saved / "meta.json").write_text(json.dumps({**meta, "precision": "bf16-mixed"}))  # as of another machine
    start_run(precision="32-true")
    assert "warning: bf16-mixed was the precision until here, and this machine takes 32-true" in " ".join(
        capsys.readouterr().err.split()
    )


def test_a_run_on_other_data_is_refused(start_run: StartRun, data: Data) -> None:
    first = start_run(data={"indoor": data["indoor"]})
    first.state.save(first.out, first.config, first.identity)
    with pytest.raises(InputError, match=r"\['data', 'data_state'\] differ"):
        start_run(data={"indoor": data["outdoor"]})


def test_one_command_at_a_time_trains_in_a_folder(
    make_config: Callable[..., TrainConfig], data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"

    def begin(seed: int) -> AbstractContextManager[Run]:
        config = make_config(seed=seed)
        fabric = launch_fabric(config, devices=1, n_nodes=1)
        return set_up(config, fabric, part=lambda model: model, data=data, out=out, init=None)

    with begin(1), pytest.raises(InputError, match=r"another command trains in .*run .*choose another --out"), begin(2):
        pass
    with begin(1):  # it has ended
        pass
    looked = module.load_sources

    def meanwhile(*given: Any, **options: Any) -> Any:
        monkeypatch.undo()
        with begin(1) as other:
            other.state.save(out, other.config, other.identity)
        return looked(*given, **options)

    monkeypatch.setattr(module, "load_sources", meanwhile)
    with pytest.raises(InputError, match=r"has trained in .* in the meantime: type this one again"), begin(2):
        pass


def test_the_slash_that_a_shell_adds_is_no_other_data(start_run: StartRun, tmp_path: Path) -> None:
    folder = write_pairs(tmp_path / "indoor", n=2).parent
    first = start_run(data={"indoor": str(folder)})
    first.state.save(first.out, first.config, first.identity)
    start_run(data={"indoor": f"{folder}/"})


def test_weights_that_come_while_a_run_begins_are_not_those_it_began_with(
    start_run: StartRun, tiny_model: ZoeDepth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "before"

    def write(step: int) -> None:
        (folder / f"step_{step:06d}").mkdir(parents=True)
        save_model(tiny_model, folder / f"step_{step:06d}" / "model.safetensors")

    write(1)
    known = start_state(str(folder))
    looked = module.load_sources

    def meanwhile(*given: Any, **options: Any) -> Any:
        with torch.no_grad():
            next(tiny_model.parameters()).add_(1)
        write(2)
        return looked(*given, **options)

    monkeypatch.setattr(module, "load_sources", meanwhile)
    assert start_run(init=str(folder)).identity["init"] == known != start_state(str(folder))


def test_a_checkpoint_without_weights_is_damaged(start_run: StartRun) -> None:
    first = start_run()
    first.state.save(first.out, first.config, first.identity)
    (checkpoints(first.out)[-1] / "model.safetensors").unlink()
    with pytest.raises(InputError, match=r"cannot resume from .*step_000000, it is damaged.*Remove it"):
        start_run()


def test_a_run_whose_data_or_starting_weights_have_changed_is_refused(
    start_run: StartRun, tiny_model: ZoeDepth, tmp_path: Path
) -> None:
    indoor, init = write_pairs(tmp_path / "indoor", n=2), tmp_path / "init.safetensors"
    save_model(tiny_model, init)
    first = start_run(data={"indoor": indoor}, init=str(init))
    first.state.save(first.out, first.config, first.identity)
    start_run(data={"indoor": indoor}, init=str(init))
    depth = indoor.parent / "depth/train_001.png"
    content, times = depth.read_bytes(), (depth.stat().st_atime_ns, depth.stat().st_mtime_ns)
    depth.write_bytes(content + b"\0")
    with pytest.raises(InputError, match=r"\['data_state'\] differ .* Files of the data"):
        start_run(data={"indoor": indoor}, init=str(init))
    depth.write_bytes(content)
    os.utime(depth, ns=times)
    start_run(data={"indoor": indoor}, init=str(init))
    with torch.no_grad():
        next(tiny_model.parameters()).add_(1)
    save_model(tiny_model, init)
    with pytest.raises(InputError, match=r"\['init'\] differ .* other starting weights"):
        start_run(data={"indoor": indoor}, init=str(init))
    init.unlink()  # weights that are gone by now are known by their name
    start_run(data={"indoor": indoor}, init=str(init))


def test_an_error_that_nobody_foresaw_saves_the_last_step(
    make_config: Callable[..., TrainConfig], data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It does so in the middle of a step, and what goes on from there equals a run that never failed."""
    config = make_config(checkpoint_every=100)
    whole = train_metric(config, data=data, out=tmp_path / "whole", init=None)
    losses = metric.metric_losses

    def fail(*arguments: object) -> dict[str, torch.Tensor]:
        if (tmp_path / "armed").exists():
            torch.rand(7)
            raise ZeroDivisionError
        return losses(*arguments)

    monkeypatch.setattr(metric, "metric_losses", fail)
    monkeypatch.setattr(
        "zoedepth.train.metric.report", lambda run, *rest: (tmp_path / "armed").touch() or report(run, *rest)
    )
    with pytest.raises(ZeroDivisionError):
        train_metric(config, data=data, out=tmp_path / "out", init=None)
    assert [path.name for path in checkpoints(tmp_path / "out")] == ["step_000001"]
    monkeypatch.undo()
    assert_same_checkpoint(whole, train_metric(config, data=data, out=tmp_path / "out", init=None))


def test_broken_samples_are_skipped_and_named_whenever_they_are_found(
    make_config: Callable[..., TrainConfig], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """A run that met the damage on its way, and was interrupted, equals one that had looked at all files before."""
    rooms = write_pairs(tmp_path / "rooms", n=6, size=(64, 64))
    photo = rooms.parent / "image/train_003.jpg"
    photo.write_bytes(photo.read_bytes()[:400])
    config = make_config(steps=5, holdout=1, validate_every=100)
    looked = train_metric(config, data={"indoor": rooms}, out=tmp_path / "looked", init=None)
    assert f"skipped: {photo}" in capsys.readouterr().err.replace("\n", "")
    blind = replace(config, check="off")
    monkeypatch.setattr(metric, "report", lambda run, *rest: report(run, *rest) if run.state.step != 3 else 1 / 0)
    with pytest.raises(ZeroDivisionError):
        train_metric(blind, data={"indoor": rooms}, out=tmp_path / "blind", init=None)
    monkeypatch.undo()
    met = train_metric(replace(blind, n_workers=1), data={"indoor": rooms}, out=tmp_path / "blind", init=None)
    assert f"skipped: {photo}" in capsys.readouterr().err.replace("\n", "")
    first, second = weights_of(looked), weights_of(met)
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert (looked / "model.safetensors").read_bytes() == (met / "model.safetensors").read_bytes()


def test_too_many_broken_samples_end_the_run_with_its_last_step_saved(
    make_config: Callable[..., TrainConfig], tmp_path: Path
) -> None:
    rooms = write_pairs(tmp_path / "rooms", n=6, size=(64, 64))
    for index in (0, 1, 2):
        (rooms.parent / f"image/train_{index:03d}.jpg").write_bytes(b"")
    config = make_config(steps=5, batch_size=6)
    with pytest.raises(InputError, match=r"3 of 6 pairs of \S*train\.csv cannot be read"):
        train_metric(config, data={"indoor": rooms}, out=tmp_path / "looked", init=None)
    assert not (tmp_path / "looked").exists()
    with pytest.raises(InputError, match="3 of 6 pairs of indoor cannot be read"):
        train_metric(replace(config, check="off"), data={"indoor": rooms}, out=tmp_path / "blind", init=None)
    assert [path.name for path in checkpoints(tmp_path / "blind")] == ["step_000001"]


def test_no_checkpoint_of_a_half_changed_model_and_none_twice(start_run: StartRun) -> None:
    run = start_run()
    with pytest.raises(ZeroDivisionError), run.state.changing():
        raise ZeroDivisionError
    assert not run.state.go_back()


def test_checkpointed_gradients_compute_the_encoder_twice_and_are_the_same(start_run: StartRun) -> None:
    calls, found = [], []
    for checkpointing in (False, True):
        run = start_run(gradient_checkpointing=checkpointing)
        n = 0

        def count(*_: object) -> None:
            nonlocal n
            n += 1

        run.state.model.encoder.network.blocks[0].register_forward_pre_hook(count)
        batch = next(run.batches)
        run.fabric.backward(run.network(batch.pixels, domain=batch.domain).depth.mean())
        calls.append(n)
        found.append([parameter.grad for parameter in run.network.parameters()])
    assert calls == [1, 2]
    for first, second in zip(*found, strict=True):
        torch.testing.assert_close(second, first)


def test_only_the_trained_part_is_given_to_the_optimizer(
    make_config: Callable[..., TrainConfig], data: Data, tmp_path: Path
) -> None:
    config = make_config("relative", holdout=1)
    fabric = launch_fabric(config, devices=1, n_nodes=1)
    with set_up(config, fabric, part=RelativeModel, data=data, out=tmp_path, init=None) as run:
        model = run.state.model
        given = {id(p) for group in run.state.optimizer.param_groups for p in group["params"]}
        assert given == {id(p) for part in (model.encoder, model.decoder) for p in part.parameters()}
        assert {name: len(held_out) for name, held_out in run.validation.items()} == {"indoor": 1, "outdoor": 1}


def test_batches_are_closed_and_signals_put_back_in_the_end(
    make_config: Callable[..., TrainConfig], data: Data, tmp_path: Path
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    config = make_config()
    fabric = launch_fabric(config, devices=1, n_nodes=1)
    runs = []

    def fail() -> None:
        with set_up(config, fabric, part=lambda model: model, data=data, out=tmp_path, init=None) as run:
            runs.append(run)
            assert signal.getsignal(signal.SIGTERM) is not before
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert list(runs[0].batches) == []
    assert signal.getsignal(signal.SIGTERM) is before
