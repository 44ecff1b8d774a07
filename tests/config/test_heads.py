"""The values a head's config refuses. That every field changes something is tested with the heads."""

from typing import Any

import pytest

from zoedepth.config import (
    AdaBinsConfig,
    AttractorConfig,
    BtsConfig,
    DornConfig,
    NaiveConfig,
    NewCrfsConfig,
    PixelBinsConfig,
    SplitterConfig,
)
from zoedepth.config.heads import HEAD_CONFIGS
from zoedepth.errors import InputError


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        (AttractorConfig, {"n_bins": 1}, r"head\.n_bins must be at least 2; it is 1"),
        (AttractorConfig, {"n_attractors": (16, 8, 4)}, r"head\.n_attractors must be four numbers"),
        (AttractorConfig, {"n_attractors": (16, 8, 4, 0)}, r"head\.n_attractors must be numbers of at least 1"),
        (AttractorConfig, {"min_temperature": -0.1}, r"head\.min_temperature must be at least 0"),
        (AttractorConfig, {"min_temperature": 50.0}, r"head\.min_temperature must be .* less than .* 50\.0"),
        (AttractorConfig, {"centers": "normed", "initial_centers": "geometric"}, r"head\.initial_centers must be"),
        (SplitterConfig, {"n_seed_bins": 1}, r"head\.n_seed_bins must be at least 2"),
        (SplitterConfig, {"factor": 1}, r"head\.factor must be at least 2"),
        (SplitterConfig, {"n_windows": -1}, r"head\.n_windows must be at least 0"),
        (PixelBinsConfig, {"n_bins": 1}, r"head\.n_bins must be at least 2"),
        (DornConfig, {"n_intervals": 1}, r"head\.n_intervals must be 2 to 10,000"),
        (DornConfig, {"n_intervals": 10_001}, r"head\.n_intervals must be 2 to 10,000; it is 10001"),
        (NewCrfsConfig, {"widths": (1024, 512, 256, 126)}, r"head\.widths must be multiples of 4"),
        (NewCrfsConfig, {"attention_heads": (32, 16, 8, 3)}, r"head\.attention_heads must be divisors"),
        (NewCrfsConfig, {"seed_width": 511}, r"head\.seed_width must be a multiple of 2"),
        (NewCrfsConfig, {"window": 1}, r"head\.window must be at least 2"),
        (NewCrfsConfig, {"n_blocks": 0}, r"head\.n_blocks must be at least 1"),
        (NaiveConfig, {"initial_depth": 0.0}, r"head\.initial_depth must be more than 0 metres"),
        (AdaBinsConfig, {"n_bins": 1}, r"head\.n_bins must be at least 2"),
        (AdaBinsConfig, {"patch": 0}, r"head\.patch must be 1 to 16"),
        (AdaBinsConfig, {"patch": 17}, r"head\.patch must be 1 to 16"),
        (AdaBinsConfig, {"attention_heads": 3}, r"head\.attention_heads must be a divisor of the width 128"),
        (BtsConfig, {"widths": (128, 64, 7)}, r"head\.widths must be numbers of at least 8"),
    ],
)
def test_values_that_make_no_head_are_errors(kind: type, changes: dict[str, Any], message: str):
    with pytest.raises(InputError, match=message):
        kind(**changes)


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        (AttractorConfig, {"n_bins": 2, "n_attractors": (1, 1, 1, 1), "min_temperature": 0.0}),
        (SplitterConfig, {"n_seed_bins": 2, "factor": 2, "n_windows": 0}),
        (PixelBinsConfig, {"n_bins": 2}),
        (DornConfig, {"n_intervals": 2}),
        (NewCrfsConfig, {"window": 2, "n_blocks": 1}),
        (NaiveConfig, {"initial_depth": 0.01}),
        (AdaBinsConfig, {"n_bins": 2, "patch": 1, "attention_heads": 64}),
        (BtsConfig, {"widths": (8, 8, 8)}),
    ],
)
def test_smallest_values_are_allowed(kind: type, changes: dict[str, Any]):
    config = kind(**changes)
    assert {name: getattr(config, name) for name in changes} == changes


def test_every_head_has_a_name():
    assert {kind.__name__.removesuffix("Config").lower(): kind for kind in HEAD_CONFIGS.values()} == HEAD_CONFIGS
