"""Ours against transformers' own ZoeDepth: small, random, of every kind; no released weights are needed."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file, save_file
from tests.twins import KITTI, NYU, twin, twin_config
from transformers import ZoeDepthForDepthEstimation, ZoeDepthImageProcessor

from zoedepth.config import AttractorConfig, Domain, ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor
from zoedepth.presets import PRESETS, in_training_cameras
from zoedepth.weights.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from zoedepth.weights.fit import model_of
from zoedepth.weights.layouts import huggingface
from zoedepth.weights.load import load_model

KINDS = pytest.mark.parametrize(
    ("heads", "centers"),
    [
        ((NYU,), "softplus"),
        ((NYU,), "normed"),
        ((NYU, KITTI), "softplus"),
        ((NYU, KITTI), "normed"),
    ],
    ids=["one-softplus", "one-normed", "two-softplus", "two-normed"],
)
CASUAL = {"rtol": 1e-5, "atol": 1e-5}


def pixels(*size: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*size, generator=torch.Generator().manual_seed(seed))


def ours(theirs: ZoeDepthForDepthEstimation) -> ZoeDepth:
    """Our model of their weights."""
    config, weights, table = huggingface.read(theirs.state_dict(), theirs.config.to_dict(), layout=5)

    def name_in_file(name: str) -> str:
        return "/".join(table.theirs(name))

    return model_of(Checkpoint(config, weights, "huggingface", name_in_file), source="twin")


def their_relative(theirs: ZoeDepthForDepthEstimation, x: torch.Tensor) -> torch.Tensor:
    maps, _ = theirs.neck(theirs.backbone(x).feature_maps, x.shape[2] // 16, x.shape[3] // 16)
    return theirs.relative_head(maps)[0]


# --- the network ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("heads", "centers", "native", "size"),
    [
        # Sizes and tables are the encoder's, whatever heads there are.
        *(((NYU,), "softplus", native, size) for native in (64, (64, 96)) for size in ((64, 64), (64, 96), (160, 96))),
        ((NYU,), "normed", (64, 96), (160, 96)),
        ((NYU, KITTI), "softplus", 64, (64, 96)),
        ((NYU, KITTI), "normed", (64, 96), (64, 96)),
    ],
    ids=lambda x: f"{len(x)}-head" if isinstance(x, tuple) and isinstance(x[0], dict) else str(x),
)
@torch.no_grad()
def test_network_equals_theirs(heads: tuple, centers: str, native: Any, size: tuple[int, int]):
    """At the size of the position tables, and at sizes they have to be resized to."""
    theirs = twin(twin_config(heads=heads, centers=centers, size=native))
    model, x = ours(theirs), pixels(1, 3, *size)
    expected, found = theirs(2 * x - 1), model(x)
    torch.testing.assert_close(found.depth[:, 0], expected.predicted_depth, **CASUAL)
    torch.testing.assert_close(found.relative[:, 0], their_relative(theirs, 2 * x - 1), **CASUAL)
    assert found.depth.std() > 1e-3, "a constant proves nothing"
    if len(heads) > 1:
        torch.testing.assert_close(found.domain_logits, expected.domain_logits, **CASUAL)


@torch.no_grad()
def test_unusual_widths_are_read_from_the_shapes():
    heads = ({**NYU, "n_bins": 16}, {**KITTI, "n_bins": 16})
    config = twin_config(
        heads=heads, patch_transformer_intermediate_size=48, patch_transformer_num_attention_heads=8, max_temp=5.0
    )
    config.backbone_config.intermediate_size = 80
    theirs = twin(config)
    model, x = ours(theirs), pixels(1, 3, 64, 64)
    assert model.config.router.attention_heads == 8
    assert model.config.encoder.mlp_width == 80
    assert model.config.head.max_temperature == 5.0
    torch.testing.assert_close(model(x).depth[:, 0], theirs(2 * x - 1).predicted_depth, **CASUAL)
    torch.testing.assert_close(model(x).domain_logits, theirs(2 * x - 1).domain_logits, **CASUAL)


@torch.no_grad()
def test_taps_are_those_of_their_config():
    config = twin_config()
    config.backbone_config.num_hidden_layers = 8
    config.backbone_config.stage_names = ["stem", *(f"stage{i}" for i in range(1, 9))]
    config.backbone_config.set_output_features_output_indices(
        out_features=["stage1", "stage4", "stage5", "stage8"], out_indices=None
    )
    theirs = twin(config)
    model, x = ours(theirs), pixels(1, 3, 64, 64)
    assert model.config.encoder.taps == (0, 3, 4, 7)
    torch.testing.assert_close(model(x).depth[:, 0], theirs(2 * x - 1).predicted_depth, **CASUAL)


@torch.no_grad()
def test_their_default_layer_norm_is_not_what_beit_was_trained_with():
    """Why their eps is set to 1e-6 in these tests, and written into the folders we make."""
    config = twin_config()
    theirs = twin(config)
    model, x = ours(theirs), pixels(1, 3, 64, 64)
    for layer in theirs.backbone.modules():
        if isinstance(layer, torch.nn.LayerNorm):
            layer.eps = 1e-2
    assert not torch.allclose(model(x).depth[:, 0], theirs(2 * x - 1).predicted_depth, **CASUAL)


# --- the batch's vote -------------------------------------------------------------------------------------------------


def disagreeing(theirs: ZoeDepthForDepthEstimation) -> torch.Tensor:
    """Return two images that take different heads, after the scores are shifted so that they do."""
    x = torch.cat([pixels(1, 3, 64, 64), 0.2 * pixels(1, 3, 64, 64, seed=1)])
    logits = torch.cat([theirs(2 * one[None] - 1).domain_logits for one in x])
    # Not in the middle between them: a vote of the two would be a tie, which rounding decides.
    middle = (logits[:, 0] - logits[:, 1]) @ torch.tensor([0.75, 0.25])
    theirs.metric_head.mlp_classifier.linear2.bias.data[1] += middle
    return x


@torch.no_grad()
def test_each_image_of_a_batch_takes_its_own_head_and_compat_reproduces_their_vote():
    theirs = twin(twin_config(heads=(NYU, KITTI)))
    x = disagreeing(theirs)
    model = ours(theirs)
    alone = torch.cat([model(one[None]).depth for one in x])
    assert model(x).domain.tolist() in ([0, 1], [1, 0])
    torch.testing.assert_close(model(x).depth, alone, **CASUAL)
    expected = torch.cat([theirs(2 * one[None] - 1).predicted_depth for one in x])
    torch.testing.assert_close(alone[:, 0], expected, **CASUAL)

    config, weights, _ = huggingface.read(theirs.state_dict(), theirs.config.to_dict(), layout=5)
    voting = model_of(Checkpoint(config, weights, "", str), source="twin", compat=["batch-vote"])
    logits = voting(x).domain_logits
    assert logits is not None
    assert set(voting(x).domain.tolist()) == {int(logits.sum(dim=0).argmax())}
    torch.testing.assert_close(voting(x).depth[:, 0], theirs(2 * x - 1).predicted_depth, **CASUAL)
    assert not torch.allclose(voting(x).depth, alone, atol=1e-4)


# --- through the processor --------------------------------------------------------------------------------------------

PHOTOS = {"landscape": (48, 64), "portrait": (90, 55), "panorama": (40, 200), "tiny": (9, 11), "even": (128, 128)}


@pytest.mark.parametrize(
    ("heads", "centers", "photo", "flip"),
    [
        *(((NYU,), "softplus", photo, flip) for photo in PHOTOS for flip in (False, True)),
        ((NYU,), "normed", "landscape", True),
        ((NYU, KITTI), "softplus", "portrait", True),
        ((NYU, KITTI), "normed", "landscape", True),
    ],
    ids=lambda x: f"{len(x)}-head" if isinstance(x, tuple) else str(x),
)
@torch.no_grad()
def test_photos_through_their_processor_and_post_processing(heads: tuple, centers: str, photo: str, flip: bool):
    """Padding, network size, resizing, mirror average, bicubic way back: within a millimetre."""
    theirs = twin(twin_config(heads=heads, centers=centers))
    height, width = PHOTOS[photo]
    noise = np.random.default_rng(0).integers(0, 256, (height // 3, width // 3, 3), dtype=np.uint8)
    image = Image.fromarray(noise).resize((width, height), Image.Resampling.BICUBIC)
    size = {"height": 64, "width": 96}
    processor = ZoeDepthImageProcessor(
        size=size, ensure_multiple_of=32, image_mean=[0.5, 0.5, 0.5], image_std=[0.5, 0.5, 0.5]
    )
    inputs = processor(images=image, return_tensors="pt")["pixel_values"]
    flipped = theirs(inputs.flip(-1)) if flip else None
    result = processor.post_process_depth_estimation(
        theirs(inputs), source_sizes=[(height, width)], outputs_flipped=flipped
    )
    config, weights, _ = huggingface.read(
        theirs.state_dict(), theirs.config.to_dict(), layout=5, preprocessor={"size": size}
    )
    # A photo and its mirror image take one head here, each its own there.
    compat = ["batch-vote"] if len(heads) > 1 else []
    model = model_of(Checkpoint(config, weights, "", str), source="twin", compat=compat)
    predictor = Predictor(model, flip_average=flip)
    assert predictor.network_size((height, width)) == tuple(inputs.shape[2:])
    np.testing.assert_allclose(predictor(image).depth, result[0]["predicted_depth"].numpy(), atol=1e-3)


# --- files ------------------------------------------------------------------------------------------------------------


@KINDS
@torch.no_grad()
def test_their_folder_loads_and_ours_loads_there(heads: tuple, centers: str, tmp_path: Path):
    theirs = twin(twin_config(heads=heads, centers=centers))
    theirs.save_pretrained(tmp_path / "theirs")
    x = pixels(1, 3, 64, 96)
    expected = theirs(2 * x - 1).predicted_depth
    torch.testing.assert_close(load_model(tmp_path / "theirs")(x).depth[:, 0], expected, **CASUAL)

    write_checkpoint(read_checkpoint(tmp_path / "theirs"), tmp_path / "ours", to="huggingface")
    again, report = ZoeDepthForDepthEstimation.from_pretrained(tmp_path / "ours", output_loading_info=True)
    assert not any(report.values()), report
    torch.testing.assert_close(again.eval()(2 * x - 1).predicted_depth, expected, **CASUAL)
    assert load_model(tmp_path / "ours").config == load_model(tmp_path / "theirs").config


def test_folder_we_write_has_the_processor_of_the_original(tmp_path: Path):
    theirs = twin(twin_config())
    theirs.save_pretrained(tmp_path / "theirs")
    write_checkpoint(read_checkpoint(tmp_path / "theirs"), tmp_path / "ours", to="huggingface")
    processor = ZoeDepthImageProcessor.from_pretrained(tmp_path / "ours")
    image = Image.new("RGB", (640, 480))
    assert processor(images=image, return_tensors="pt")["pixel_values"].shape == (1, 3, 384, 512)
    assert tuple(processor.image_mean) == (0.5, 0.5, 0.5)


@KINDS
@torch.no_grad()
def test_names_of_transformers_5_and_of_4_are_the_same_model(heads: tuple, centers: str, tmp_path: Path):
    theirs = twin(twin_config(heads=heads, centers=centers))
    theirs.save_pretrained(tmp_path / "model")
    new = {name: value.clone() for name, value in theirs.state_dict().items()}
    old = {name: value.clone() for name, value in load_file(tmp_path / "model" / "model.safetensors").items()}
    names = tuple(head["name"] for head in heads)
    to_old = huggingface.table(names, layout=4).to_theirs(huggingface.table(names, layout=5).to_ours(new))
    assert huggingface.layout_of(new) == 5
    assert huggingface.layout_of(to_old) == 4
    x = pixels(1, 3, 64, 64)
    expected = theirs(2 * x - 1).predicted_depth
    for weights in (new, {**to_old}, old):
        save_file({name: value.clone() for name, value in weights.items()}, tmp_path / "model" / "model.safetensors")
        torch.testing.assert_close(load_model(tmp_path / "model")(x).depth[:, 0], expected, **CASUAL)
        # The file alone, its config beside it.
        file = tmp_path / "model" / "model.safetensors"
        torch.testing.assert_close(load_model(file)(x).depth[:, 0], expected, **CASUAL)


def test_heads_of_other_names_keep_them(tmp_path: Path):
    heads = ({**NYU, "name": "kitchen"}, {**KITTI, "name": "street"})
    twin(twin_config(heads=heads)).save_pretrained(tmp_path / "theirs")
    model = load_model(tmp_path / "theirs")
    assert model.config.domains == (Domain("kitchen", 1e-3, 10.0), Domain("street", 1e-3, 80.0))
    write_checkpoint(read_checkpoint(tmp_path / "theirs"), tmp_path / "ours", to="huggingface")
    assert load_model(tmp_path / "ours").config == model.config


def test_our_fields_of_domains_come_along_and_a_canonical_camera_is_refused(tmp_path: Path):
    twin(twin_config(heads=(NYU, KITTI))).save_pretrained(tmp_path / "theirs")
    checkpoint = read_checkpoint(tmp_path / "theirs")
    indoor, outdoor = checkpoint.config.domains
    assert checkpoint.config == in_training_cameras(checkpoint.config)
    assert indoor.focal_px is not None
    own = replace(checkpoint.config, domains=(replace(indoor, focal_px=777.0, std_factor=1.5), outdoor))
    write_checkpoint(checkpoint._replace(config=own), tmp_path / "own", to="huggingface")
    assert load_model(tmp_path / "own").config.domains == own.domains
    canonical = checkpoint._replace(config=replace(own, canonical_camera=True))
    with pytest.raises(InputError, match="canonical camera True"):
        write_checkpoint(canonical, tmp_path / "canonical", to="huggingface")


def test_folder_says_how_photos_are_resized_and_padded_and_cannot_say_how_a_batch_votes(tmp_path: Path):
    twin(twin_config(heads=(NYU, KITTI))).save_pretrained(tmp_path / "theirs")
    checkpoint = read_checkpoint(tmp_path / "theirs")
    config = checkpoint.config
    assert isinstance(config, ModelConfig)
    own = checkpoint._replace(config=replace(config, resize="squeeze", pad=False))
    write_checkpoint(own, tmp_path / "own", to="huggingface")
    assert load_model(tmp_path / "own").config == own.config
    voting = checkpoint._replace(config=replace(config, router=replace(config.router, vote="batch")))
    with pytest.raises(InputError, match=r"a vote of the batch.*--compat batch-vote"):
        write_checkpoint(voting, tmp_path / "voting", to="huggingface")


def test_a_focal_length_that_nobody_knows_stays_unknown(tmp_path: Path):
    twin(twin_config(heads=(NYU, KITTI))).save_pretrained(tmp_path / "theirs")
    checkpoint = read_checkpoint(tmp_path / "theirs")
    domains = tuple(replace(domain, focal_px=None) for domain in checkpoint.config.domains)
    own = checkpoint._replace(config=replace(checkpoint.config, domains=domains))
    write_checkpoint(own, tmp_path / "own", to="huggingface")
    assert load_model(tmp_path / "own").config.domains == domains


@pytest.mark.parametrize(
    "domain",
    [Domain("indoor", focal_px=415.58), Domain("outdoor", focal_px=760.0), Domain("indoor", focal_px=None)],
)
def test_single_head_of_normed_centers_says_its_focal_length(tmp_path: Path, domain: Domain):
    """Or, with the sizes of the published ZoeD-K, it would be taken for that one, and reach 80 m."""
    twin(twin_config(centers="normed")).save_pretrained(tmp_path / "theirs")
    checkpoint = read_checkpoint(tmp_path / "theirs")
    own = replace(checkpoint.config, domains=(domain,))
    write_checkpoint(checkpoint._replace(config=own), tmp_path / "own", to="huggingface")
    said = json.loads((tmp_path / "own/config.json").read_text())["bin_configurations"][0]
    assert said["focal_px"] == own.domains[0].focal_px
    assert load_model(tmp_path / "own").config.domains == own.domains


# --- the range of ZoeD-K ----------------------------------------------------------------------------------------------


@torch.no_grad()
def test_ten_metres_are_an_affine_function_of_eighty():
    """The formula of the documentation, in their code: the fractions do not know the range."""
    near, far = (twin(twin_config(heads=(head,), centers="normed")) for head in (NYU, KITTI))
    far.load_state_dict(near.state_dict())
    x = pixels(1, 3, 64, 64)
    d10, d80 = near(x).predicted_depth, far(x).predicted_depth
    torch.testing.assert_close(d80, (d10 - 1e-3) * 79.999 / 9.999 + 1e-3, rtol=1e-5, atol=1e-5)
    compat = model_of(
        Checkpoint(*huggingface.read(far.state_dict(), far.config.to_dict(), layout=5)[:2], "", str),
        source="twin",
        compat=["10m"],
    )
    torch.testing.assert_close(compat((x + 1) / 2).depth[:, 0], d10, **CASUAL)


# --- what cannot be ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", ["zoed-lite", "zoed-nk-nk"])
def test_model_they_have_not_is_refused_with_the_reason(preset: str):
    with pytest.raises(InputError, match="transformers' ZoeDepth has no such model"):
        huggingface.write(PRESETS[preset], {})


def test_reasons_are_named():
    released = PRESETS["zoed-m12-n"]
    config = ModelConfig(released.encoder, head=AttractorConfig(kind="exponential", reduce="mean"))
    with pytest.raises(InputError, match="kind 'exponential'"):
        huggingface.write(config, {})
