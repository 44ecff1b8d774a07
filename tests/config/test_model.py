"""Every field of a ZoeDepth's config does something, and values that make no sense are errors."""

import dataclasses
import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from tests.models import random_model

from zoedepth.build import without_memory
from zoedepth.config import (
    INDOOR,
    OUTDOOR,
    AttractorConfig,
    BaselineConfig,
    BtsNetworkConfig,
    DecoderConfig,
    Domain,
    DornConfig,
    DornNetworkConfig,
    EncoderConfig,
    ModelConfig,
    RouterConfig,
    network_alone,
)
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.presets import PRESETS

CONFIGS = [EncoderConfig, DecoderConfig, RouterConfig, Domain, ModelConfig]
"""The parts of a ZoeDepth but the head: what its fields do is tested with the heads."""
FIELDS = [(config, field.name) for config in CONFIGS for field in dataclasses.fields(config)]
IDS = [f"{config.__name__}.{name}" for config, name in FIELDS]

SWIN = EncoderConfig(
    "swinv2_tiny_window16_256", "swin", size=(64, 64), width=24, depth=(1, 1, 2, 1), heads=(1, 2, 4, 8)
)
NORMED = {"head": {"centers": "normed"}}
"""The field matters for normed centers only."""
TRANSFORMER = {"router": {"classifier": "transformer"}}

# For every field, a value it does not have in the tiny config, and what the tiny config must be for it to matter.
CHANGES: dict[type, dict[str, tuple[Any, dict[str, Any]]]] = {
    EncoderConfig: {
        "name": ("beit_large_patch16_384", {}),  # starts with other layer scales
        "family": ("convolutional", {}),
        "size": ((96, 96), {}),
        "taps": ((0, 1, 2, 4), {"encoder": {"depth": (5,)}}),
        "channels": ((8, 16, 16, 24), {}),
        "width": (64, {}),
        "depth": ((1, 1, 1, 1), {"encoder": SWIN}),
        "heads": ((2,), {}),
        "mlp_width": (96, {}),
    },
    DecoderConfig: {
        "widths": ((16, 16, 24, 16), {}),
        "features": (12, {}),
        "output_stride": (2, {}),
        "upsampling": ("convex", {"decoder": {"output_stride": 2}}),
    },
    RouterConfig: {
        "kind": ("auto", {}),
        "classifier": ("transformer", {}),
        "width": (32, {}),
        "attention_heads": (2, TRANSFORMER),
        "feedforward_width": (64, TRANSFORMER),
        "vote": ("batch", {}),
    },
    Domain: {
        "name": ("indoor cave", {}),
        "min_depth": (2.0, NORMED),
        "max_depth": (20.0, NORMED),
        "focal_px": (100.0, {}),
        "std_factor": (2.0, {}),
    },
    ModelConfig: {
        "encoder": (SWIN, {}),
        "decoder": (DecoderConfig(widths=(8, 8, 8, 8)), {}),
        "head": (AttractorConfig(n_bins=4), {}),
        "router": (RouterConfig("labeled"), {}),
        "domains": ((INDOOR,), {}),
        "size": ((96, 64), {}),
        "antialias": (True, {}),
        "resize": ("squeeze", {}),
        "pad": (False, {}),
        "canonical_camera": (True, {}),
    },
}
REFUSED = {
    (EncoderConfig, "family"): r"encoder\.taps must be 0 increasing numbers for convolutional",
    (ModelConfig, "canonical_camera"): r"canonical_camera needs the focal length .* \['indoor', 'outdoor'\] have none",
}
"""Changes that do not go with the rest of the config, and what the error says."""


def with_part(config: ModelConfig, part: str, changes: Any) -> ModelConfig:
    """The model config with another part, or some fields of it changed."""
    return replace(
        config, **{part: replace(getattr(config, part), **changes) if isinstance(changes, dict) else changes}
    )


