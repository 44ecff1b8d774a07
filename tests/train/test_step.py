"""One optimizer step: rates, gradients, clipping, moving average, and what guards the weights."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from zoedepth.errors import TrainingError
from zoedepth.train.config import OptimConfig
from zoedepth.train.run import Run
from zoedepth.train.step import backward, begin_step, freeze_batch_norm, means, take_step

StartRun = Callable[..., Run]


def sum_of_weights(run: Run) -> Tensor:
    """Return a loss whose gradient is 1 for every weight."""
    return torch.stack([parameter.sum() for parameter in run.network.parameters()]).sum()


def weights(run: Run) -> dict[str, Tensor]:
    return {name: value.clone() for name, value in run.state.model.state_dict().items()}


def gradients(run: Run) -> Tensor:
    return torch.cat([parameter.grad.flatten() for parameter in run.network.parameters()])


# ---------------------------------------------------------------------------------------------------- begin


def test_a_step_begins_in_training_mode_with_the_rates_of_its_number(start_run: StartRun) -> None:
    optim = OptimConfig(learning_rate=0.5, encoder_factor=0.25, schedule="polynomial", final_division=10)
    run = start_run(steps=4, optim=optim)
    run.state.model.eval()
    run.state.step = 3
    begin_step(run)
    expected = 0.5 * (0.1 + 0.9 * (1 - 3 / 4) ** 0.9)
    rates = {group["name"]: group["lr"] for group in run.optimizer.param_groups}
    assert rates["head"] == pytest.approx(expected)
    assert rates["encoder"] == pytest.approx(0.25 * expected)
    assert all(module.training for module in run.state.model.modules())


@pytest.mark.parametrize("frozen", [True, False])
def test_batch_norms_of_the_encoder_are_frozen_at_every_step(start_run: StartRun, frozen: bool) -> None:
    run = start_run(freeze_batch_norm=frozen)
    norms = [nn.BatchNorm2d(4) for _ in range(2)]
    run.state.model.encoder.norm, run.state.model.router.norm = norms  # the tiny model has none
    for _ in range(2):
        begin_step(run)
        assert [norm.training for norm in norms] == [not frozen, True]
        run.state.model.train()  # as validation leaves it


def test_frozen_batch_norms_are_in_evaluation_mode_and_still_learn() -> None:
    network = nn.Sequential(nn.Conv2d(3, 4, 1), nn.BatchNorm2d(4), nn.Sequential(nn.BatchNorm1d(4), nn.Dropout()))
    network.train()
    freeze_batch_norm(network)
    assert [module.training for module in network.modules()] == [True, True, False, True, False, True]
    assert all(parameter.requires_grad for parameter in network.parameters())


# ---------------------------------------------------------------------------------------------------- backward


def test_gradients_of_a_step_are_the_mean_over_its_batches(start_run: StartRun) -> None:
    run = start_run(batch_size=4, accumulate=2)
    batch = next(run.batches)
    backward(run, 3 * sum_of_weights(run), batch, complete=False)
    assert torch.all(gradients(run) == 1.5)
    backward(run, 5 * sum_of_weights(run), batch, complete=True)
    assert torch.all(gradients(run) == 4)


def test_processes_exchange_gradients_with_the_last_batch_of_a_step(
    start_run: StartRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = start_run()
    silent: list[bool] = []

    @contextmanager
    def no_sync(module: nn.Module, enabled: bool) -> Iterator[None]:
        silent.append(enabled)
        yield

    monkeypatch.setattr(run.fabric, "no_backward_sync", no_sync)
    for complete in (False, True):
        backward(run, sum_of_weights(run), next(run.batches), complete=complete)
    assert silent == [True, False]


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_loss_that_is_not_finite_stops_before_it_reaches_a_gradient(start_run: StartRun, value: float) -> None:
    run = start_run()
    batch = next(run.batches)
    with pytest.raises(TrainingError, match=rf"the loss is {value} at step 1; the images were .*{batch.names[0]}"):
        backward(run, value * sum_of_weights(run), batch, complete=True)
    assert all(parameter.grad is None for parameter in run.network.parameters())


# ---------------------------------------------------------------------------------------------------- step


def test_gradients_are_clipped_and_the_norm_before_is_returned(start_run: StartRun) -> None:
    run = start_run(optim=OptimConfig(clip=0.5))
    seen: list[Tensor] = []
    run.optimizer.optimizer.register_step_pre_hook(lambda *_: seen.append(gradients(run).norm()))
    backward(run, 3 * sum_of_weights(run), next(run.batches), complete=True)
    norm = take_step(run, [])
    n_weights = sum(parameter.numel() for parameter in run.network.parameters())
    assert norm == pytest.approx(3 * n_weights**0.5, rel=1e-4)
    assert seen[0].item() == pytest.approx(0.5, rel=1e-3)


def test_a_step_moves_weights_and_their_average_and_forgets_the_gradients(start_run: StartRun) -> None:
    run = start_run(ema_decay=0.75, optim=OptimConfig(optimizer="sgd", learning_rate=1.0, clip=1e9, momentum=(0, 0)))
    start = weights(run)
    for step in (1, 2):
        begin_step(run)
        before = weights(run)
        average = dict(run.state.result.state_dict())
        average = {name: value.clone() for name, value in average.items()}
        backward(run, sum_of_weights(run), next(run.batches), complete=True)
        take_step(run, [])
        assert run.state.step == step
        assert all(parameter.grad is None for parameter in run.network.parameters())
        now = weights(run)
        assert not torch.equal(now["encoder.network.cls_token"], before["encoder.network.cls_token"])
        for name, value in run.state.result.state_dict().items():
            expected = now[name] if step == 1 else 0.75 * average[name] + 0.25 * now[name]
            torch.testing.assert_close(value, expected, msg=name)
    assert start.keys() == weights(run).keys()


def infinite_slope(run: Run) -> Tensor:
    """Return a loss of 0, the root of 0, which has infinite slopes."""
    return torch.sqrt(0 * sum_of_weights(run))


def test_gradient_that_is_not_finite_stops_before_it_reaches_the_weights(start_run: StartRun) -> None:
    run = start_run()
    before = weights(run)
    batches = [next(run.batches), next(run.batches)]
    backward(run, infinite_slope(run), batches[0], complete=True)
    with pytest.raises(TrainingError, match="norm of the gradients is nan at step 1") as raised:
        take_step(run, batches)
    assert all(name in str(raised.value) for batch in batches for name in batch.names)
    assert run.state.step == 0
    assert all(torch.equal(value, before[name]) for name, value in weights(run).items())


def test_in_float16_the_scaling_of_the_loss_deals_with_infinite_gradients(start_run: StartRun) -> None:
    run = start_run()
    backward(run, infinite_slope(run), next(run.batches), complete=True)
    take_step(replace(run, config=replace(run.config, precision="16-mixed")), [])
    assert run.state.step == 1


def test_numbers_of_a_step_are_means_over_its_batches() -> None:
    assert means([{"silog": 3.0, "domain": 1.0}, {"silog": 6.0, "domain": 2.0}]) == {"silog": 4.5, "domain": 1.5}


def test_a_data_set_that_some_batches_have_not_has_the_mean_over_those_that_have_it() -> None:
    assert means([{"ssi": 2.0}, {"ssi": 4.0, "ssi/nyu": 0.4}, {"ssi": 6.0}]) == {"ssi": 4.0, "ssi/nyu": 0.4}
