import pickle
from dataclasses import replace

import pytest
import torch
from tests.weights.layouts.layouts import released, tiny

from zoedepth.build import without_memory
from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import ENCODERS, PRESETS
from zoedepth.weights.layouts import huggingface, midas, original, shapes
from zoedepth.weights.layouts.shapes import WeightError

Weights = dict[str, torch.Tensor]


def meta(*shape: int) -> torch.Tensor:
    return torch.empty(shape, device="meta")


def of_preset(config: ModelConfig) -> Weights:
    """Weights of a model under our names, without values."""
    with without_memory():
        return ZoeDepth(config).state_dict()


# --- released sizes ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["n", "k", "nk"])
def test_names_and_shapes_of_the_original_tell_the_preset(kind: str):
    config, _, _ = original.read(released(f"original-{kind}"))
    assert config == PRESETS[f"zoed-m12-{kind}"]


@pytest.mark.parametrize("layout", [4, 5])
@pytest.mark.parametrize("kind", ["n", "nk"])
def test_names_and_shapes_of_transformers_tell_the_preset(kind: str, layout: int):
    """Without a config.json."""
    weights = released(f"huggingface-{kind}")
    assert huggingface.layout_of(weights) == 5
    if layout == 4:
        heads = ("nyu", "kitti") if kind == "nk" else ("nyu",)
        ours = huggingface.table(heads, layout=5).to_ours(weights)
        weights = huggingface.table(heads, layout=4).to_theirs(ours)
        assert huggingface.layout_of(weights) == 4
        assert "backbone.encoder.layer.23.attention.attention.query.weight" in weights
    config, _, _ = huggingface.read(weights, None, layout=layout)
    assert config == PRESETS[f"zoed-m12-{kind}"]


def test_names_and_shapes_of_midas_tell_the_preset():
    core = original.CORE
    weights = {name.removeprefix(core): value for name, value in released("original-n").items() if core in name}
    assert "scratch.output_conv.4.weight" in weights
    config, ours, _ = midas.read(weights)
    assert config == PRESETS["dpt-beit-large-384"]
    assert {name: value.shape for name, value in ours.items()} == {
        name: value.shape for name, value in of_preset(config).items()
    }


@pytest.mark.parametrize("name", [name for name, encoder in ENCODERS.items() if encoder.family == "beit"])
def test_released_encoders_are_known_by_name(name: str):
    encoder = ENCODERS[name]
    weights = of_preset(replace(PRESETS["zoed-m12-n"], encoder=encoder))
    assert shapes.beit(weights) == encoder


# --- other sizes ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["n", "k", "nk"])
def test_config_told_by_any_shapes_makes_a_model_of_them(kind: str):
    config, weights, *_ = tiny(kind)
    told = original.config_of(weights)
    assert told == replace(config, size=told.size)
    assert {name: value.shape for name, value in of_preset(told).items()} == {
        name: value.shape for name, value in weights.items()
    }


def test_hidden_channels_of_the_blocks_are_read():
    config, weights, *_ = tiny()
    width = config.encoder.width
    changed = weights | {"encoder.network.blocks.0.mlp.fc1.weight": meta(80, width)}
    assert shapes.beit(changed) == replace(config.encoder, mlp_width=80)


def test_large_encoder_of_other_hidden_channels_is_no_released_one():
    weights = of_preset(PRESETS["dpt-beit-large-384"]) | {"encoder.network.blocks.0.mlp.fc1.weight": meta(2048, 1024)}
    encoder = shapes.beit(weights)
    assert (encoder.width, encoder.depth, encoder.heads, encoder.mlp_width) == (1024, (24,), (16,), 2048)
    assert (encoder.size, encoder.taps) == ((384, 384), (5, 11, 17, 23))


def test_size_and_taps_that_are_given_are_believed():
    _, weights, *_ = tiny()
    encoder = shapes.beit(weights, native=(32, 112), taps=(0, 1, 2, 3))
    assert encoder.size == (32, 112)
    assert shapes.beit(weights, taps=(0, 1, 2, 3)) == tiny().config.encoder


@pytest.mark.parametrize(("n_blocks", "taps"), [(4, (0, 1, 2, 3)), (8, (1, 3, 5, 7)), (12, (2, 5, 8, 11))])
def test_taps_end_the_quarters(n_blocks: int, taps: tuple[int, ...]):
    weights = dict(tiny().weights)
    weights |= {f"encoder.network.position_tables.{i}": meta(52, 4) for i in range(n_blocks)}
    assert shapes.beit(weights).taps == taps


def test_pairs_of_points_count_as_one():
    head = shapes.head(tiny("k").weights, centers="normed")
    assert (head.centers, head.n_attractors, head.attractor_ratio) == ("normed", (16, 8, 4, 1), False)


