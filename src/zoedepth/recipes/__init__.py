"""Recipes: functions that return the full configuration of a training. ``RECIPES`` lists them all."""

from collections.abc import Callable
from functools import partial

from zoedepth.recipes import demo, metric, relative, zoed_lite
from zoedepth.recipes.ablations import ABLATIONS
from zoedepth.recipes.baselines import BASELINE_RECIPES
from zoedepth.recipes.comparison import COMPARISON
from zoedepth.train.config import TrainConfig


def _named(build: Callable[[str], TrainConfig], *presets: str) -> dict[str, Callable[[], TrainConfig]]:
    return {preset.replace("-", "_"): partial(build, preset) for preset in presets}


RECIPES: dict[str, Callable[[], TrainConfig]] = {
    "zoed_lite_relative": zoed_lite.relative,
    "zoed_lite_small": zoed_lite.small_metric,
    "zoed_lite": zoed_lite.metric,
    "zoed_lite_longer": zoed_lite.longer_metric,
    "zoed_lite_decoder": zoed_lite.decoder_metric,
    "demo_relative": demo.relative,
    "demo": demo.metric,
    # Stage 1.
    "relative_m12_curated": relative.m12_curated,
    "relative_m12": relative.m12,
    "relative_nk": relative.nk,
    "relative_n": relative.n,
    "relative_k": relative.k,
    # Stage 2: the paper's model table, its X-NK, and its comparison of encoders.
    **_named(metric.nyu, "zoed-x-n", "zoed-n-n", "zoed-nk-n", "zoed-m12-n"),
    **_named(metric.kitti, "zoed-x-k", "zoed-k-k", "zoed-nk-k", "zoed-m12-k"),
    **_named(
        metric.nyu_and_kitti,
        "zoed-nk-nk-one-head", "zoed-m12-nk-one-head", "zoed-nk-nk", "zoed-m12-nk", "zoed-x-nk-one-head", "zoed-x-nk",
    ),
    **_named(
        metric.nyu,
        "zoed-m12-n-swin-l", "zoed-m12-n-swin2-t", "zoed-m12-n-swin2-b", "zoed-m12-n-swin2-l", "zoed-m12-n-beit-b",
        "zoed-m12-n-beit-l-512", "zoed-m12-n-efficientnet-b5",
    ),
    # The paper's Tables 2, 5 and 6, and its baselines; then all heads and baselines, small, on equal terms.
    **ABLATIONS,
    **BASELINE_RECIPES,
    **COMPARISON,
}  # fmt: skip
"""Name on the command line → function that returns the configuration."""
