"""Recipes: functions that return the full configuration of a training run. :data:`RECIPES` is the only list of them."""

from collections.abc import Callable

from zoedepth.recipes import zoed_lite
from zoedepth.train.config import TrainConfig

RECIPES: dict[str, Callable[[], TrainConfig]] = {
    "zoed_lite_relative": zoed_lite.relative,
    "zoed_lite": zoed_lite.metric,
}
"""Name on the command line → function."""
