import dataclasses
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

import zoedepth.config
from zoedepth.config import (
    AttractorConfig,
    BaselineConfig,
    BtsNetworkConfig,
    DecoderConfig,
    Domain,
    DornConfig,
    DornNetworkConfig,
    EncoderConfig,
    HeadConfig,
    ModelConfig,
    NetworkConfig,
    RouterConfig,
    from_dict,
    model_config_from_dict,
    to_dict,
)
from zoedepth.config.baselines import NETWORK_CONFIGS
from zoedepth.config.heads import HEAD_CONFIGS
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.presets import PRESETS

CONFIGS = [EncoderConfig, DecoderConfig, AttractorConfig, RouterConfig, Domain, ModelConfig]
"""The parts of a ZoeDepth. The other heads' fields are tested with the heads."""
FIELDS = [(config, field.name) for config in CONFIGS for field in dataclasses.fields(config)]
IDS = [f"{config.__name__}.{name}" for config, name in FIELDS]
EVERY_FIELD = pytest.mark.parametrize(("kind", "name"), FIELDS, ids=IDS)

SWIN = EncoderConfig(
    "swinv2_tiny_window16_256", "swin", size=(64, 64), width=24, depth=(1, 1, 2, 1), heads=(1, 2, 4, 8)
)
NORMED = {AttractorConfig: {"centers": "normed"}}
"""The field matters for normed centers only."""

# For every field, a value it does not have in the tiny config, and what the tiny config must be for it to matter.
CHANGES: dict[type, dict[str, tuple[Any, dict[type, dict[str, Any]]]]] = {
    EncoderConfig: {
        "name": ("beit_large_patch16_384", {}),  # starts with other layer scales
        "family": ("convolutional", {}),
        "size": ((96, 96), {}),
        "taps": ((0, 1, 2, 4), {EncoderConfig: {"depth": (5,)}}),
        "channels": ((8, 16, 16, 24), {}),
        "width": (64, {}),
        "depth": ((1, 1, 1, 1), {ModelConfig: {"encoder": SWIN}}),
        "heads": ((2,), {}),
        "mlp_width": (96, {}),
    },
    DecoderConfig: {
        "widths": ((16, 16, 24, 16), {}),
        "features": (12, {}),
        "output_stride": (2, {}),
    },
    AttractorConfig: {
        "n_bins": (9, {}),
        "n_attractors": ((4, 3, 2, 2), {}),
        "kind": ("exponential", {}),
        "reduce": ("mean", {}),
        "alpha": (100.0, {}),
        "gamma": (3.0, {}),
        "centers": ("normed", {}),
        "attractor_ratio": (False, NORMED),
        "relative_input": (False, {}),
        "probability": ("softmax", {}),
        "bottleneck_factor": (4, {}),
        "min_temperature": (1.0, {}),
        "max_temperature": (5.0, {}),
        "embedding_width": (24, {}),
        "projector_width": (24, {}),
        "seed_width": (24, {}),
        "initial_centers": ("geometric", {}),
    },
    RouterConfig: {
        "kind": ("auto", {}),
        "classifier": ("transformer", {}),
        "width": (32, {}),
        "attention_heads": (2, {RouterConfig: {"classifier": "transformer"}}),
        "feedforward_width": (64, {RouterConfig: {"classifier": "transformer"}}),
        "vote": ("batch", {}),
    },
    Domain: {
        "name": ("indoor cave", {}),
        "min_depth": (2.0, NORMED),
        "max_depth": (20.0, NORMED),
    },
    ModelConfig: {
        "encoder": (SWIN, {}),
        "decoder": (DecoderConfig(widths=(8, 8, 8, 8)), {}),
        "head": (AttractorConfig(n_bins=4), {}),
        "router": (RouterConfig("labeled"), {}),
        "domains": ((zoedepth.config.INDOOR,), {}),
        "size": ((96, 64), {}),
        "antialias": (True, {}),
        "resize": ("squeeze", {}),
        "pad": (False, {}),
    },
}


