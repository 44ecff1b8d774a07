"""A model with further domains is the old one until it is trained."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from zoedepth.config import INDOOR, OUTDOOR, Domain, RouterConfig
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.train.extend import extended, extended_config, head_of, origin_of


def pixels() -> torch.Tensor:
    return torch.rand(4, 3, 64, 64, generator=torch.Generator().manual_seed(1))


def test_known_domains_within_their_range_change_nothing(tiny_config):
    assert extended_config(tiny_config, {"indoor": 7.3}) == tiny_config


@pytest.mark.parametrize(
    ("far", "expected"),
    [(30.000000000000004, 30.0), (10.4, 20.0), (19.9, 20.0), (20.0, 20.0), (61.0, 80.0), (101.0, 200.0)],
)
def test_range_grows_to_a_round_number(tiny_config, far: float, expected: float):
    config = extended_config(tiny_config, {"indoor": far})
    assert config.domains == (replace(INDOOR, max_depth=expected), OUTDOOR)


def test_range_that_is_just_reached_stays(tiny_config):
    config = replace(tiny_config, domains=(replace(INDOOR, max_depth=15.0), OUTDOOR))
    assert extended_config(config, {"indoor": 15.0}) == config


def test_new_domain_gets_a_head_of_its_own_at_the_end(tiny_config):
    config = extended_config(tiny_config, {"warehouse": 27.0, "indoor": 3.0})
    assert config.domains == (INDOOR, OUTDOOR, Domain("warehouse", 1e-3, 30.0))


def test_model_of_one_domain_keeps_its_one_head(tiny_config):
    config = extended_config(replace(tiny_config, domains=(INDOOR,)), {"warehouse": 27.0})
    assert config.domains == (replace(INDOOR, max_depth=30.0),)


def test_heads_that_learn_get_the_focal_length_of_the_data(tiny_config):
    config = replace(tiny_config, domains=tuple(replace(each, focal_px=80.0) for each in tiny_config.domains))
    found = extended_config(config, {"warehouse": 27.0, "indoor": 3.0}, focal_px={"warehouse": 50.0})
    assert [domain.focal_px for domain in found.domains] == [None, 80.0, 50.0]
    assert extended_config(config, {"indoor": 3.0}) == config


def test_what_was_fitted_to_the_errors_of_the_old_weights_is_forgotten(tiny_config):
    config = replace(tiny_config, domains=tuple(replace(each, std_factor=1.5) for each in tiny_config.domains))
    assert extended_config(config, {"warehouse": 27.0, "indoor": 3.0}).domains[:2] == tiny_config.domains
    assert extended_config(config, {"indoor": 3.0}) == tiny_config


def test_a_domain_starts_from_the_head_of_its_name_or_of_the_nearest_range(tiny_config):
    assert origin_of(tiny_config, "indoor", 500.0) == INDOOR
    assert origin_of(tiny_config, "warehouse", 27.0) == OUTDOOR
    assert origin_of(tiny_config, "doll's house", 0.5) == INDOOR
    one = replace(tiny_config, domains=(OUTDOOR,))
    assert (origin_of(one, "warehouse", 5.0), head_of(one, "warehouse")) == (OUTDOOR, "outdoor")
    assert head_of(tiny_config, "warehouse") == "warehouse"


@pytest.mark.parametrize("classifier", ["mlp", "transformer"])
def test_extended_model_says_what_the_old_one_said(tiny_config, classifier: str):
    torch.manual_seed(0)
    decoder = replace(tiny_config.decoder, output_stride=2, upsampling="convex")
    config = replace(tiny_config, decoder=decoder, router=RouterConfig("trained", classifier=classifier, width=16))
    old = ZoeDepth(config).eval()
    nn.init.normal_(old.convex.conv2.weight)
    new = extended(old, extended_config(config, {"warehouse": 27.0}))
    with torch.no_grad():
        before, after = old(pixels()), new(pixels())
        warehouse = new(pixels(), domain=torch.full((4,), 2))
        outdoor = old(pixels(), domain=torch.full((4,), 1))
    torch.testing.assert_close(before.depth, after.depth)
    assert torch.equal(before.domain, after.domain)
    # 30 m is nearer to 80 than to 10, as ratios go: a copy of the outdoor head, and of its score.
    torch.testing.assert_close(warehouse.depth, outdoor.depth)
    torch.testing.assert_close(after.domain_logits[:, 2], before.domain_logits[:, 1])