def with_value(config: ModelConfig, kind: type, name: str, value: Any) -> ModelConfig:
    """The model config with one field of one of its parts changed; of the domains, the first."""
    if kind is ModelConfig:
        return replace(config, **{name: value})
    if kind is Domain:
        first, *others = config.domains
        return replace(config, domains=(replace(first, **{name: value}), *others))
    part = {EncoderConfig: "encoder", DecoderConfig: "decoder", RouterConfig: "router"}[kind]
    return with_part(config, part, {name: value})


@cache
def shapes(config: ModelConfig) -> dict[str, tuple[int, ...]]:
    with without_memory():
        return {name: tuple(value.shape) for name, value in ZoeDepth(config).state_dict().items()}


def outputs(config: ModelConfig) -> dict[str, Any]:
    """All that a user of the model sees: its answers in use, in training, and through the predictor."""
    model = random_model(config)
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
    first = Predictor(model, flip_average=False)(photo, domain=config.domains[0].name)
    seen |= {"std": first.std, "lens": np.array([first.camera.fx])}
    return seen | {"photo": found.depth, "domain": sorted(found.domain_probability), "scores": scores}


known_outputs = cache(outputs)


def differ(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return any(
        not np.allclose(one[key], other[key], rtol=1e-5, atol=1e-6)
        if isinstance(one[key], np.ndarray)
        else one[key] != other[key]
        for key in one
    )


@pytest.mark.parametrize(("kind", "name"), FIELDS, ids=IDS)
def test_every_field_changes_shapes_or_outputs_or_is_refused(kind: type, name: str, tiny_config: ModelConfig):
    """A field without an entry in CHANGES fails here: a new field must say what it does."""
    value, needed = CHANGES[kind][name]
    base = tiny_config
    for part, changes in needed.items():
        base = with_part(base, part, changes)
    if (kind, name) in REFUSED:
        with pytest.raises(InputError, match=REFUSED[kind, name]):
            with_value(base, kind, name, value)
        return
    changed = with_value(base, kind, name, value)
    if shapes(base) == shapes(changed):
        assert differ(known_outputs(base), outputs(changed))


def test_the_same_config_gives_the_same_outputs(tiny_config: ModelConfig):
    assert not differ(known_outputs(tiny_config), outputs(replace(tiny_config)))


def test_only_a_model_in_one_camera_corrects_what_a_photo_tells(tiny_config: ModelConfig):
    """The field that the test above cannot change alone."""
    known = replace(tiny_config, domains=(replace(INDOOR, focal_px=80.0),))
    photo = np.zeros((64, 64, 3), np.uint8)
    camera = Camera.from_focal(120.0, (64, 64), source="exif")
    plain, canonical = (
        Predictor(ZoeDepth(config).eval(), pad=False, flip_average=False)(photo, camera=camera)
        for config in (known, replace(known, canonical_camera=True))
        if torch.manual_seed(0)
    )
    np.testing.assert_allclose(canonical.depth, plain.depth * 1.5, rtol=1e-5)


def test_no_change_is_listed_for_a_field_that_is_gone():
    assert {(kind, name) for kind, changes in CHANGES.items() for name in changes} == set(FIELDS)


# --- values that make no sense ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("focal_px", [0.0, -5.0, math.inf, math.nan])
def test_focal_length_is_a_number_of_pixels(focal_px: float):
    with pytest.raises(InputError, match=r"domain\.focal_px must be a finite number of pixels > 0"):
        replace(INDOOR, focal_px=focal_px)


@pytest.mark.parametrize("std_factor", [0.0, -1.0, math.inf, math.nan])
def test_factor_on_the_standard_deviation_is_a_number_above_0(std_factor: float):
    with pytest.raises(InputError, match=r"domain\.std_factor must be a finite number > 0"):
        replace(INDOOR, std_factor=std_factor)


def test_same_network_in_another_camera_with_other_errors(tiny_config: ModelConfig):
    domains = tuple(replace(each, focal_px=80.0, std_factor=1.5) for each in tiny_config.domains)
    assert network_alone(replace(tiny_config, domains=domains, canonical_camera=True)) == tiny_config
    assert network_alone(replace(tiny_config, domains=domains[:1])) != tiny_config


@pytest.mark.parametrize(
    ("part", "changes", "message"),
    [
        ("encoder", {"taps": (0, 1, 2)}, r"encoder\.taps must be 4 increasing numbers for beit"),
        ("encoder", {"taps": (0, 2, 1, 3)}, r"encoder\.taps must be 4 increasing numbers"),
        ("encoder", {"taps": (0, 1, 1, 3)}, r"encoder\.taps must be 4 increasing numbers"),
        ("encoder", {"channels": (8, 16, 16)}, r"encoder\.channels must be 4 numbers for beit"),
        ("encoder", {"mlp_width": 96, "width": None}, r"encoder\.mlp_width is 96, .* Set encoder\.width too"),
        ("encoder", {"family": "swin"}, r"encoder\.taps must be 0"),
        (
            "router",
            {"kind": "labeled", "vote": "batch"},
            r"router\.vote must be 'image' where router\.kind is 'labeled'",
        ),
        ("router", {"kind": "auto", "vote": "batch"}, r"router\.vote must be 'image' where router\.kind is 'auto'"),
        ("router", TRANSFORMER["router"] | {"attention_heads": 3}, r"router\.attention_heads must be a divisor .* 16"),
        ("router", TRANSFORMER["router"] | {"attention_heads": 0}, r"router\.attention_heads must be a divisor .* 16"),
    ],
)
def test_parts_that_cannot_be_are_errors(tiny_config: ModelConfig, part: str, changes: Any, message: str):
    with pytest.raises(InputError, match=message):
        with_part(tiny_config, part, changes)


def test_hidden_width_of_the_mlps_is_for_beit():
    with pytest.raises(InputError, match=r"encoder\.mlp_width is 96, which only a BEiT"):
        replace(SWIN, mlp_width=96)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": ""}, r"domain\.name must be a name"),
        ({"min_depth": 0.0}, r"domain 'indoor' has a min_depth of 0\.0 .* Set them in metres"),
        ({"min_depth": 10.0}, r"domain 'indoor' has .* a max_depth of 10\.0"),
        ({"max_depth": float("nan")}, r"domain 'indoor' has .* a max_depth of nan"),
    ],
)
def test_domains_that_cannot_be_are_errors(changes: dict[str, Any], message: str):
    with pytest.raises(InputError, match=message):
        replace(INDOOR, **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"domains": (INDOOR, INDOOR)}, "names of domains must be all different"),
        ({"size": (64, 48)}, "multiples of 32"),
        ({"size": (0, 64)}, "multiples of 32"),
        ({"size": (320_000, 320_000)}, "multiples of 32 up to 8192"),
        ({"encoder": SWIN, "size": (64, 96)}, r"\(64, 64\), the only one that swinv2_tiny_window16_256 takes"),
        ({"head": DornConfig(), "router": RouterConfig("auto")}, r"router\.kind is 'auto'.* DORN"),
    ],
)
def test_models_that_cannot_be_are_errors(tiny_config: ModelConfig, changes: dict[str, Any], message: str):
    with pytest.raises(InputError, match=message):
        replace(tiny_config, **changes)


def test_one_domain_needs_no_mixture_of_dorns_heads(tiny_config: ModelConfig):
    config = replace(tiny_config, head=DornConfig(), router=RouterConfig("auto"), domains=(INDOOR,))
    assert config.router.kind == "auto"


def test_only_swin_has_a_fixed_size():
    fixed = {name for name, config in PRESETS.items() if not config.keep_aspect_ratio}
    assert fixed == {name for name in PRESETS if "swin" in name}
    assert len(fixed) == 4


def test_baseline_has_one_domain_and_a_size_its_network_takes():
    with pytest.raises(InputError, match="domains must be exactly one"):
        BaselineConfig(BtsNetworkConfig(), domains=(INDOOR, OUTDOOR))
    with pytest.raises(InputError, match="multiples of 32"):
        BaselineConfig(BtsNetworkConfig(), size=(257, 353))
    dorn = BaselineConfig(DornNetworkConfig(), size=(257, 353))
    assert dorn.one_size
    assert not dorn.keep_aspect_ratio
    assert BaselineConfig(BtsNetworkConfig()).keep_aspect_ratio
