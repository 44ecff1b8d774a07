"""MiDaS: the encoder and decoder of a ZoeDepth."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tests.weights.layouts.layouts import released, same, tiny

from zoedepth.errors import InputError
from zoedepth.weights.checkpoint import read_checkpoint
from zoedepth.weights.fit import model_of
from zoedepth.weights.layouts import midas, original
from zoedepth.weights.load import load_model


def cut(weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The MiDaS in a state dict of the original."""
    return {
        name.removeprefix(original.CORE): value for name, value in weights.items() if name.startswith(original.CORE)
    }


@pytest.fixture
def file(tmp_path: Path) -> Path:
    torch.save(cut(original.write(tiny().config, tiny().weights)), tmp_path / "midas.pt")
    return tmp_path / "midas.pt"


@torch.no_grad()
def test_relative_depth_is_that_of_the_zoedepth_it_was_cut_from(file: Path):
    model, whole = load_model(file), model_of(tiny(), source="twin")
    pixels = torch.rand(2, 3, 64, 96, generator=torch.Generator().manual_seed(0))
    relative = model.relative(pixels)
    torch.testing.assert_close(relative, whole.relative(pixels), rtol=1e-5, atol=1e-5)
    assert relative.std() > 1e-3, "a constant proves nothing"


@torch.no_grad()
def test_model_has_no_domains_and_says_that_it_gives_relative_depth_only(file: Path):
    model = load_model(file)
    assert model.config == replace(model.config, domains=(), size=(64, 64), encoder=tiny().config.encoder)
    assert not any(name.startswith(("shared.", "router.", "heads.")) for name in model.state_dict())
    with pytest.raises(InputError, match="relative depth only"):
        model(torch.rand(1, 3, 64, 64))


def test_weights_are_those_of_the_file(file: Path):
    checkpoint = read_checkpoint(file)
    assert checkpoint.layout == "midas"
    assert same(
        checkpoint.weights,
        {name: value for name, value in tiny().weights.items() if name.startswith(("encoder.", "decoder."))},
    )
    assert checkpoint.name_in_file("decoder.fusion.3.project.bias") == "scratch.refinenet1.out_conv.bias"


def test_every_released_name_is_used_but_for_a_known_few():
    theirs = cut(released("original-n"))
    _, ours, table = midas.read(theirs)
    assert theirs.keys() - {name for our in ours for name in table.theirs(our)} == {
        "pretrained.model.fc_norm.weight",
        "pretrained.model.fc_norm.bias",
        "pretrained.model.head.weight",
        "pretrained.model.head.bias",
        *(
            f"scratch.refinenet4.resConfUnit1.{conv}.{kind}"
            for conv in ("conv1", "conv2")
            for kind in ("weight", "bias")
        ),
    }


@pytest.mark.parametrize(
    "name",
    ["pretrained.model.layers.0.blocks.0.norm1.weight", "pretrained.layer1.0.weight", "scratch.output_conv.6.bias"],
    ids=["swin", "resnext", "other-head"],
)
def test_other_networks_of_midas_are_refused_by_the_names_of_their_weights(name: str):
    with pytest.raises(InputError, match=f"unknown weights: '{name}'"):
        midas.read(cut(released("original-n")) | {name: torch.empty(1)})
