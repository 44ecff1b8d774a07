"""The model in the package."""

from dataclasses import replace

import numpy as np
import pytest
from skimage import data

from zoedepth import Predictor, load_model
from zoedepth.commands.demo import motorcycle_depth
from zoedepth.depth_map import DepthMap
from zoedepth.metrics import compute_metrics
from zoedepth.presets import PRESETS
from zoedepth.weights.releases import RELEASES


@pytest.fixture(scope="module")
def motorcycle() -> DepthMap:
    return Predictor(load_model("zoed-lite"))(data.stereo_motorcycle()[0])


def test_is_small_and_has_the_preset_s_architecture() -> None:
    assert RELEASES["zoed-lite"].path.stat().st_size <= 16e6
    config = load_model("zoed-lite").config
    assert [domain.std_factor for domain in config.domains] == [1.445, 1.768], "of these weights, as results.md says"
    architecture = replace(config, domains=tuple(replace(domain, std_factor=1.0) for domain in config.domains))
    assert architecture == PRESETS["zoed-lite"]


def test_sees_a_room_in_the_motorcycle_s_garage(motorcycle: DepthMap) -> None:
    assert motorcycle.domain == "indoor"


def test_orders_the_depth_of_a_photo_it_has_never_seen(motorcycle: DepthMap) -> None:
    truth = motorcycle_depth()
    known = truth > 0
    scaled = motorcycle.depth[known] * np.median(truth[known]) / np.median(motorcycle.depth[known])
    flat = np.full_like(scaled, np.median(truth[known]))
    # Far better than no idea of the scene at all.
    assert compute_metrics(scaled, truth[known]).rel < 0.7 * compute_metrics(flat, truth[known]).rel