def with_value(config: ModelConfig, kind: type, name: str, value: Any) -> ModelConfig:
    """The model config with one field of one of its parts changed; of the domains, the first."""
    if kind is ModelConfig:
        return replace(config, **{name: value})
    if kind is Domain:
        first, *others = config.domains
        return replace(config, domains=(replace(first, **{name: value}), *others))
    part = {EncoderConfig: "encoder", DecoderConfig: "decoder", AttractorConfig: "head", RouterConfig: "router"}[kind]
    return replace(config, **{part: replace(getattr(config, part), **{name: value})})


def shapes(config: ModelConfig) -> dict[str, tuple[int, ...]]:
    with torch.device("meta"):
        return {name: tuple(value.shape) for name, value in ZoeDepth(config).state_dict().items()}


def outputs(config: ModelConfig) -> dict[str, Any]:
    """All that a user of the model sees: its answers in use, in training, and through the predictor."""
    torch.manual_seed(0)
    model = ZoeDepth(config).eval()
    with torch.no_grad():  # a new model gives nearly the same depth everywhere
        for weight in model.parameters():
            if weight.ndim > 1:
                weight.mul_(2)
    generator = torch.Generator().manual_seed(0)
    pixels = torch.rand(2, 3, 64, 64, generator=generator)
    photo = (255 * torch.rand(90, 200, 3, generator=generator)).byte().numpy()
    with torch.no_grad():
        seen = {
            "depth": model(pixels, domain=torch.tensor([0, 1])).depth.numpy(),
            "training": model.train()(pixels).depth.numpy(),
        }
    found = Predictor(model.eval())(photo)
    scores = np.array([*found.domain_probability.values()])
    return seen | {"photo": found.depth, "domain": sorted(found.domain_probability), "scores": scores}


