"""Rates: the schedule is torch's OneCycleLR, and every parameter has the rate of its part of the model."""

import math

import pytest
import torch
from torch import nn
from torch.optim.lr_scheduler import OneCycleLR

from zoedepth.config import ModelConfig
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.train.config import OptimConfig
from zoedepth.train.optim import build_optimizer, one_cycle, set_rates
from zoedepth.train.relative import RelativeModel

RATES = OptimConfig(learning_rate=1.0, encoder_factor=0.5, position_factor=0.25, decoder_factor=0.125)
"""Factors that tell the groups apart."""


@pytest.mark.parametrize("steps", [2, 3, 11, 57])
@pytest.mark.parametrize(
    "config",
    [
        OptimConfig(),
        OptimConfig(learning_rate=1e-3, warmup=0.1, initial_division=20.0),
        OptimConfig(learning_rate=0.5, warmup=0.3, initial_division=25.0, final_division=10.0, momentum=(0.8, 0.9)),
        OptimConfig(learning_rate=2.0, warmup=0.0, initial_division=3.0),
        OptimConfig(learning_rate=2.0, warmup=1.0, initial_division=3.0),
        OptimConfig(learning_rate=2.0, warmup=0.55, initial_division=3.0, momentum=(0.9, 0.9)),
    ],
    ids=["released", "lite", "torch's defaults", "no warmup", "warmup only", "constant momentum"],
)
def test_rates_and_momentum_are_those_of_one_cycle_step_by_step(config: OptimConfig, steps: int) -> None:
    factors = (1.0, 0.1)
    reference = torch.optim.AdamW([{"params": [nn.Parameter(torch.zeros(1))]} for _ in factors], betas=(0.5, 0.999))
    schedule = OneCycleLR(
        reference,
        max_lr=[config.learning_rate * factor for factor in factors],
        total_steps=steps,
        pct_start=config.warmup,
        div_factor=config.initial_division,
        final_div_factor=config.final_division,
        base_momentum=config.momentum[0],
        max_momentum=config.momentum[1],
    )
    ours = torch.optim.AdamW(
        [{"params": [nn.Parameter(torch.zeros(1))], "factor": factor} for factor in factors], betas=(0.5, 0.999)
    )
    for step in range(steps):
        set_rates(ours, step, steps, config)
        for group, expected in zip(ours.param_groups, reference.param_groups, strict=True):
            assert group["lr"] == pytest.approx(expected["lr"], rel=1e-9)
            assert group["betas"] == pytest.approx(expected["betas"], rel=1e-9)
        reference.step()
        if step < steps - 1:
            schedule.step()


def test_rates_rise_to_the_highest_and_fall_to_the_last() -> None:
    config = OptimConfig(warmup=0.5, initial_division=4.0, final_division=8.0, momentum=(0.8, 0.9))
    rates = [one_cycle(step, 20, config) for step in range(20)]
    assert rates[0] == pytest.approx((1 / 4, 0.9))
    assert rates[9] == pytest.approx((1.0, 0.8))
    assert rates[19] == pytest.approx((1 / 32, 0.9))


def test_run_of_one_step_has_a_rate() -> None:
    factor, beta = one_cycle(0, 1, OptimConfig(warmup=0.3))
    assert 0 < factor <= 1
    assert 0.85 <= beta <= 0.95


@pytest.mark.parametrize("steps", [2, 10])
def test_warmup_of_a_single_step_starts_at_the_highest_rate(steps: int) -> None:
    # torch's own schedule divides by zero here.
    config = OptimConfig(warmup=1 / steps, initial_division=4.0)
    assert one_cycle(0, steps, config)[0] == pytest.approx(1.0)
    assert all(math.isfinite(value) for step in range(steps) for value in one_cycle(step, steps, config))


def rates_of(optimizer: torch.optim.Optimizer) -> dict[int, float]:
    """id of a parameter → its rate; fails where one is in two groups."""
    rates: dict[int, float] = {}
    for group in optimizer.param_groups:
        for parameter in group["params"]:
            assert id(parameter) not in rates
            rates[id(parameter)] = group["lr"]
    return rates


def expected_rates(model: ZoeDepth) -> dict[int, float]:
    """The same by hand, from the model's parts, under RATES."""
    rates = {id(parameter): 1.0 for parameter in model.parameters()}
    rates |= {id(parameter): 0.125 for parameter in model.decoder.parameters()}
    rates |= {id(parameter): 0.5 for parameter in model.decoder.reassemble.parameters()}
    rates |= {id(parameter): 0.5 for parameter in model.encoder.parameters()}
    return rates | {id(parameter): 0.25 for parameter in model.encoder.network.position_tables.parameters()}


def test_every_parameter_is_in_one_group_with_the_rate_of_its_part(tiny_model: ZoeDepth) -> None:
    rates = rates_of(build_optimizer(tiny_model, RATES))
    assert set(rates.values()) == {1.0, 0.5, 0.25, 0.125}
    assert rates == expected_rates(tiny_model)


