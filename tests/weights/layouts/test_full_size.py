"""The released checkpoints' own names and shapes: all three without values, the largest with random ones, narrower."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tests.weights.layouts import full_size
from tests.weights.layouts.layouts import released
from transformers import ZoeDepthConfig, ZoeDepthForDepthEstimation

from zoedepth.build import without_memory
from zoedepth.config import EncoderConfig
from zoedepth.presets import PRESETS
from zoedepth.weights.layouts import huggingface, huggingface_config, original

UNUSED = {
    "fc_norm.weight", "fc_norm.bias", "head.weight", "head.bias",
    "refinenet4.resConfUnit1.conv1.weight", "refinenet4.resConfUnit1.conv1.bias",
    "refinenet4.resConfUnit1.conv2.weight", "refinenet4.resConfUnit1.conv2.bias",
}  # fmt: skip
"""Ends of the names of weights that exist, and that no forward pass reads."""


@pytest.mark.parametrize("kind", ["n", "k", "nk"])
def test_names_and_shapes_survive_all_layouts_and_are_those_of_transformers(kind: str):
    theirs = released(f"original-{kind}")
    config, weights, _ = original.read(theirs)
    folder, about = huggingface.write(config, weights), huggingface_config.to_json(config, weights)
    with without_memory():
        network = ZoeDepthForDepthEstimation(ZoeDepthConfig(**about))
    renamed = huggingface.table(_heads(about), layout=5).to_theirs(huggingface.read(folder, about, layout=4)[1])
    expected = {name: value.shape for name, value in network.state_dict().items()}
    unread = {name for name in expected if name.startswith("neck.fusion_stage.layers.0.residual_layer1.")}
    assert {name: value.shape for name, value in renamed.items()} | {
        name: expected[name] for name in unread
    } == expected

    preprocessor = huggingface_config.preprocessor_json(config)
    again, back, _ = huggingface.read(folder, about, layout=4, preprocessor=preprocessor)
    assert again == config == PRESETS[f"zoed-m12-{kind}"]
    written = original.write(again, back)
    assert {name: value.shape for name, value in written.items() if not name.endswith("relative_position_index")} == {
        name: value.shape for name, value in theirs.items()
    }


def _heads(about: dict) -> tuple[str, ...]:
    return tuple(entry["name"] for entry in about["bin_configurations"])


def test_checkpoint_of_the_released_names_loads_predicts_and_keeps_its_bits_in_another_layout(tmp_path: Path):
    source = tmp_path / "ZoeD_M12_NK.pt"
    full_size.write("original-nk.txt", source)
    model, peak = full_size.load(source)
    if sys.platform == "linux":  # others do not tell a process the most memory that it had since a moment
        assert peak < 1.6 * source.stat().st_size
    released = PRESETS["zoed-m12-nk"]
    narrow = EncoderConfig(
        "beit_base_patch16_384", "beit", size=released.encoder.size, taps=released.encoder.taps,
        channels=released.encoder.channels, width=full_size.WIDTH, depth=(24,), heads=(16,),
        mlp_width=4 * full_size.WIDTH,
    )  # fmt: skip
    assert model.config == replace(released, encoder=narrow)
    with torch.no_grad():
        depth = model(torch.rand(1, 3, 64, 96, generator=torch.Generator().manual_seed(0))).depth
    assert depth.isfinite().all()
    assert depth.min() < depth.max()

    theirs = torch.load(source, mmap=True, weights_only=True)["model"]
    config, weights, _ = original.read(theirs)
    folder, about = huggingface.write(config, weights), huggingface_config.to_json(config, weights)
    preprocessor = huggingface_config.preprocessor_json(config)
    again, back, _ = huggingface.read(folder, about, layout=4, preprocessor=preprocessor)
    assert again == config
    written = original.write(again, back)
    assert theirs.keys() <= written.keys()
    added = written.keys() - theirs.keys()
    # timm < 0.9.6 has them in the file, the key list has not.
    assert all(name.endswith("relative_position_index") for name in added)
    assert len(added) == 24
    changed = {
        name
        for name, value in theirs.items()
        if value.dtype != written[name].dtype or not torch.equal(value, written[name])
    }
    assert all(any(name.endswith(end) for end in UNUSED) for name in changed)
    assert len(changed) == len(UNUSED)
