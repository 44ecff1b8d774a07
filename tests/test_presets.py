from dataclasses import replace
from functools import cache

import pytest

from zoedepth.build import without_memory
from zoedepth.config import OUTDOOR, DornConfig, ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import (
    BASELINES,
    ENCODERS,
    PRESETS,
    in_training_cameras,
    with_compat,
    with_encoder,
    with_focal_of_size,
    with_head,
)


@cache
def parameters_of(config: ModelConfig) -> int:
    with without_memory():
        return sum(p.numel() for p in ZoeDepth(config).parameters())


def n_parameters(name: str) -> int:
    """The number of parameters of a preset; many presets have equal configs, which are built once."""
    return parameters_of(PRESETS[name])


# The checkpoints hold a first residual unit in the coarsest fusion block, which has no skip to apply it to: two 3x3
# convolutions of 256 channels, with biases, that are never used. They are not built here.
UNUSED_UNIT = 2 * (256 * 256 * 9 + 256)


@pytest.mark.parametrize(
    ("name", "released"),
    [("zoed-m12-n", 343_789_698), ("zoed-m12-k", 343_793_439), ("zoed-m12-nk", 345_073_307)],
)
def test_released_models_have_the_released_number_of_parameters(name: str, released: int):
    """Released: the checkpoint's float tensors without the ImageNet classifier and its norm."""
    assert UNUSED_UNIT == 1_180_160
    assert n_parameters(name) == released - UNUSED_UNIT


@pytest.mark.parametrize(
    ("name", "published", "channels"),
    [
        ("zoed-m12-n", 345e6, 1024),
        ("zoed-m12-n-beit-b", 112e6, 768),
        ("zoed-m12-n-swin-l", 212e6, 1536),
        ("zoed-m12-n-swin2-t", 42e6, 768),
        ("zoed-m12-n-swin2-b", 102e6, 1024),
        ("zoed-m12-n-swin2-l", 214e6, 1536),
    ],
)
def test_parameters_are_within_one_percent_of_the_papers_table(name: str, published: float, channels: int):
    """The paper counts what the released code builds: also the unused unit, and timm's classifier of 1000 classes with
    the norm before it, on the last stage's channels."""
    unused = UNUSED_UNIT + 1000 * (channels + 1) + 2 * channels
    assert n_parameters(name) + unused == pytest.approx(published, rel=0.01)


def test_every_model_the_paper_names_is_there():
    pairs = ["x-n", "n-n", "nk-n", "m12-n", "x-k", "k-k", "nk-k", "m12-k", "nk-nk", "m12-nk", "x-nk"]
    assert {f"zoed-{pair}" for pair in pairs} <= set(PRESETS)
    assert {"zoed-x-nk-one-head", "zoed-nk-nk-one-head", "zoed-m12-nk-one-head", "zoed-lite"} <= set(PRESETS)


def test_models_of_the_paper_follow_the_paper():
    for name in ("zoed-x-n", "zoed-x-k", "zoed-nk-nk", "zoed-m12-nk-one-head", "zoed-m12-n-swin2-t"):
        head = PRESETS[name].head
        assert (head.n_bins, head.n_attractors, head.kind, head.reduce) == (64, (16, 8, 4, 1), "inverse", "mean")
        assert (head.alpha, head.gamma, head.centers, head.probability) == (300, 2, "softplus", "log-binomial")
        assert head.relative_input


def test_released_models_follow_the_weights():
    n, k, nk = (PRESETS[f"zoed-m12-{data}"] for data in ("n", "k", "nk"))
    assert {config.head.reduce for config in (n, k, nk)} == {"mean"}
    assert {(config.head.alpha, config.head.gamma) for config in (n, k, nk)} == {(300, 2)}
    assert (n.head.n_attractors, n.head.centers, n.head.bottleneck_factor) == ((16, 8, 4, 1), "softplus", 2)
    assert (k.head.centers, k.head.attractor_ratio) == ("normed", False)
    assert nk.head.n_attractors == (16, 16, 16, 16)
    assert not nk.head.relative_input
    assert (nk.head.bottleneck_factor, nk.head.projector_width, nk.head.seed_width) == (4, 64, 64)
    assert (nk.router.kind, nk.router.classifier) == ("trained", "transformer")
    for config in (n, k, nk):
        assert (config.head.min_temperature, config.head.max_temperature) == (0.0212, 50.0)
        assert not config.antialias


@pytest.mark.parametrize(
    ("name", "size", "domains"),
    [
        ("zoed-m12-n", (384, 512), [("indoor", 1e-3, 10.0)]),
        ("zoed-m12-k", (384, 768), [("outdoor", 1e-3, 80.0)]),
        ("zoed-m12-nk", (384, 512), [("indoor", 1e-3, 10.0), ("outdoor", 1e-3, 80.0)]),
        ("zoed-m12-n-swin2-t", (256, 256), [("indoor", 1e-3, 10.0)]),
    ],
)
def test_sizes_and_depth_ranges(name: str, size: tuple[int, int], domains: list[tuple[str, float, float]]):
    config = PRESETS[name]
    assert config.size == size
    assert [(domain.name, domain.min_depth, domain.max_depth) for domain in config.domains] == domains


