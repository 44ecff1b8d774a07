"""The names in the released files (``keys/original-*.txt``) against ours, without their values."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from tests.weights.layouts.layouts import released, same, tiny

from zoedepth.build import without_memory
from zoedepth.config import INDOOR, OUTDOOR, Domain, ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.beit import relative_position_index
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import PRESETS
from zoedepth.weights.fit import model_of
from zoedepth.weights.layouts import original
from zoedepth.weights.save import checkpoint_of

KINDS = pytest.mark.parametrize("kind", ["n", "k", "nk"])
MODEL = "core.core.pretrained.model"
NO_FORWARD_READS = {
    f"{MODEL}.fc_norm.weight", f"{MODEL}.fc_norm.bias", f"{MODEL}.head.weight", f"{MODEL}.head.bias",
    *(f"core.core.scratch.refinenet4.resConfUnit1.{conv}.{part}" for conv in ("conv1", "conv2")
      for part in ("weight", "bias")),
}  # fmt: skip


def indices(n_blocks: int) -> set[str]:
    """Saved by timm before 0.9.6, which the released files were made with; later ones compute them."""
    return {f"{MODEL}.blocks.{i}.attn.relative_position_index" for i in range(n_blocks)}


def constants(kind: str) -> set[str]:
    """Buffers of the log-binomial, which are the same in all files."""
    heads = ["nyu.", "kitti."] if kind == "nk" else [""]
    transforms = [f"conditional_log_binomial.{head}log_binomial_transform" for head in heads]
    return {f"{transform}.{name}" for transform in transforms for name in ("k_idx", "K_minus_1")}


def shapes_and_types(weights: dict[str, torch.Tensor]) -> dict[str, tuple]:
    return {name: (tuple(value.shape), value.dtype) for name, value in weights.items()}


# --- released names ---------------------------------------------------------------------------------------------------


@KINDS
@pytest.mark.parametrize("with_indices", [False, True], ids=["", "with-indices"])
def test_every_name_is_used_but_for_a_known_few(kind: str, with_indices: bool):
    theirs = released(f"original-{kind}")
    if with_indices:
        theirs |= {name: torch.empty(577, 577, dtype=torch.int64, device="meta") for name in indices(24)}
    _, ours, table = original.read(theirs)
    used = {name for our in ours for name in table.theirs(our)}
    assert used <= theirs.keys()
    assert theirs.keys() - used == NO_FORWARD_READS | constants(kind) | (indices(24) if with_indices else set())
    assert len(used) == len(ours)


@KINDS
def test_the_rest_is_exactly_the_model(kind: str):
    _, ours, _ = original.read(released(f"original-{kind}"))
    with without_memory():
        model = ZoeDepth(PRESETS[f"zoed-m12-{kind}"])
    assert shapes_and_types(ours) == shapes_and_types(model.state_dict())


@KINDS
def test_written_names_shapes_and_types_are_those_of_the_released_file(kind: str):
    """The original loads strictly."""
    theirs = released(f"original-{kind}")
    config, ours, _ = original.read(theirs)
    index = ((577, 577), torch.int64)
    assert shapes_and_types(original.write(config, ours)) == shapes_and_types(theirs) | dict.fromkeys(
        indices(24), index
    )


def test_fusion_goes_from_coarse_to_fine_and_heads_go_by_name():
    weights = tiny("nk").weights
    theirs = original.table(("indoor", "outdoor")).to_theirs(weights)
    pairs = {
        "core.core.scratch.refinenet1.resConfUnit2.conv1.bias": "decoder.fusion.3.refine.conv1.bias",
        "core.core.scratch.refinenet4.resConfUnit2.conv1.bias": "decoder.fusion.0.refine.conv1.bias",
        "core.core.scratch.layer1_rn.weight": "decoder.project.0.weight",
        "seed_bin_regressors.nyu._net.0.weight": "heads.0.seed.0.weight",
        "seed_bin_regressors.kitti._net.0.weight": "heads.1.seed.0.weight",
    }
    assert all(theirs[name] is weights[ours] for name, ours in pairs.items())


def test_layout_is_told_by_its_names():
    assert original.is_original(released("original-n"))
    assert not original.is_original(released("huggingface-n"))
    assert not original.is_original(tiny().weights)


# --- there and back ---------------------------------------------------------------------------------------------------


@KINDS
def test_model_that_was_written_is_read_again(kind: str):
    config, weights, *_ = tiny(kind)
    again, ours, _ = original.read(original.write(config, weights))
    assert again == replace(config, size=PRESETS[f"zoed-m12-{kind}"].size)
    assert same(ours, weights)


@KINDS
def test_what_no_forward_reads_is_made_up(kind: str):
    config, weights, *_ = tiny(kind)
    theirs = original.write(config, weights)
    table = original.table(tuple(domain.name for domain in config.domains))
    added = {name: value for name, value in theirs.items() if name not in table.to_theirs(weights)}
    assert added.keys() == NO_FORWARD_READS | constants(kind) | indices(4)
    for name in constants(kind):
        expected = torch.arange(64) if name.endswith("k_idx") else torch.tensor([63.0])
        assert torch.equal(added[name], expected.view(1, -1, 1, 1))
    for name in indices(4):
        assert torch.equal(added[name], published_index(4, 4))
    assert all(added[name].isfinite().all() for name in NO_FORWARD_READS)


def published_index(height: int, width: int) -> torch.Tensor:
    """Of BEiT's ``RelativePositionBias.__init__``, token by token."""
    n_rows = (2 * height - 1) * (2 * width - 1) + 3
    index = torch.zeros(height * width + 1, height * width + 1, dtype=torch.int64)
    for y in range(height):
        for x in range(width):
            for other_y in range(height):
                for other_x in range(width):
                    row = (y - other_y + height - 1) * (2 * width - 1) + x - other_x + width - 1
                    index[1 + y * width + x, 1 + other_y * width + other_x] = row
    index[0, 0:] = n_rows - 3
    index[0:, 0] = n_rows - 2
    index[0, 0] = n_rows - 1
    return index


