"""AdaBins and PixelBins: the names of their checkpoints, which are alike but for the bins."""

from types import ModuleType

import pytest
import torch
from tests.weights.layouts.layouts import released, same

from zoedepth.build import build_model, without_memory
from zoedepth.config import INDOOR, OUTDOOR, AdaBinsNetworkConfig, BaselineConfig, PixelBinsNetworkConfig
from zoedepth.errors import InputError
from zoedepth.weights.layouts import adabins, pixelbins

DROPPED = {
    f"encoder.original_model.bn2.{kind}"
    for kind in ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")
}
"""What no depth is made of."""
CONFIGS = {
    "adabins": BaselineConfig(AdaBinsNetworkConfig(), domains=(INDOOR,)),
    "pixelbins": BaselineConfig(PixelBinsNetworkConfig(), domains=(OUTDOOR,)),
}
EACH = pytest.mark.parametrize(("name", "module"), [("adabins", adabins), ("pixelbins", pixelbins)])


@EACH
def test_every_name_and_shape_is_that_of_our_model_and_back(name: str, module: ModuleType):
    theirs = released(name)
    config, ours, table = module.read(theirs)
    assert config == CONFIGS[name]
    with without_memory():
        model = build_model(config)
    assert {key: value.shape for key, value in model.state_dict().items()} == {
        key: value.shape for key, value in ours.items()
    }
    back = table.to_theirs(ours)
    assert {key: value.shape for key, value in back.items()} == {
        key: value.shape for key, value in theirs.items() if key not in DROPPED
    }


@EACH
def test_weights_of_a_wrapped_model_are_those_of_the_model(name: str, module: ModuleType):
    torch.manual_seed(0)
    network = type(CONFIGS[name].network)("tf_efficientnet_lite0", n_bins=7)
    ours = build_model(BaselineConfig(network)).state_dict()
    wrapped = {f"module.{key}": value for key, value in module.TABLE.to_theirs(ours).items()}
    config, found, _ = module.read(wrapped)
    assert same(found, ours)
    assert config.network.n_bins == 7


def test_each_is_known_by_its_names():
    assert adabins.is_adabins(released("adabins"))
    assert pixelbins.is_pixelbins(released("pixelbins"))
    for other in ("localbins", "newcrfs", "original-n"):
        assert not adabins.is_adabins(released(other))
        assert not pixelbins.is_pixelbins(released(other))
    assert not pixelbins.is_pixelbins(released("adabins"))
    assert not adabins.is_adabins(released("pixelbins"))


def test_names_from_before_are_known():
    theirs = released("adabins")
    layer = "adaptive_bins_layer."
    older = {
        name.replace(f"{layer}conv3x3.", f"{layer}embedding_conv.").replace(
            "embedding_convPxP.", "embedding_encoder."
        ): value
        for name, value in theirs.items()
    }
    assert older.keys() != theirs.keys()
    assert adabins.read(older)[1].keys() == adabins.read(theirs)[1].keys()


@EACH
def test_unknown_and_missing_weights_are_refused_by_name(name: str, module: ModuleType):
    theirs = released(name)
    with pytest.raises(InputError, match=r"unknown weights: 'decoder\.conv9\.weight'"):
        module.read(theirs | {"decoder.conv9.weight": torch.empty(1)})
    del theirs["conv_out.0.weight"]
    with pytest.raises(InputError, match=r"conv_out\.0\.weight.* is missing"):
        module.read(theirs)
