"""A run: built from nothing or from its last checkpoint, with all parts that the stages train with."""

import signal
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from zoedepth.errors import InputError
from zoedepth.train.config import TrainConfig
from zoedepth.train.processes import launch_fabric
from zoedepth.train.relative import RelativeModel
from zoedepth.train.run import Run, last_checkpoint, set_up

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
    assert run.identity == {"data": {name: str(path) for name, path in data.items()}}
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
    run = start_run(init="not read when resuming")
    assert run.state.step == 2
    assert (run.state.model.encoder.network.cls_token == 2).all()
    assert [batch.names for batch in run.batches] == names[2:]
    assert "metric from step_000002 of" in capsys.readouterr().err
    assert last_checkpoint(run) == run.out / "step_000002"


def test_a_run_on_other_data_is_refused(start_run: StartRun, data: Data) -> None:
    first = start_run(data={"indoor": data["indoor"]})
    first.state.save(first.out, first.config, first.identity)
    with pytest.raises(InputError, match=r"\['data'\] differ"):
        start_run(data={"indoor": data["outdoor"]})


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
