"""Configurations that make no sense are errors that say why."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from zoedepth.errors import InputError
from zoedepth.presets import BASELINES
from zoedepth.train.config import OptimConfig, SourceConfig, TrainConfig

MakeConfig = Callable[..., TrainConfig]
WINDOW = SourceConfig("indoor", crop="window", window=(32, 64))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"steps": 0}, "steps and batch_size must be at least 1; they are 0 and 2"),
        ({"batch_size": 0}, "steps and batch_size must be at least 1; they are 4 and 0"),
        ({"batch_size": 4, "accumulate": 3}, "a batch of 4 cannot be split into 3 equal parts"),
        ({"accumulate": 0}, "a batch of 2 cannot be split into 0 equal parts"),
        ({"pareto_every": 0}, "pareto_every must be at least 1; it is 0"),
        ({"validate_every": 0}, "validate_every"),
        ({"checkpoint_every": 0}, "checkpoint_every"),
        ({"log_every": 0}, "log_every"),
        ({"keep_checkpoints": 0}, "keep_checkpoints"),
        ({"holdout": -1}, r"must be 0 or more; they are \[-1\], 0 and"),
        ({"n_workers": -1}, "must be 0 or more"),
        ({"holdouts": (1, 2)}, "holdouts has 2 numbers for 3 sources"),
        ({"ema_decay": 1.5}, "ema_decay must be from 0 to below 1; it is 1.5"),
        ({"stage": "relative", "mix_by": "batch"}, "stage 1 needs all data sets in each batch: set mix_by to 'image'"),
        ({"stage": "relative", "model": BASELINES["bts-n"]}, "stage 1 is for ZoeDepth"),
        ({"sources": (replace(WINDOW, window=(40, 64)),)}, r"multiples of 32 for this model; they are \[\(40, 64\)\]"),
        ({"sources": (WINDOW, replace(WINDOW, name="other", window=(64, 64)))}, "set mix_by to 'batch'"),
        ({"sources": (WINDOW, SourceConfig("other"))}, "set mix_by to 'batch'"),
    ],
)
def test_values_that_make_no_sense_are_errors(make_config: MakeConfig, fields: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_config(**fields)


def test_the_smallest_values_and_windows_that_fit_are_welcome(make_config: MakeConfig) -> None:
    ones = (
        "pareto_every",
        "validate_every",
        "checkpoint_every",
        "log_every",
        "keep_checkpoints",
        "steps",
        "batch_size",
    )
    make_config(**dict.fromkeys(ones, 1))
    make_config(batch_size=4, accumulate=4)
    make_config(sources=(WINDOW, replace(WINDOW, name="other")))
    make_config(sources=(WINDOW, replace(WINDOW, name="other", window=(64, 64))), mix_by="batch")
    make_config("relative", sources=(SourceConfig("indoor"),), mix_by="batch")
    # Only a window that is used must fit.
    make_config(sources=(replace(WINDOW, crop="fit", window=(40, 64)),))


@pytest.mark.parametrize(
    "fields",
    [{"learning_rate": 0.0}, {"learning_rate": -1.0}, {"learning_rate": float("nan")}, {"clip": 0.0},
     {"encoder_factor": -0.1}, {"weight_decay": float("nan")}, {"warmup": 1.5}],
)  # fmt: skip
def test_rates_that_make_no_sense_are_errors(fields: dict[str, float]) -> None:
    ((name, value),) = fields.items()
    with pytest.raises(InputError, match=f"{name} .*it is {value}"):
        OptimConfig(**fields)


def test_frozen_parts_and_a_schedule_without_warmup_are_welcome() -> None:
    OptimConfig(encoder_factor=0.0, position_factor=0.0, decoder_factor=0.0, weight_decay=0.0, warmup=0.0)