@pytest.mark.parametrize(("inputs", "hidden", "factor"), [(137, 68, 2), (137, 137, 1), (136, 34, 4)])
def test_bottleneck_factor_and_relative_input_are_read(inputs: int, hidden: int, factor: int):
    changed = tiny().weights | {"heads.0.probability.mlp.0.weight": meta(hidden, inputs, 1, 1)}
    head = shapes.head(changed, centers="softplus")
    assert (head.bottleneck_factor, head.relative_input) == (factor, inputs == 137)


# --- errors -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_rows", [1, 3, 4 + 1, 7 * 9 + 3, 8 * 8 + 3], ids=str)
def test_tables_of_no_square_are_refused(n_rows: int):
    """A square grid of side n has (2 n - 1)² distances, an odd square."""
    changed = tiny().weights | {"encoder.network.position_tables.0": meta(n_rows, 4)}
    with pytest.raises(InputError, match=f"position tables of {n_rows} rows .* a config is needed"):
        shapes.beit(changed)


@pytest.mark.parametrize("n_blocks", [1, 2, 3, 5, 6, 7, 9])
def test_blocks_without_quarters_are_refused(n_blocks: int):
    tables = "encoder.network.position_tables."
    weights = {name: value for name, value in tiny().weights.items() if not name.startswith(tables)}
    weights |= {f"{tables}{i}": meta(52, 4) for i in range(n_blocks)}
    with pytest.raises(InputError, match=f"{n_blocks} encoder blocks have no four quarters"):
        shapes.beit(weights)


def test_odd_channels_of_pairs_are_refused():
    with pytest.raises(InputError, match=r"normed attractors come in pairs; the layers give \(16, 8, 4, 1\)"):
        shapes.head(tiny("n").weights, centers="normed")


@pytest.mark.parametrize(("hidden", "inputs"), [(68, 135), (68, 138), (138, 137)])
def test_probabilities_that_fit_no_input_are_refused(hidden: int, inputs: int):
    changed = tiny().weights | {"heads.0.probability.mlp.0.weight": meta(hidden, inputs, 1, 1)}
    with pytest.raises(WeightError, match=rf"heads.0.probability.mlp.0.weight takes {inputs} channels to {hidden}"):
        shapes.head(changed, centers="softplus")


NEEDED = [
    "encoder.network.position_tables.0", "encoder.network.cls_token", "encoder.network.blocks.0.mlp.fc1.weight",
    "decoder.reassemble.3.project.weight", "decoder.project.2.weight", "decoder.relative_head.conv2.weight",
    "heads.0.attractors.1.mlp.2.weight", "heads.0.probability.mlp.0.weight", "heads.0.seed.2.weight",
    "shared.seed.2.weight", "router.classifier.project.weight", "router.classifier.transformer.layers.0.linear1.weight",
]  # fmt: skip


@pytest.mark.parametrize("name", NEEDED)
def test_missing_weight_is_named(name: str):
    weights = {other: value for other, value in tiny("nk").weights.items() if other != name}
    with pytest.raises(WeightError, match=f"^{name} is missing$"):
        original.config_of(weights)


@pytest.mark.parametrize("shape", [(), (5,), (0, 4, 4, 4), (1, 2, 3, 4, 5)], ids=str)
@pytest.mark.parametrize("name", NEEDED)
def test_weight_of_a_wrong_number_of_axes_is_named(name: str, shape: tuple[int, ...]):
    with pytest.raises(WeightError, match=f"^{name} has the shape"):
        original.config_of(tiny("nk").weights | {name: meta(*shape)})


def test_errors_name_weights_as_the_file_does():
    weights = released("original-n")
    del weights["seed_projector._net.2.weight"]
    with pytest.raises(WeightError, match=r"^seed_projector._net.2.weight is missing$"):
        original.read(weights)
    weights = released("huggingface-n")
    for part in ("position_bias_table", "position_index"):
        weights.pop(f"backbone.beit.layers.0.relative_position_bias.relative_{part}", None)
    with pytest.raises(WeightError, match=r"^backbone.beit.layers.0.relative_position_bias.relative_position_bias_t"):
        huggingface.read(weights, None, layout=5)
    with pytest.raises(WeightError, match=r"^pretrained.model.cls_token is missing$"):
        midas.read({"pretrained.model.blocks.0.attn.relative_position_bias_table": meta(52, 4)})


def test_weight_error_survives_the_way_between_processes():
    error = pickle.loads(pickle.dumps(WeightError("a", "is missing")))
    assert (error.name, error.problem, str(error)) == ("a", "is missing", "a is missing")