@pytest.mark.parametrize(
    ("name", "focal_px"),
    [
        # 519.4696 pixels in 480 rows of NYU, 721.5377 in 352 of KITTI; the network sees 256, 384 or 256 rows.
        ("zoed-lite", {"indoor": 277.05, "outdoor": 524.75}),
        ("zoed-m12-n", {"indoor": 415.58}),
        ("zoed-m12-k", {"outdoor": 787.13}),
        ("zoed-m12-nk", {"indoor": 415.58, "outdoor": 787.13}),
        ("zoed-m12-n-swin2-t", {"indoor": 277.05}),
        ("zoed-m12-nk-one-head", {"any": None}),
    ],
)
def test_focal_lengths_are_those_of_the_training_sets(name: str, focal_px: dict[str, float | None]):
    config = PRESETS[name]
    assert {domain.name: domain.focal_px for domain in config.domains} == focal_px
    assert config.canonical_camera == (name == "zoed-lite"), "no model of the paper was trained in one camera"


def test_another_size_has_other_focal_lengths_of_the_training_sets_but_keeps_ones_own():
    lite = PRESETS["zoed-lite"]
    small = with_focal_of_size(replace(lite, size=(128, 192)), lite)
    assert small.domains == in_training_cameras(small).domains
    assert small.domains[0].focal_px == pytest.approx(lite.domains[0].focal_px / 2, rel=0.05)
    own = replace(lite, domains=(replace(lite.domains[0], focal_px=300.0), lite.domains[1]))
    changed = with_focal_of_size(replace(own, size=(128, 192)), own)
    assert changed.domains == (own.domains[0], small.domains[1])


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_can_be_built(name: str):
    assert n_parameters(name) > 1_000_000


def test_shipped_model_fits_its_file():
    """At most 16 MB in half precision."""
    with without_memory():
        state = ZoeDepth(PRESETS["zoed-lite"]).state_dict()
    assert sum(2 * value.numel() for value in state.values()) < 16e6


def test_all_backbones_of_the_paper_are_there():
    used = {config.encoder.name for config in PRESETS.values()}
    assert used <= set(ENCODERS)
    assert all(config.name == name for name, config in ENCODERS.items())
    for word in ("beit_large_patch16_384", "beit_large_patch16_512", "beit_base", "swin_large", "swinv2_large"):
        assert any(word in name for name in used)
    for word in ("swinv2_base", "swinv2_tiny", "efficientnet_b5", "efficientnet_lite"):
        assert any(word in name for name in used)


# --- the released code's behaviour ------------------------------------------------------------------------------------


def test_compat_changes_one_value_each():
    n, k, nk = (PRESETS[f"zoed-m12-{kind}"] for kind in ("n", "k", "nk"))
    assert with_compat(n, []) == n
    assert with_compat(nk, ["batch-vote"]) == replace(nk, router=replace(nk.router, vote="batch"))
    assert with_compat(k, ["10m"]) == replace(k, domains=(replace(k.domains[0], max_depth=10.0),))
    assert with_compat(n, ["squeeze"]) == replace(n, resize="squeeze")
    both = with_compat(nk, ["squeeze", "batch-vote"])
    assert (both.resize, both.router.vote) == ("squeeze", "batch")


@pytest.mark.parametrize(
    ("name", "compat", "message"),
    [
        ("zoed-m12-n", "batch-vote", "several heads"),
        ("zoed-m12-n", "10m", "normed"),
        ("zoed-m12-nk", "10m", "normed"),
        ("zoed-m12-nk", "80m", "baselines"),
        ("zoed-m12-k", "80m", "softplus centers"),
        ("zoed-m12-k", "old", "there are batch-vote, 10m, 80m, squeeze"),
    ],
)
def test_compat_a_model_has_not_is_an_error(name: str, compat: str, message: str):
    with pytest.raises(InputError, match=message):
        with_compat(PRESETS[name], [compat])


def test_squeezed_photos_have_the_trained_size():
    """The released code's "eval" mode, whatever the photo's proportions."""
    config = with_compat(PRESETS["zoed-m12-nk"], ["squeeze"])
    assert not config.keep_aspect_ratio
    assert PRESETS["zoed-m12-nk"].keep_aspect_ratio


# --- the systems the paper compares with ------------------------------------------------------------------------------


def test_every_baseline_is_there_for_nyu_kitti_and_both():
    names = ("bts", "adabins", "localbins", "pixelbins", "newcrfs", "dorn")
    assert set(BASELINES) == {f"{name}-{data}" for name in names for data in ("n", "k", "nk")}
    for name, config in BASELINES.items():
        assert config.domains[0].max_depth == (10.0 if name.endswith("-n") else 80.0)


def test_one_head_of_softplus_centers_may_be_kittis_by_compat():
    """Its checkpoint in the original's layout does not say so."""
    n = PRESETS["zoed-m12-n"]
    assert with_compat(n, ["80m"]) == in_training_cameras(replace(n, domains=(OUTDOOR,)))


def test_baselines_of_kitti_reach_80_metres_by_compat():
    for name in ("adabins", "bts", "localbins", "newcrfs", "pixelbins"):
        assert with_compat(BASELINES[f"{name}-n"], ["80m"]) == BASELINES[f"{name}-k"]
    for other, message in (
        ("batch-vote", "'batch-vote' is for models whose trained router"),
        ("10m", "'10m' is for ZoeD-K"),
    ):
        with pytest.raises(InputError, match=message):
            with_compat(BASELINES["adabins-n"], [other])


def test_parts_by_name():
    lite = PRESETS["zoed-lite"]
    assert with_head(lite, "attractor") is lite, "a head the config has keeps its values"
    assert with_head(lite, "dorn") == replace(lite, head=DornConfig())
    with pytest.raises(InputError, match="there is no head 'crf'"):
        with_head(lite, "crf")
    with pytest.raises(InputError, match="there is no encoder 'vit'"):
        with_encoder(lite, "vit")
