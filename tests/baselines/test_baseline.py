"""The list of baselines, and constants that are no weights."""

import pytest
import torch
from tests.baselines import test_adabins, test_bts, test_dorn, test_localbins, test_newcrfs, test_pixelbins
from tests.baselines.base import build, photos

from zoedepth.baselines import BASELINES
from zoedepth.baselines.baseline import Baseline
from zoedepth.build import build_model

CONFIGS = [module.TINY for module in (test_adabins, test_bts, test_dorn, test_localbins, test_newcrfs, test_pixelbins)]


def test_every_baseline_is_tested():
    assert {type(config.network) for config in CONFIGS} == set(BASELINES)


def test_a_model_built_without_memory_gets_its_constants_back():
    with torch.device("meta"):
        model = build_model(test_bts.TINY)
    assert isinstance(model, Baseline)
    model.to_empty(device="cpu")
    model.init_non_persistent_buffers()
    assert model.mean.flatten().tolist() == pytest.approx([0.485, 0.456, 0.406])
    assert model.std.flatten().tolist() == pytest.approx([0.229, 0.224, 0.225])


@torch.no_grad()
def test_constants_follow_the_weights_to_another_precision():
    model = build(test_bts.TINY).double()
    assert model(photos(test_bts.TINY).double()).depth.isfinite().all()
