"""LocalBins: the names of its checkpoints."""

from dataclasses import replace

import pytest
import torch
from tests.weights.layouts.layouts import released, same

from zoedepth.build import build_model, without_memory
from zoedepth.config import INDOOR, BaselineConfig, LocalBinsNetworkConfig
from zoedepth.errors import InputError
from zoedepth.weights.layouts import localbins

DROPPED = {
    *(f"decoder.height_head.{i}.{kind}" for i in (0, 2, 4) for kind in ("weight", "bias")),
    *(
        f"encoder.original_model.bn2.{kind}"
        for kind in ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")
    ),
}
"""What no depth is made of."""


def test_every_name_and_shape_is_that_of_our_model_but_for_a_known_few():
    theirs = released("localbins")
    config, ours, table = localbins.read(theirs)
    with without_memory():
        model = build_model(config)
    assert {name: value.shape for name, value in model.state_dict().items()} == {
        name: value.shape for name, value in ours.items()
    }
    assert theirs.keys() - {name for our in ours for name in table.theirs(our)} == DROPPED


def test_way_back_gives_the_same_names_and_shapes():
    theirs = released("localbins")
    _, ours, table = localbins.read(theirs)
    back = table.to_theirs(ours)
    assert {name: value.shape for name, value in back.items()} == {
        name: value.shape for name, value in theirs.items() if name not in DROPPED
    }


def test_config_is_told_by_the_shapes_and_keeps_the_bins_of_the_public_code():
    theirs = released("localbins")
    config, *_ = localbins.read(theirs)
    assert config == BaselineConfig(LocalBinsNetworkConfig(n_seed_bins=8, front_padding=False), domains=(INDOOR,))
    with without_memory():
        model = build_model(replace(config, network=LocalBinsNetworkConfig(n_seed_bins=16)))
    other, *_ = localbins.read(localbins.TABLE.to_theirs(model.state_dict()))
    assert other.network == LocalBinsNetworkConfig(n_seed_bins=16, front_padding=False)


def test_weights_of_a_wrapped_model_are_those_of_the_model():
    torch.manual_seed(0)
    config = BaselineConfig(LocalBinsNetworkConfig("tf_efficientnet_lite0", n_seed_bins=2))
    ours = build_model(config).state_dict()
    wrapped = {f"module.{name}": value for name, value in localbins.TABLE.to_theirs(ours).items()}
    assert localbins.is_localbins(wrapped)
    _, found, _ = localbins.read(wrapped)
    assert same(found, ours)


def test_it_is_known_by_its_names():
    assert localbins.is_localbins(released("localbins"))
    assert not localbins.is_localbins(released("newcrfs"))
    assert not localbins.is_localbins(released("original-n"))


def test_unknown_and_missing_weights_are_refused_by_name():
    theirs = released("localbins")
    with pytest.raises(InputError, match=r"unknown weights: 'decoder\.conv3\.weight'"):
        localbins.read(theirs | {"decoder.conv3.weight": torch.empty(1)})
    del theirs["decoder.seed_bin_regressor._net.2.weight"]
    with pytest.raises(InputError, match=r"decoder\.seed_bin_regressor\._net\.2\.weight.* is missing"):
        localbins.read(theirs)