def test_first_stage_trains_encoder_and_decoder_with_the_same_rates(tiny_model: ZoeDepth) -> None:
    rates = rates_of(build_optimizer(RelativeModel(tiny_model), RATES))
    parts = [*tiny_model.encoder.parameters(), *tiny_model.decoder.parameters()]
    assert rates == {id(parameter): expected_rates(tiny_model)[id(parameter)] for parameter in parts}


@pytest.mark.parametrize(
    ("field", "part"), [("encoder_factor", "encoder"), ("position_factor", "position"), ("decoder_factor", "decoder")]
)
def test_factor_of_zero_freezes_its_part_and_no_other(tiny_config: ModelConfig, field: str, part: str) -> None:
    model = ZoeDepth(tiny_config)
    rate = {"encoder": 0.5, "position": 0.25, "decoder": 0.125}[part]
    expected = expected_rates(model)
    frozen = {id(parameter) for parameter in model.parameters() if expected[id(parameter)] == rate}

    optimizer = build_optimizer(model, OptimConfig(**{**vars(RATES), field: 0.0}))

    assert {id(parameter) for parameter in model.parameters() if not parameter.requires_grad} == frozen
    assert rates_of(optimizer) == {key: rate for key, rate in expected.items() if key not in frozen}
    before = {name: parameter.detach().clone() for name, parameter in model.named_parameters()}
    for parameter in model.parameters():
        parameter.grad = torch.ones_like(parameter)
    optimizer.step()
    moved = {id(p) for name, p in model.named_parameters() if not torch.equal(p, before[name])}
    assert moved == {id(parameter) for parameter in model.parameters()} - frozen


def test_weights_decay_as_configured(tiny_model: ZoeDepth) -> None:
    optimizer = build_optimizer(tiny_model, OptimConfig(weight_decay=0.125, momentum=(0.5, 0.75), eps=1e-3))
    assert {group["eps"] for group in optimizer.param_groups} == {1e-3}
    assert {group["weight_decay"] for group in optimizer.param_groups} == {0.125}
    assert {group["betas"] for group in optimizer.param_groups} == {(0.75, 0.999)}


# --- other systems' -------------------------------------------------------------------------------------------------


def test_polynomial_rate_falls_as_in_bts() -> None:
    """(first - last) (1 - step / steps) ** 0.9 + last, with last a tenth of the first."""
    config = OptimConfig(learning_rate=1e-4, schedule="polynomial", final_division=10, momentum=(0.9, 0.9))
    parameter = nn.Parameter(torch.zeros(1))
    optimizer = torch.optim.AdamW([{"params": [parameter], "factor": 1.0}])
    for step in range(50):
        set_rates(optimizer, step, 50, config)
        assert optimizer.param_groups[0]["lr"] == pytest.approx((1e-4 - 1e-5) * (1 - step / 50) ** 0.9 + 1e-5)
        assert optimizer.param_groups[0]["betas"][0] == 0.9


def test_gradient_descent_has_its_momentum(tiny_config: ModelConfig) -> None:
    config = OptimConfig(optimizer="sgd", momentum=(0.8, 0.9), warmup=0.5, weight_decay=0.25)
    optimizer = build_optimizer(ZoeDepth(tiny_config), config)
    assert isinstance(optimizer, torch.optim.SGD)
    set_rates(optimizer, 9, 20, config)
    assert all(group["momentum"] == pytest.approx(0.8) for group in optimizer.param_groups)
    assert {group["weight_decay"] for group in optimizer.param_groups} == {0.25}


def test_decay_of_the_encoder_only(tiny_config: ModelConfig) -> None:
    optimizer = build_optimizer(ZoeDepth(tiny_config), OptimConfig(decay_encoder_only=True, weight_decay=0.25))
    decays = {group["name"]: group["weight_decay"] for group in optimizer.param_groups}
    assert decays == {"encoder": 0.25, "position": 0.25, "decoder": 0.0, "head": 0.0}


def test_frozen_parameters_stay(tiny_config: ModelConfig) -> None:
    model = ZoeDepth(tiny_config)
    optimizer = build_optimizer(model, OptimConfig(frozen=("encoder.*norm*", "router.*")))
    frozen = {name for name, parameter in model.named_parameters() if not parameter.requires_grad}
    assert frozen
    assert frozen == {
        name for name, _ in model.named_parameters()
        if name.startswith("router.") or (name.startswith("encoder.") and "norm" in name)
    }  # fmt: skip
    given = {id(parameter) for group in optimizer.param_groups for parameter in group["params"]}
    assert given == {id(parameter) for parameter in model.parameters() if parameter.requires_grad}


def test_constant_rates_have_the_higher_momentum() -> None:
    config = OptimConfig(learning_rate=0.5, schedule="constant", momentum=(0.7, 0.8))
    optimizer = torch.optim.AdamW([{"params": [nn.Parameter(torch.zeros(1))], "factor": 0.25}])
    for step in (0, 9):
        set_rates(optimizer, step, 10, config)
        assert optimizer.param_groups[0]["lr"] == 0.125
        assert optimizer.param_groups[0]["betas"][0] == 0.8