def differ(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return any(
        not np.allclose(one[key], other[key], rtol=1e-5, atol=1e-6)
        if isinstance(one[key], np.ndarray)
        else one[key] != other[key]
        for key in one
    )


@EVERY_FIELD
def test_every_field_changes_shapes_or_outputs_or_is_refused(kind: type, name: str, tiny_config: ModelConfig):
    """A field without an entry in CHANGES fails here: a new field must say what it does."""
    value, needed = CHANGES[kind][name]
    base = tiny_config
    for part, values in needed.items():
        for field, needed_value in values.items():
            base = with_value(base, part, field, needed_value)
    try:
        changed = with_value(base, kind, name, value)
    except InputError:
        return  # it does not go with the rest
    if shapes(base) != shapes(changed):
        return
    first = outputs(base)
    assert not differ(first, outputs(base)), "the same config gives the same outputs"
    assert differ(first, outputs(changed))


def test_no_change_is_listed_for_a_field_that_is_gone():
    assert {(kind, name) for kind, changes in CHANGES.items() for name in changes} == set(FIELDS)


# --- to and from JSON -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PRESETS)
def test_presets_survive_json(name: str):
    config = PRESETS[name]
    assert from_dict(ModelConfig, json.loads(json.dumps(to_dict(config)))) == config


def test_what_comes_from_json_is_hashable_and_frozen(tiny_config: ModelConfig):
    config = from_dict(ModelConfig, json.loads(json.dumps(to_dict(tiny_config))))
    assert hash(config) == hash(tiny_config)
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.antialias = True


PATHS = {
    EncoderConfig: ["encoder"],
    DecoderConfig: ["decoder"],
    AttractorConfig: ["head"],
    RouterConfig: ["router"],
    Domain: ["domains", 1],
    ModelConfig: [],
}


def at(values: dict[str, Any], kind: type) -> dict[str, Any]:
    """The part of a config's dict that belongs to ``kind``."""
    for key in PATHS[kind]:
        values = values[key]
    return values


@pytest.fixture
def values(tiny_config: ModelConfig) -> dict[str, Any]:
    """The tiny config as it is read from a file."""
    return json.loads(json.dumps(to_dict(tiny_config)))


@EVERY_FIELD
@pytest.mark.parametrize(
    "wrong", [{"an": "object"}, 3.5, "words", [], True], ids=["object", "number", "text", "list", "bool"]
)
def test_wrong_type_is_an_error_that_names_the_field(kind: type, name: str, wrong: Any, values: dict[str, Any]):
    part = at(values, kind)
    if type(part[name]) is type(wrong):
        wrong = {"an": "object"}
    part[name] = wrong
    with pytest.raises(InputError, match=name):
        from_dict(ModelConfig, values)


REQUIRED = [
    (ModelConfig, "encoder"),
    (EncoderConfig, "name"),
    (EncoderConfig, "family"),
    (EncoderConfig, "size"),
    (EncoderConfig, "taps"),  # by BEiT
    (EncoderConfig, "channels"),
    (Domain, "name"),
]


@EVERY_FIELD
def test_missing_field_takes_its_default_or_is_an_error_that_names_it(kind: type, name: str, values: dict[str, Any]):
    """A field that a later version adds is missing in the files of before."""
    del at(values, kind)[name]
    if (kind, name) in REQUIRED:
        with pytest.raises(InputError, match=name):
            from_dict(ModelConfig, values)
    else:
        field = next(field for field in dataclasses.fields(kind) if field.name == name)
        default = field.default if field.default is not dataclasses.MISSING else field.default_factory()
        found = to_dict(from_dict(ModelConfig, values))
        expected = to_dict(default) if dataclasses.is_dataclass(default) else default
        if name == "domains":
            expected = tuple(to_dict(domain) for domain in default)
        assert at(found, kind)[name] == expected


@pytest.mark.parametrize("kind", CONFIGS)
def test_unknown_field_is_an_error_that_names_it_and_the_known_ones(kind: type, values: dict[str, Any]):
    at(values, kind)["temprature"] = 1.0
    known = dataclasses.fields(kind)[0].name
    with pytest.raises(InputError, match=rf"temprature.*{known}"):
        from_dict(ModelConfig, values)


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (AttractorConfig, "n_attractors", [16, 8, 4]),
        (AttractorConfig, "n_attractors", [16, 8, 4, 1.5]),
        (AttractorConfig, "n_bins", True),
        (AttractorConfig, "n_bins", 64.0),
        (AttractorConfig, "kind", "quadratic"),
        (AttractorConfig, "alpha", "300"),
        (AttractorConfig, "alpha", None),
        (DecoderConfig, "output_stride", 4),
        (DecoderConfig, "output_stride", True),
        (EncoderConfig, "size", [64, 64, 64]),
        (EncoderConfig, "taps", [0, 1, 2, "3"]),
        (RouterConfig, "kind", "magic"),
        (Domain, "max_depth", "far"),
        (ModelConfig, "domains", "indoor"),
        (ModelConfig, "head", None),
    ],
)
def test_value_that_almost_fits_is_an_error_that_names_the_field(
    kind: type, name: str, value: Any, values: dict[str, Any]
):
    at(values, kind)[name] = value
    with pytest.raises(InputError, match=name):
        from_dict(ModelConfig, values)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("values", [None, [], "zoed-lite", 3])
def test_config_that_is_no_object_is_an_error(values: Any):
    with pytest.raises(InputError, match="ModelConfig"):
        from_dict(ModelConfig, values)


def test_error_says_which_config_and_which_of_the_domains(values: dict[str, Any]):
    values["domains"][1]["max_depth"] = "far"
    with pytest.raises(InputError, match=r"config of a\.safetensors\.domains\[1\]\.max_depth"):
        from_dict(ModelConfig, values, where="config of a.safetensors")


def test_whole_numbers_are_taken_for_floats(values: dict[str, Any]):
    values["head"]["alpha"] = 300
    alpha = from_dict(ModelConfig, values).head.alpha
    assert alpha == 300
    assert isinstance(alpha, float)


# --- several kinds of config in one place -----------------------------------------------------------------------------


@pytest.mark.parametrize("head", [kind() for kind in HEAD_CONFIGS.values()], ids=list(HEAD_CONFIGS))
def test_every_head_survives_json(tiny_config: ModelConfig, head: HeadConfig):
    config = replace(tiny_config, head=head)
    read = model_config_from_dict(json.loads(json.dumps(to_dict(config))))
    assert read == config
    assert type(read.head) is type(head)