@pytest.mark.parametrize("grid", [(3, 2), (1, 4), (4, 4)], ids=str)
def test_position_index_is_the_published_one(grid: tuple[int, int]):
    assert torch.equal(relative_position_index(grid), published_index(*grid))


# --- refusals ---------------------------------------------------------------------------------------------------------


def changed(config: ModelConfig, changes: dict[str, Any]) -> ModelConfig:
    """A config with values put at names like "head.alpha"."""
    for name, value in changes.items():
        part, _, field = name.rpartition(".")
        config = replace(config, **{part: replace(getattr(config, part), **{field: value})} if part else {field: value})
    return config


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("n", {"head.kind": "exponential"}, "kind 'exponential'"),
    ("n", {"head.probability": "softmax"}, "probability 'softmax'"),
    ("n", {"head.alpha": 1.0}, "alpha 1.0"),
    ("n", {"head.gamma": 1.0}, "gamma 1.0"),
    ("n", {"head.reduce": "sum"}, "kind cannot be told"),
    ("n", {"head.max_temperature": 5.0}, "kind cannot be told"),
    ("n", {"head.n_attractors": (16, 8, 4, 2)}, "kind cannot be told"),
    ("n", {"head.relative_input": False}, "relative input False"),
    ("n", {"head.bottleneck_factor": 4}, "bottleneck factor 4"),
    ("n", {"head.projector_width": 64}, "projector_width 64"),
    ("n", {"head.seed_width": 64}, "seed_width 64"),
    ("n", {"head.embedding_width": 64}, "embedding_width 64"),
    ("n", {"decoder.output_stride": 2}, "output stride 2"),
    ("n", {"decoder.widths": (16, 16, 16, 8)}, "decoder widths 2"),
    ("n", {"encoder.taps": (0, 1, 2, 4)}, "size or taps cannot be told"),
    ("n", {"encoder.size": (32, 112)}, "size or taps cannot be told"),
    ("n", {"antialias": True}, "antialias True"),
    ("n", {"resize": "squeeze"}, "squeezed .*--compat squeeze"),
    ("n", {"pad": False}, "not padded"),
    ("nk", {"router.vote": "batch"}, "vote of the batch.*--compat batch-vote"),
    ("n", {"domains": ()}, "number of domains 0"),
    ("k", {"head.attractor_ratio": True}, "attractor ratio True"),
    ("k", {"domains": (replace(OUTDOOR, max_depth=10.0),)}, r"a depth range of \(0.001, 10.0\) m .* 80.0"),
    ("k", {"domains": (replace(OUTDOOR, min_depth=0.1),)}, r"a depth range of \(0.1, 80.0\) m"),
    ("nk", {"router.classifier": "mlp"}, "router 'mlp'"),
    ("nk", {"router.kind": "labeled"}, "router False"),
    ("nk", {"router.attention_heads": 8}, "attention heads 8"),
    ("nk", {"router.feedforward_width": 512}, "MLP 512"),
    ("nk", {"router.width": 64}, "router.width 64"),
    ("nk", {"head.n_attractors": (16, 8, 4, 1)}, "n_attractors"),
    ("nk", {"head.relative_input": True}, "relative input True"),
    ("nk", {"domains": (INDOOR, Domain("forest"))}, r"domains \('indoor', 'forest'\)"),
    ("nk", {"domains": (OUTDOOR, INDOOR)}, r"domains \('outdoor', 'indoor'\)"),
    ("nk", {"domains": (INDOOR, OUTDOOR, Domain("forest"))}, "number of domains 3"),
]


