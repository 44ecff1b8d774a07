import dataclasses
import json
from dataclasses import replace
from typing import Any

import pytest

import zoedepth.config
from zoedepth.config import (
    AttractorConfig,
    BaselineConfig,
    DecoderConfig,
    Domain,
    EncoderConfig,
    HeadConfig,
    ModelConfig,
    NetworkConfig,
    RouterConfig,
)
from zoedepth.config.baselines import NETWORK_CONFIGS
from zoedepth.config.codec import from_dict, model_config_from_dict, to_dict
from zoedepth.config.heads import HEAD_CONFIGS
from zoedepth.errors import InputError
from zoedepth.presets import BASELINES, PRESETS

CONFIGS = [EncoderConfig, DecoderConfig, AttractorConfig, RouterConfig, Domain, ModelConfig]
"""The parts of a ZoeDepth."""
FIELDS = [(config, field.name) for config in CONFIGS for field in dataclasses.fields(config)]
EVERY_FIELD = pytest.mark.parametrize(
    ("kind", "name"), FIELDS, ids=[f"{config.__name__}.{name}" for config, name in FIELDS]
)


def test_presets_survive_json():
    for name, config in {**PRESETS, **BASELINES}.items():
        assert model_config_from_dict(json.loads(json.dumps(to_dict(config)))) == config, name


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
    if type(part[name]) is type(wrong) or (name == "focal_px" and isinstance(wrong, float)):  # it is None there
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
    with pytest.raises(InputError, match=r"config\.head has unknown fields \['n_bins'\]\. DornConfig has"):
        model_config_from_dict(values)