@pytest.mark.parametrize("network", [kind() for kind in NETWORK_CONFIGS.values()], ids=list(NETWORK_CONFIGS))
def test_every_baseline_survives_json(network: NetworkConfig):
    config = BaselineConfig(network, domains=(zoedepth.config.OUTDOOR,), size=(352, 704))
    read = model_config_from_dict(json.loads(json.dumps(to_dict(config))))
    assert read == config
    assert type(read.network) is type(network)


def test_files_without_types_are_of_zoedepth_with_attractors(values: dict[str, Any], tiny_config: ModelConfig):
    """Before there were other kinds, no file said which it is."""
    del values["type"], values["head"]["type"]
    assert model_config_from_dict(values) == tiny_config


@pytest.mark.parametrize("wrong", ["transformer", "adabins-2", None, 3, ["dorn"]])
def test_unknown_type_of_head_is_an_error_that_lists_the_known(values: dict[str, Any], wrong: Any):
    values["head"]["type"] = wrong
    with pytest.raises(InputError, match=r"config\.head\.type must be one of \['attractor', 'splitter'.*'bts'\]"):
        model_config_from_dict(values)


def test_fields_of_another_head_are_an_error_that_names_them(values: dict[str, Any]):
    values["head"] = {"type": "dorn", "n_bins": 64}
    with pytest.raises(InputError, match=r"config\.head has unknown fields \['n_bins'\]; DornConfig has"):
        model_config_from_dict(values)


def test_baseline_has_one_domain_and_a_size_its_network_takes():
    with pytest.raises(InputError, match="domains must be one"):
        BaselineConfig(BtsNetworkConfig(), domains=(zoedepth.config.INDOOR, zoedepth.config.OUTDOOR))
    with pytest.raises(InputError, match="multiples of 32"):
        BaselineConfig(BtsNetworkConfig(), size=(257, 353))
    dorn = BaselineConfig(DornNetworkConfig(), size=(257, 353))
    assert dorn.one_size
    assert not dorn.keep_aspect_ratio
    assert BaselineConfig(BtsNetworkConfig()).keep_aspect_ratio


def test_dorn_has_no_mixture_of_heads(tiny_config: ModelConfig):
    with pytest.raises(InputError, match=r"router\.kind must be .*DORN"):
        replace(tiny_config, head=DornConfig(), router=RouterConfig("auto"))


# --- values that make no sense ----------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        (AttractorConfig, {"n_bins": 1}),
        (AttractorConfig, {"n_attractors": (16, 8, 4)}),
        (AttractorConfig, {"n_attractors": (16, 8, 4, 0)}),
        (AttractorConfig, {"min_temperature": -0.1}),
        (AttractorConfig, {"min_temperature": 50.0}),
        (AttractorConfig, {"centers": "normed", "initial_centers": "geometric"}),
        (Domain, {"name": ""}),
        (Domain, {"min_depth": 0.0}),
        (Domain, {"min_depth": 10.0}),
        (Domain, {"max_depth": float("nan")}),
    ],
)
def test_values_out_of_range_are_an_error_that_names_them(kind: type, changes: dict[str, Any]):
    base = {"name": "indoor"} if kind is Domain else {}
    with pytest.raises(InputError, match="domain" if kind is Domain else list(changes)[-1]):
        kind(**base | changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"domains": (zoedepth.config.INDOOR, zoedepth.config.INDOOR)}, "different names"),
        ({"size": (64, 48)}, "multiples of 32"),
        ({"size": (0, 64)}, "multiples of 32"),
        ({"size": (320_000, 320_000)}, "multiples of 32 up to 8192"),
        ({"encoder": SWIN, "size": (64, 96)}, r"\(64, 64\), the only one swinv2_tiny_window16_256 takes"),
    ],
)
def test_models_that_cannot_be_are_errors(tiny_config: ModelConfig, changes: dict[str, Any], message: str):
    with pytest.raises(InputError, match=message):
        replace(tiny_config, **changes)


def test_only_swin_has_a_fixed_size():
    fixed = {name for name, config in PRESETS.items() if not config.keep_aspect_ratio}
    assert fixed == {name for name in PRESETS if "swin" in name}
    assert len(fixed) == 4