@pytest.mark.parametrize(("kind", "changes", "message"), REFUSED, ids=lambda x: str(x)[:40])
def test_model_that_the_original_has_not_is_refused(kind: str, changes: dict[str, Any], message: str):
    config, weights, *_ = tiny(kind)
    with pytest.raises(InputError, match=f"the original ZoeDepth has no such model: .*{message}"):
        original.write(changed(config, changes), weights)


def test_zoed_lite_is_refused_with_all_reasons():
    with pytest.raises(InputError) as caught:
        original.write(PRESETS["zoed-lite"], {})
    for reason in ("encoder family 'convolutional'", "output stride 2", "alpha 1.0", "router 'mlp'", "antialias True"):
        assert reason in str(caught.value)


def test_points_that_would_be_taken_for_pairs_are_refused():
    """Twice as many points as ZoeD-K's pairs: read again, they would be fractions and not metres."""
    config = changed(tiny().config, {"head.n_attractors": (32, 16, 8, 2)})
    model = ZoeDepth(config)
    with pytest.raises(InputError, match="kind cannot be told"):
        original.write(config, checkpoint_of(model).weights)


# --- damage -----------------------------------------------------------------------------------------------------------


def test_unknown_weights_are_named():
    weights = released("original-n") | {"core.core.scratch.refinenet5.out_conv.bias": torch.empty(1)}
    with pytest.raises(InputError, match=r"unknown weights: 'core.core.scratch.refinenet5.out_conv.bias'$"):
        original.read(weights)


@pytest.mark.parametrize("shift", ["missing", "misshapen"])
def test_weights_that_do_not_fit_are_called_as_in_the_file(shift: str):
    config, weights, *_ = tiny()
    theirs = original.write(config, weights)
    name = "core.core.scratch.refinenet2.out_conv.weight"
    if shift == "missing":
        del theirs[name]
    else:
        theirs[name] = torch.zeros(3)
    config, ours, table = original.read(theirs)
    checkpoint = tiny()._replace(config=config, weights=ours, name_in_file=lambda our: "/".join(table.theirs(our)))
    with pytest.raises(InputError, match=f"{shift} {name}"):
        model_of(checkpoint, source="x.pt")
