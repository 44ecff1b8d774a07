from typing import Any

import pytest

from zoedepth.config.baselines import (
    NETWORK_CONFIGS,
    BtsNetworkConfig,
    DornNetworkConfig,
    LocalBinsNetworkConfig,
    NewCrfsNetworkConfig,
)
from zoedepth.errors import InputError


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        (BtsNetworkConfig, {"width": 100}, r"network\.width must be a multiple of 32, 128 or more"),
        (BtsNetworkConfig, {"width": 96}, r"network\.width must be a multiple of 32, 128 or more"),
        (BtsNetworkConfig, {"focal_px": 0.0}, r"network\.focal_px must be more than 0"),
        (LocalBinsNetworkConfig, {"n_seed_bins": 1}, r"network\.n_seed_bins must be at least 2"),
        (LocalBinsNetworkConfig, {"n_windows": -1}, r"network\.n_windows must be at least 0"),
        (NewCrfsNetworkConfig, {"widths": (1024, 512, 256, 126)}, r"network\.widths must be multiples of 4"),
        (NewCrfsNetworkConfig, {"attention_heads": (32, 16, 8, 0)}, r"network\.attention_heads must be divisors"),
        (NewCrfsNetworkConfig, {"seed_width": 0}, r"network\.seed_width must be a multiple of 2"),
        (DornNetworkConfig, {"n_intervals": 1}, r"network\.n_intervals must be 2 to 10,000"),
        (DornNetworkConfig, {"n_intervals": 10_001}, r"network\.n_intervals must be 2 to 10,000; it is 10001"),
        (DornNetworkConfig, {"rates": (0, 1, 2)}, r"network\.rates must be three dilations of at least 1"),
        (DornNetworkConfig, {"pooling": 0}, r"network\.pooling must be at least 1"),
    ],
)
def test_values_that_make_no_network_are_errors(kind: type, changes: dict[str, Any], message: str):
    with pytest.raises(InputError, match=message):
        kind(**changes)


def test_smallest_values_are_allowed():
    assert BtsNetworkConfig(width=128, focal_px=0.1).width == 128
    assert LocalBinsNetworkConfig(n_seed_bins=2, n_windows=0).n_windows == 0
    assert DornNetworkConfig(n_intervals=2, rates=(1, 1, 1), pooling=1).pooling == 1


def test_every_network_has_a_name():
    names = {kind.__name__.removesuffix("NetworkConfig").lower(): kind for kind in NETWORK_CONFIGS.values()}
    assert names == NETWORK_CONFIGS
