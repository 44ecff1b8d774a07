"""BTS: the names of its checkpoints."""

from dataclasses import replace

import pytest
import torch
from tests.weights.layouts.layouts import released, same

from zoedepth.build import build_model, without_memory
from zoedepth.config import INDOOR, BaselineConfig, BtsNetworkConfig
from zoedepth.errors import InputError
from zoedepth.weights.layouts import bts


def theirs_of(config: BaselineConfig) -> dict[str, torch.Tensor]:
    """A file of BTS with another encoder: names and shapes, no memory."""
    assert isinstance(config.network, BtsNetworkConfig)
    with without_memory():
        model = build_model(config)
    return bts.table(config.network.width).to_theirs(model.state_dict())


def test_every_name_and_shape_is_that_of_our_model():
    theirs = released("bts")
    config, ours, table = bts.read(theirs)
    assert config == BaselineConfig(BtsNetworkConfig(), domains=(INDOOR,))
    with without_memory():
        model = build_model(config)
    assert {name: value.shape for name, value in model.state_dict().items()} == {
        name: value.shape for name, value in ours.items()
    }
    back = table.to_theirs(ours)
    assert {name: value.shape for name, value in back.items()} == {name: x.shape for name, x in theirs.items()}


def waves(state: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Values for the original's names that can be written down: sines of the place in the tensor."""
    values = {}
    for name, x in state.items():
        wave = torch.sin(torch.arange(x.numel(), dtype=torch.float64) ** 1.5 + len(name)).view(x.shape)
        if x.ndim > 1:
            wave = wave * (6 / x[0].numel()) ** 0.5
        else:
            wave = 1 + 0.3 * wave if name.endswith(("weight", "running_var")) else 0.2 * wave
        values[name] = wave.to(x.dtype)
    return values


@torch.no_grad()
def test_depth_is_the_originals():
    """``bts.py`` of cleinc/bts with a DenseNet-121 and 128 channels, these weights and pixels, on a CPU."""
    shape = BaselineConfig(BtsNetworkConfig("densenet121", width=128))
    config, ours, _ = bts.read(waves(theirs_of(shape)))
    model = build_model(config).eval()
    model.load_state_dict(ours)
    y, x = torch.meshgrid(torch.arange(64.0), torch.arange(96.0), indexing="ij")
    pixels = torch.stack([torch.sin(y / 7 + x / (5 + channel)) for channel in range(3)])[None]
    expected = [
        [0.9770, 0.4091, 0.8154, 9.2494],
        [7.0360, 1.5175, 6.0234, 4.2131],
        [8.2282, 0.4411, 9.9290, 3.4176],
        [9.2422, 9.6282, 9.9828, 9.4142],
    ]
    assert torch.allclose(model.predict(pixels).depth[0, 0, 3::20, 5::25], torch.tensor(expected), atol=1e-3)


def test_layers_that_lead_to_the_planes_keep_their_order():
    theirs = released("bts")
    *_, table = bts.read(theirs)
    for ours, name in {
        "decoder.guide8.planes.0.weight": "decoder.reduc8x8.reduc.inter_128_128.0.weight",
        "decoder.guide8.planes.8.weight": "decoder.reduc8x8.reduc.inter_16_8.0.weight",
        "decoder.guide4.planes.8.weight": "decoder.reduc4x4.reduc.plane_params.weight",
        "decoder.guess.4.weight": "decoder.reduc1x1.reduc.final.0.weight",
        "decoder.context.branches.2.0.weight": "decoder.daspp_12.atrous_conv.first_bn.weight",
        "decoder.context.branches.0.5.weight": "decoder.daspp_3.atrous_conv.aconv_sequence.4.weight",
        "decoder.up8.norm.weight": "decoder.bn4.weight",
        "decoder.fuse8.2.weight": "decoder.bn4_2.weight",
    }.items():
        assert table.theirs(ours) == (name,)


@pytest.mark.parametrize(
    "network",
    [
        BtsNetworkConfig("densenet121", width=256),
        BtsNetworkConfig("resnet50"),
        BtsNetworkConfig("resnet101", width=128),
        BtsNetworkConfig("resnext50_32x4d"),
        BtsNetworkConfig("resnext101_32x8d"),
    ],
    ids=lambda network: network.encoder,
)
def test_encoder_and_width_are_told_by_the_shapes(network: BtsNetworkConfig):
    theirs = theirs_of(BaselineConfig(network))
    if "res" in network.encoder:
        theirs |= {"encoder.base_model.fc.weight": torch.empty(1), "encoder.base_model.fc.bias": torch.empty(1)}
    config, ours, _ = bts.read(theirs)
    assert config.network == network
    with without_memory():
        assert ours.keys() == build_model(config).state_dict().keys()


def test_weights_of_a_wrapped_model_are_those_of_the_model():
    torch.manual_seed(0)
    config = BaselineConfig(BtsNetworkConfig("densenet121", width=128))
    ours = build_model(config).state_dict()
    wrapped = {f"module.{name}": value for name, value in bts.table(128).to_theirs(ours).items()}
    assert bts.is_bts(wrapped)
    found_config, found, _ = bts.read(wrapped)
    assert found_config == config
    assert same(found, ours)


def test_it_is_known_by_its_names():
    assert bts.is_bts(released("bts"))
    assert not bts.is_bts(released("newcrfs"))
    assert not bts.is_bts(released("original-n"))


def test_unknown_weights_and_encoders_are_refused_by_name():
    theirs = released("bts")
    with pytest.raises(InputError, match=r"unknown weights: 'decoder\.conv9\.weight'"):
        bts.read(theirs | {"decoder.conv9.weight": torch.empty(1)})
    with pytest.raises(InputError, match=r"another encoder"):
        bts.read(theirs | {"encoder.base_model.conv0.weight": torch.empty(32, 3, 3, 3)})
    with pytest.raises(InputError, match=r"network\.width"):
        bts.read(theirs | {"decoder.bn5.weight": torch.empty(77)})
    del theirs["decoder.bn5.weight"]
    with pytest.raises(InputError, match=r"decoder\.bn5\.weight is missing"):
        bts.read(theirs)
    mobile = replace(BaselineConfig(BtsNetworkConfig()), network=BtsNetworkConfig("tf_efficientnet_lite0"))
    with pytest.raises(InputError, match=r"another encoder"):
        bts.read(theirs_of(mobile))
