"""Sources of predictions: a model as the protocol runs it, files found by name, and what is said without looking."""

import dataclasses
import unicodedata
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from tests.evaluation.samples import EVERYWHERE, FactorSource, photo, sample_of
from tests.folders import write_disparity_pairs, write_pairs
from torchvision.transforms import functional as transforms

from zoedepth.config import ModelConfig, RouterConfig
from zoedepth.data.augment import kitti_crop
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.evaluation.dataset_scores import score_dataset
from zoedepth.evaluation.predictions import (
    TRIVIAL,
    ConstantSource,
    FolderSource,
    MeanMapSource,
    ModelSource,
    predict,
    prepare,
    trivial_sources,
)
from zoedepth.evaluation.protocols import OUTDOOR, PLAIN, Protocol
from zoedepth.geometry.camera import Intrinsics
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.outputs import Maps, write_maps
from zoedepth.outputs.depth import write_depth_png
from zoedepth.predict import Predictor
from zoedepth.runtimes.fast import Fast
from zoedepth.stored.maps import RELATIVE_KEY
from zoedepth.weights.exported import OnnxModel, load_exported
from zoedepth.weights.fingerprint import weights_fingerprint
from zoedepth.weights.load import load_model
from zoedepth.weights.releases import ASSETS
from zoedepth.weights.save import save_model

PROTOCOLS = {"indoor": EVERYWHERE, "outdoor": replace(EVERYWHERE, max_depth=80.0)}

# ---------------------------------------------------------------------------------------------------- models


@pytest.fixture
def outdoor_model(tiny_model: ZoeDepth) -> ZoeDepth:
    """Make a model that takes every photo, and its mirror image, for an outdoor one."""
    with torch.no_grad():
        tiny_model.router.classifier.mlp[-1].bias.copy_(torch.tensor([0.0, 1000.0]))
    return tiny_model


def test_prediction_is_that_of_the_original_evaluation(outdoor_model: ZoeDepth) -> None:
    sample = photo((50, 90))
    # Resized to multiples of 32 near 64 in height, corners aligned; averaged with the mirrored one at that size;
    # resized to the photo's size, corners aligned.
    pixels = F.interpolate(sample.image[None], (64, 128), mode="bilinear", align_corners=True)
    with torch.no_grad():
        output = outdoor_model(pixels)
        mirrored = outdoor_model(pixels.flip(-1), domain=output.domain).depth.flip(-1)
    averaged, plain = (
        F.interpolate(depth, (50, 90), mode="bilinear", align_corners=True)[0, 0].numpy()
        for depth in ((output.depth + mirrored) / 2, output.depth)
    )
    found = ModelSource(outdoor_model).predict(sample, EVERYWHERE)
    np.testing.assert_allclose(found.depth, averaged, rtol=1e-5)
    found = ModelSource(outdoor_model).predict(sample, replace(EVERYWHERE, flip_average=False))
    np.testing.assert_allclose(found.depth, plain, rtol=1e-5)
    assert np.abs(averaged / plain - 1).mean() > 1e-4


@pytest.mark.parametrize(
    ("switch", "argument"),
    [
        ({}, {}),
        ({"flip_average": False}, {"flip_average": False}),
        ({"pad": True}, {"pad": True}),
        ({"resize": "squeeze"}, {"resize": "squeeze"}),
        ({"upsampling": "bicubic"}, {"upsampling": "bicubic"}),
    ],
    ids=["none", "no flip", "pad", "squeeze", "bicubic"],
)
def test_model_is_run_as_the_protocol_says(
    tiny_model: ZoeDepth, switch: dict[str, object], argument: dict[str, object]
) -> None:
    sample = photo((50, 90))
    settings = {"flip_average": True, "pad": False, "resize": "keep-aspect", "upsampling": "bilinear", **argument}
    expected = Predictor(tiny_model, **settings)(sample.image)
    found = ModelSource(tiny_model).predict(sample, replace(EVERYWHERE, **switch))
    np.testing.assert_array_equal(found.depth, expected.depth)
    np.testing.assert_array_equal(found.std, expected.std)
    assert (found.domain, found.relative) == (expected.domain, False)
    if switch:
        assert not np.array_equal(found.depth, ModelSource(tiny_model).predict(sample, EVERYWHERE).depth)


def test_protocol_has_the_last_word_on_the_proportions(tiny_config: ModelConfig, tiny_model: ZoeDepth) -> None:
    squeezing = ZoeDepth(replace(tiny_config, resize="squeeze")).eval()
    squeezing.load_state_dict(tiny_model.state_dict())
    sample = photo((50, 90))
    for resize in ("keep-aspect", "squeeze"):
        found, expected = (
            ModelSource(m).predict(sample, replace(EVERYWHERE, resize=resize)) for m in (squeezing, tiny_model)
        )
        np.testing.assert_array_equal(found.depth, expected.depth)


@pytest.mark.parametrize(
    ("protocol", "size"),
    [
        (replace(EVERYWHERE, photo_size=(70, 60)), (70, 60)),
        (replace(EVERYWHERE, photo_short_side=30), (30, 54)),
        (replace(EVERYWHERE, photo_short_side=100), (100, 180)),
    ],
    ids=["size", "short side", "enlarged"],
)
def test_photo_has_the_size_of_the_protocol_first(
    tiny_model: ZoeDepth, protocol: Protocol, size: tuple[int, int]
) -> None:
    sample = photo((50, 90))
    resized = transforms.resize(sample.image, list(size), antialias=True).clamp(0, 1)
    found = ModelSource(tiny_model).predict(sample, protocol)
    expected = Predictor(tiny_model, pad=False, upsampling="bilinear")(resized)
    np.testing.assert_array_equal(found.depth, expected.depth)
    assert found.depth.shape == size


def test_photo_is_resized_first_with_or_without_a_filter_as_the_protocol_says(tiny_model: ZoeDepth) -> None:
    sample = photo((128, 192))
    for antialias in (True, False):
        protocol = replace(EVERYWHERE, photo_size=(64, 96), photo_antialias=antialias)
        resized = transforms.resize(sample.image, [64, 96], antialias=antialias)
        expected = Predictor(tiny_model, pad=False, upsampling="bilinear")(resized.clamp(0, 1))
        np.testing.assert_array_equal(ModelSource(tiny_model).predict(sample, protocol).depth, expected.depth)


def test_labeled_router_is_told_the_domain_of_the_data(tiny_config: ModelConfig) -> None:
    model = ZoeDepth(replace(tiny_config, router=RouterConfig("labeled"))).eval()
    for domain in ("indoor", "outdoor"):
        found = ModelSource(model).predict(photo((50, 90), domain=domain), EVERYWHERE)
        expected = Predictor(model, pad=False, upsampling="bilinear")(photo((50, 90)).image, domain=domain)
        np.testing.assert_array_equal(found.depth, expected.depth)
        assert found.domain is None  # it had no choice
    scored = score_dataset(ModelSource(model), [photo((50, 90), domain="outdoor")], {"outdoor": EVERYWHERE})
    assert (len(scored.scores), scored.failures) == (1, [])
    with pytest.raises(InputError, match=r"attic.*heads for \['indoor', 'outdoor'\]"):
        ModelSource(model).predict(photo((50, 90), domain="attic"), EVERYWHERE)


def test_shorter_side_of_an_upright_photo_is_its_width(tiny_model: ZoeDepth) -> None:
    found = ModelSource(tiny_model).predict(photo((90, 50)), replace(EVERYWHERE, photo_short_side=30))
    assert found.depth.shape == (54, 30)


def test_loaded_model_knows_what_its_scores_depend_on(tiny_model: ZoeDepth, tmp_path: Path) -> None:
    save_model(tiny_model, tmp_path / "tiny.safetensors")
    found = ModelSource.load(tmp_path / "tiny.safetensors", compat=["batch-vote"], device="cpu")
    assert found.about == {"model": str(tmp_path / "tiny.safetensors"), "compat": ["batch-vote"]}
    assert found.state("any.jpg") == weights_fingerprint(tmp_path / "tiny.safetensors")
    assert not found.model.training
    expected = ModelSource(load_model(tmp_path / "tiny.safetensors", compat=("batch-vote",)))
    sample = photo((50, 90))
    np.testing.assert_array_equal(found.predict(sample, EVERYWHERE).depth, expected.predict(sample, EVERYWHERE).depth)
    assert expected.about == {}


def test_model_of_one_domain_has_no_choice_of_head(tiny_config: ModelConfig) -> None:
    torch.manual_seed(0)
    model = ZoeDepth(replace(tiny_config, domains=tiny_config.domains[:1])).eval()
    assert ModelSource(model).predict(photo((64, 64)), EVERYWHERE).domain is None


@pytest.mark.parametrize("flip", [True, False])
def test_model_without_metric_heads_gives_relative_depth(tiny_config: ModelConfig, flip: bool) -> None:
    torch.manual_seed(0)
    model = ZoeDepth(replace(tiny_config, domains=())).eval()
    sample = photo((50, 90))
    found = ModelSource(model).predict(sample, replace(EVERYWHERE, flip_average=flip))
    expected = Predictor(model, pad=False, upsampling="bilinear", flip_average=flip).relative(sample.image)
    np.testing.assert_array_equal(found.depth, expected)
    assert (found.relative, found.std, found.domain) == (True, None, None)


def test_antialiased_model_sees_fine_stripes_as_grey(tiny_config: ModelConfig) -> None:
    torch.manual_seed(0)
    sharp = ZoeDepth(tiny_config).eval()
    smooth = ZoeDepth(replace(tiny_config, antialias=True)).eval()
    smooth.load_state_dict(sharp.state_dict())
    grey = replace(sample_of(np.full((512, 512), 1.0)), image=torch.full((3, 512, 512), 128 / 255))
    stripes = replace(grey, image=(torch.arange(512) % 2).expand(3, 512, 512).float())
    protocol = replace(EVERYWHERE, flip_average=False)

    def difference(model: ZoeDepth) -> float:
        seen = [ModelSource(model).predict(sample, protocol).depth for sample in (grey, stripes)]
        return float(np.abs(seen[1] / seen[0] - 1).mean())

    assert difference(smooth) < 0.2 * difference(sharp)


# ---------------------------------------------------------------------------------------------------- cameras


@pytest.fixture
def one_lens(tiny_config: ModelConfig) -> ZoeDepth:
    """Make a model of one domain that has learned metres from photos with a focal length of 80 pixels."""
    torch.manual_seed(0)
    return ZoeDepth(replace(tiny_config, domains=(replace(tiny_config.domains[0], focal_px=80.0),))).eval()


def with_lens(sample: Sample, focal_px: float) -> Sample:
    height, width = sample.image.shape[-2:]
    return replace(sample, camera=Intrinsics(focal_px, focal_px, (width - 1) / 2, (height - 1) / 2))


@pytest.mark.parametrize(
    ("size", "protocol", "factor"),
    [
        ((64, 64), EVERYWHERE, 120 / 80),
        ((128, 128), EVERYWHERE, 60 / 80),  # seen at 64 x 64
        ((64, 64), replace(EVERYWHERE, photo_size=(32, 64)), 60 / 80),  # squeezed to half its height
        # Cut to 352 x 1216, then squeezed to 64 x 64: the height counts.
        ((375, 1242), replace(EVERYWHERE, kitti_crop=True, resize="squeeze"), 120 * 64 / 352 / 80),
    ],
    ids=["as it is", "resized", "squeezed by the protocol", "cropped and squeezed"],
)
def test_camera_of_the_data_corrects_depth_by_the_focal_length(
    one_lens: ZoeDepth, size: tuple[int, int], protocol: Protocol, factor: float
) -> None:
    sample = with_lens(photo(size), 120.0)
    told, shown = predict(ModelSource(one_lens, camera="data"), sample, protocol)
    plain, _ = predict(ModelSource(one_lens), sample, protocol)
    np.testing.assert_allclose(told.depth, plain.depth * factor, rtol=1e-5)
    np.testing.assert_allclose(told.std, plain.std * factor, rtol=1e-5)
    assert shown.camera is not None
    # Told nothing, even a model in one camera corrects nothing.
    canonical = ZoeDepth(replace(one_lens.config, canonical_camera=True)).eval()
    canonical.load_state_dict(one_lens.state_dict())
    np.testing.assert_array_equal(predict(ModelSource(canonical), sample, protocol)[0].depth, plain.depth)
    np.testing.assert_array_equal(predict(ModelSource(canonical, camera="data"), sample, protocol)[0].depth, told.depth)


def test_camera_that_nobody_says_is_an_error(one_lens: ZoeDepth, tiny_model: ZoeDepth) -> None:
    with pytest.raises(InputError, match=r"the data says no camera for photo\.jpg.* --camera none"):
        ModelSource(one_lens, camera="data").predict(photo((64, 64)), EVERYWHERE)
    with pytest.raises(InputError, match="with what focal length it was trained for indoor, outdoor"):
        ModelSource(tiny_model, camera="data")


def test_scores_belong_to_what_the_model_was_told(one_lens: ZoeDepth) -> None:
    about = {"model": "some"}
    assert ModelSource(one_lens, about=about).about == about
    assert ModelSource(one_lens, about=about, camera="data").about == {"model": "some", "camera": "data"}


# ---------------------------------------------------------------------------------------------------- files

DEPTH = np.array([[1.5, 2.0], [0.25, 8.0]], dtype=np.float32)


def named(name: str) -> Sample:
    return sample_of([[2.0]], name=name)


@pytest.mark.parametrize("suffix", [".png", ".npy", ".npz"])
@pytest.mark.parametrize("place", ["image/room.1/0007", "0007", "image/room.1/0007_depth", "0007_depth"])
def test_file_is_found_by_path_or_name_with_or_without_depth(tmp_path: Path, place: str, suffix: str) -> None:
    write_maps(tmp_path / f"{place}{suffix}", Maps(depth=DEPTH))
    found = FolderSource(tmp_path).predict(named("image/room.1/0007.jpg"), EVERYWHERE)
    np.testing.assert_allclose(found.depth, DEPTH, atol=5e-4)
    assert (found.std, found.domain, found.relative) == (None, None, False)


def test_file_in_the_photos_tree_goes_before_one_of_the_same_name(tmp_path: Path) -> None:
    write_maps(tmp_path / "7.npy", Maps(depth=DEPTH))
    write_maps(tmp_path / "b" / "7.npy", Maps(depth=2 * DEPTH))
    source = FolderSource(tmp_path)
    np.testing.assert_array_equal(source.predict(named("b/7.jpg"), EVERYWHERE).depth, 2 * DEPTH)
    np.testing.assert_array_equal(source.predict(named("a/7.jpg"), EVERYWHERE).depth, DEPTH)


def test_of_files_that_hold_the_same_depth_the_most_exact_one_is_taken(tmp_path: Path) -> None:
    write_depth_png(tmp_path / "7_depth.png", DEPTH)
    write_maps(tmp_path / "7.npz", Maps(depth=DEPTH))
    Image.fromarray(np.zeros((2, 2, 3), np.uint8)).save(tmp_path / "7.png")  # a preview in colours
    source = FolderSource(tmp_path)
    before = source.state("7.jpg")
    np.testing.assert_array_equal(source.predict(named("7.jpg"), EVERYWHERE).depth, DEPTH)
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "7.png")  # one in grey
    assert source.state("7.jpg") != before, "which file is taken depends on all of them"
    np.testing.assert_array_equal(source.predict(named("7.jpg"), EVERYWHERE).depth, DEPTH)


@pytest.mark.parametrize("kind", [None, "disparity"])
def test_of_files_that_hold_other_depth_none_is_taken(tmp_path: Path, kind: Any) -> None:
    write_depth_png(tmp_path / "7.png", DEPTH[::-1])
    write_maps(tmp_path / "7.npy", Maps(depth=DEPTH))
    with pytest.raises(InputError, match=r"7\.npy and .*7\.png may both be the depth of 7\.jpg\. Remove one of them"):
        FolderSource(tmp_path, kind=kind).predict(named("7.jpg"), EVERYWHERE)
    write_depth_png(tmp_path / "7.png", 3 * DEPTH + 1)
    if kind == "disparity":  # known up to scale and shift
        np.testing.assert_array_equal(
            FolderSource(tmp_path, kind=kind).predict(named("7.jpg"), EVERYWHERE).depth, DEPTH
        )


def test_scale_of_a_png_is_that_in_the_file_or_the_one_given(tmp_path: Path) -> None:
    write_depth_png(tmp_path / "a.png", DEPTH, scale=256)
    np.testing.assert_array_equal(FolderSource(tmp_path).predict(named("a.jpg"), EVERYWHERE).depth, DEPTH)
    Image.fromarray((DEPTH * 256).astype(np.uint16)).save(tmp_path / "b.png")
    found = FolderSource(tmp_path, scale=256).predict(named("b.jpg"), EVERYWHERE)
    np.testing.assert_array_equal(found.depth, DEPTH)
    with pytest.raises(InputError, match=r"b\.png does not say how many .* --predictions-scale"):
        FolderSource(tmp_path).predict(named("b.jpg"), EVERYWHERE)
    found = FolderSource(tmp_path).predict(named("b.jpg"), replace(EVERYWHERE, alignment="median"))
    np.testing.assert_array_equal(found.depth, DEPTH * 256)  # the alignment finds the scale


def test_given_scale_is_for_all_files_of_the_folder(tmp_path: Path) -> None:
    """Arrays of whole numbers and of millimetres in floating point, too."""
    np.save(tmp_path / "a.npy", (DEPTH * 1000).astype(np.int32))
    np.save(tmp_path / "b.npy", DEPTH * 1000)
    for name in ("a.jpg", "b.jpg"):
        found = FolderSource(tmp_path, scale=1000).predict(named(name), EVERYWHERE)
        np.testing.assert_allclose(found.depth, DEPTH, rtol=1e-6)
    with pytest.raises(InputError, match=r"a\.npy does not say"):
        FolderSource(tmp_path).predict(named("a.jpg"), EVERYWHERE)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_scale_must_be_a_number_of_steps(tmp_path: Path, scale: float) -> None:
    with pytest.raises(InputError, match="must be finite and > 0"):
        FolderSource(tmp_path, scale=scale)


def test_disparity_has_no_unit_and_may_have_8_bits(tmp_path: Path) -> None:
    values = np.array([[0, 3], [255, 8]], np.uint8)
    Image.fromarray(values).save(tmp_path / "a.png")
    found = FolderSource(tmp_path, kind="disparity").predict(named("a.jpg"), EVERYWHERE)
    np.testing.assert_array_equal(found.depth, values)
    assert found.relative
    assert found.file == tmp_path / "a.png"
    with pytest.raises(InputError, match="--predictions-kind disparity"):
        FolderSource(tmp_path).predict(named("a.jpg"), EVERYWHERE)


def test_relative_depth_of_this_package_is_not_taken_for_metres(tmp_path: Path) -> None:
    text = PngInfo()
    text.add_text(RELATIVE_KEY, "0.5")
    Image.fromarray((DEPTH * 256).astype(np.uint16)).save(tmp_path / "a.png", pnginfo=text)
    with pytest.raises(InputError, match=r"a\.png says that it is relative depth.*--predictions-kind disparity"):
        FolderSource(tmp_path).predict(named("a.jpg"), EVERYWHERE)
    assert FolderSource(tmp_path, kind="disparity").predict(named("a.jpg"), EVERYWHERE).relative


def test_map_that_two_photos_would_share_is_nobodys(tmp_path: Path) -> None:
    write_maps(tmp_path / "1.npy", Maps(depth=DEPTH))
    source = FolderSource(tmp_path)
    source.predict(named("a/1.jpg"), EVERYWHERE)
    with pytest.raises(InputError, match=r"1\.npy would be the depth of two photos, a/1\.jpg and b/1\.jpg"):
        source.predict(named("b/1.jpg"), EVERYWHERE)
    other = FolderSource(tmp_path)
    assert other.state("a/1.jpg")  # as if the score of the first were kept
    with pytest.raises(InputError, match="two photos"):
        other.predict(named("b/1.jpg"), EVERYWHERE)


def test_settings_tell_a_folder_from_others_and_the_file_is_its_state(tmp_path: Path) -> None:
    source = FolderSource(tmp_path, scale=256)
    assert source.about == {"folder": str(tmp_path), "scale": 256, "kind": "depth"}
    assert source.state("a.jpg") is None
    write_maps(tmp_path / "a.npy", Maps(depth=DEPTH))
    before = source.state("a.jpg")
    assert before is not None
    write_maps(tmp_path / "a.npy", Maps(depth=2 * DEPTH))
    assert source.state("a.jpg") != before


def test_missing_file_is_an_error_that_names_photo_and_folder(tmp_path: Path) -> None:
    write_maps(tmp_path / "other.npy", Maps(depth=DEPTH))
    with pytest.raises(InputError) as raised:
        FolderSource(tmp_path).predict(named("image/7.jpg"), EVERYWHERE)
    assert str(tmp_path) in str(raised.value)
    assert "image/7.jpg" in str(raised.value)


def test_damaged_file_is_an_error_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "7.npy").write_bytes(b"no array")
    with pytest.raises(InputError, match=r"7\.npy"):
        FolderSource(tmp_path).predict(named("7.jpg"), EVERYWHERE)


def test_missing_folder_is_an_error_that_names_it(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        FolderSource(tmp_path / "nowhere")


# ---------------------------------------------------------------------------------------------------- without looking


def skewed(*, seed: int, domain: str = "indoor", size: tuple[int, int] = (9, 11)) -> Sample:
    """Make a depth with a long tail, in part unknown or beyond 10 m."""
    rng = np.random.default_rng(seed)
    return sample_of(np.where(rng.random(size) < 0.8, np.exp(rng.normal(0.5, 1, size)), 0), domain=domain)


@pytest.mark.parametrize(
    ("one", "other"),
    [("7.npy", "7_depth.npy"), ("image/7_depth.png", "image/7.npy")],
)
def test_two_files_that_may_be_the_depth_of_a_photo_are_an_error(tmp_path: Path, one: str, other: str) -> None:
    for name, times in ((one, 2), (other, 1)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_maps(tmp_path / name, Maps(times * DEPTH))
    with pytest.raises(InputError, match=r"may both be the depth of image/7\.jpg"):
        FolderSource(tmp_path).predict(named("image/7.jpg"), EVERYWHERE)
    (tmp_path / one).unlink()
    np.testing.assert_array_equal(FolderSource(tmp_path).predict(named("image/7.jpg"), EVERYWHERE).depth, DEPTH)


def test_one_depth_in_two_formats_is_no_matter(tmp_path: Path) -> None:
    for suffix in (".png", ".npy"):  # as `zoedepth predict --save depth npy` writes it
        write_maps(tmp_path / f"7_depth{suffix}", Maps(DEPTH))
    np.testing.assert_array_equal(FolderSource(tmp_path).predict(named("7.jpg"), EVERYWHERE).depth, DEPTH)


def test_names_that_look_the_same_are_found(tmp_path: Path) -> None:
    stored, said = (unicodedata.normalize(form, "Küche/é") for form in ("NFD", "NFC"))
    write_maps(tmp_path / f"{stored}.png", Maps(DEPTH))
    np.testing.assert_array_equal(FolderSource(tmp_path).predict(named(f"{said}.jpg"), EVERYWHERE).depth, DEPTH)


def test_constant_has_the_least_mean_rel_of_all() -> None:
    training = [skewed(seed=seed) for seed in range(3)]
    truth = np.concatenate([sample.target[sample.mask].numpy() for sample in training]).astype(np.float64)
    truth = truth[truth < 10]
    assert len(truth) < sum(int(sample.mask.sum()) for sample in training)

    def rel(constant: float) -> float:
        return float(np.mean(np.abs(truth - constant) / truth))

    best = ConstantSource(training, PROTOCOLS).depth["indoor"]
    assert rel(best) <= min(rel(c) for c in np.concatenate([np.linspace(0.01, 10, 2000), truth])) + 1e-12
    assert rel(best) < rel(float(np.median(truth)))


def test_constant_is_everywhere_at_the_size_of_the_truth() -> None:
    source = ConstantSource([sample_of([[2.0, 2.0, 4.0]])], PROTOCOLS)
    found = source.predict(photo((6, 5)), EVERYWHERE)
    np.testing.assert_array_equal(found.depth, np.full((6, 5), 2.0, np.float32))
    assert (found.std, found.relative) == (None, False)


def test_mean_map_is_the_mean_of_the_known_pixels() -> None:
    rng = np.random.default_rng(0)
    truths = np.where(rng.random((4, *MeanMapSource.SIZE)) < 0.7, rng.uniform(1, 12, (4, *MeanMapSource.SIZE)), 0)
    truths = truths.astype(np.float32)
    source = MeanMapSource([sample_of(truth) for truth in truths], PROTOCOLS)
    known = (truths > 0) & (truths < 10)
    some = known.any(axis=0)
    expected = np.where(known, truths, 0).sum(axis=0, dtype=np.float64)[some] / known.sum(axis=0)[some]
    np.testing.assert_allclose(source.depth["indoor"][some], expected, rtol=1e-6)
    # Holes: nothing is known in a hundredth of the pixels, which have the mean of their row.
    row, column = np.argwhere(~some)[0]
    in_row = truths[:, row][known[:, row]]
    assert source.depth["indoor"][row, column] == pytest.approx(in_row.mean(dtype=np.float64), rel=1e-6)


def test_rows_of_the_mean_map_without_any_depth_have_the_mean_of_all() -> None:
    truth = np.zeros(MeanMapSource.SIZE)
    truth[:100], truth[100:150] = 2.0, 8.0
    depth = MeanMapSource([sample_of(truth)], PROTOCOLS).depth["indoor"]
    assert (depth[:100] == 2).all()
    assert (depth[100:150] == 8).all()
    assert depth[150:] == pytest.approx(4.0)


def test_mean_map_is_given_at_the_size_of_the_truth() -> None:
    rows = np.linspace(2, 6, MeanMapSource.SIZE[0])[:, None] * np.ones((1, MeanMapSource.SIZE[1]))
    source = MeanMapSource([sample_of(rows)], PROTOCOLS)
    found = source.predict(photo((5, 7)), EVERYWHERE).depth
    np.testing.assert_allclose(found, np.array([2.0, 3.0, 4.0, 5.0, 6.0])[:, None] * np.ones((1, 7)), rtol=1e-5)


@pytest.mark.parametrize("kind", [ConstantSource, MeanMapSource])
def test_domains_are_kept_apart(kind: type) -> None:
    training = [sample_of(np.full((4, 4), 2.0)), sample_of(np.full((4, 4), 30.0), domain="outdoor")]
    source = kind(training, PROTOCOLS)
    for domain, depth in (("indoor", 2.0), ("outdoor", 30.0)):
        found = source.predict(photo((3, 3), domain=domain), EVERYWHERE)
        np.testing.assert_allclose(found.depth, depth)


@pytest.mark.parametrize("kind", [ConstantSource, MeanMapSource])
def test_domain_that_was_not_in_the_training_data_is_an_error_that_names_both(kind: type) -> None:
    source = kind([sample_of(np.full((4, 4), 2.0))], PROTOCOLS)
    with pytest.raises(InputError, match=r"'outdoor'.*'indoor'"):
        source.predict(photo((3, 3), domain="outdoor"), EVERYWHERE)


@pytest.mark.parametrize("kind", [ConstantSource, MeanMapSource])
def test_training_data_without_known_depth_is_an_error_that_names_the_domain(kind: type) -> None:
    with pytest.raises(InputError, match="'indoor' has no known depth"):
        kind([sample_of(np.full((4, 4), 20.0))], PROTOCOLS)


@pytest.mark.parametrize("kind", [ConstantSource, MeanMapSource])
def test_training_photos_are_cut_as_the_protocol_says(kind: type) -> None:
    truth = np.full((375, 1242), 1.0)
    truth[23:, 13:1229] = 20.0
    source = kind([sample_of(truth, domain="outdoor")], {"outdoor": OUTDOOR})
    np.testing.assert_allclose(source.depth["outdoor"], 20.0)


@pytest.mark.parametrize("kind", [ConstantSource, MeanMapSource])
def test_training_depth_that_the_mask_hides_is_not_used(kind: type) -> None:
    sample = sample_of([[2.0] * 4, [8.0] * 4])
    hidden = dataclasses.replace(sample, mask=sample.mask & (sample.target < 5))
    found = kind([hidden], PROTOCOLS).predict(photo((6, 8)), EVERYWHERE)
    np.testing.assert_allclose(found.depth, 2.0)


@pytest.mark.parametrize("kind", [ConstantSource, MeanMapSource])
def test_truth_of_the_photo_is_not_looked_at(kind: type) -> None:
    source = kind([skewed(seed=0)], PROTOCOLS)
    sample = photo((6, 8))
    other = dataclasses.replace(sample, target=sample.target + 1)
    np.testing.assert_array_equal(source.predict(sample, EVERYWHERE).depth, source.predict(other, EVERYWHERE).depth)


def test_guesses_are_made_from_the_samples_of_the_domains_that_are_scored(tmp_path: Path) -> None:
    rooms = write_pairs(tmp_path / "rooms", n=3)
    streets = write_pairs(tmp_path / "streets", n=1, domain="outdoor")
    stills = write_disparity_pairs(tmp_path / "stills", n=1)
    protocols = {"indoor": EVERYWHERE}
    found = trivial_sources([rooms, streets, stills], protocols)
    assert tuple(found) == TRIVIAL
    (tmp_path / "lists").mkdir()
    elsewhere = rooms.rename(tmp_path / "lists/rooms.csv")
    moved = trivial_sources([elsewhere], protocols, root=tmp_path / "rooms")
    elsewhere.rename(rooms)
    assert moved[TRIVIAL[0]].predict(photo((6, 8)), EVERYWHERE).depth.max() > 0
    training = [PairDataset(rooms)[i] for i in range(3)]
    constant, mean_map = ConstantSource(training, protocols), MeanMapSource(training, protocols)
    sample = photo((6, 8))
    for source, expected in zip(found.values(), (constant, mean_map), strict=True):
        ours, theirs = (each.predict(sample, EVERYWHERE).depth for each in (source, expected))
        np.testing.assert_array_equal(ours, theirs)
        assert source.about == {"training": [str(path) for path in (rooms, streets, stills)]}
        assert source.state("any.jpg") == expected.state("any.jpg")
        others = [sample_of(np.full((4, 4), 2.0))]
        assert source.state("any.jpg") != type(expected)(others, protocols).state("any.jpg")
        with pytest.raises(InputError, match="'outdoor'"):
            source.predict(photo((6, 8), domain="outdoor"), EVERYWHERE)


# ---------------------------------------------------------------------------------------------------- cropping


@pytest.mark.parametrize("protocol", [OUTDOOR, PLAIN], ids=["cropped", "whole"])
def test_prediction_comes_with_the_sample_it_is_scored_against(protocol: Protocol) -> None:
    sample = photo((375, 1242), domain="outdoor")
    prediction, shown = predict(FactorSource(), sample, protocol)
    expected = kitti_crop()(sample, np.random.default_rng(0)) if protocol.kitti_crop else sample
    for found, wanted in ((shown, expected), (prepare(sample, protocol), expected)):
        assert torch.equal(found.target, wanted.target)
        assert torch.equal(found.image, wanted.image)
    np.testing.assert_array_equal(prediction.depth, expected.target[0].numpy())
    assert prediction.depth.shape == ((352, 1216) if protocol.kitti_crop else (375, 1242))


def file_of(folder: Path, depth: np.ndarray) -> FolderSource:
    np.save(folder / "photo.npy", depth.astype(np.float32))
    return FolderSource(folder)


def test_file_of_the_whole_photo_is_cropped_as_the_photo(tmp_path: Path) -> None:
    sample = photo((375, 1242), domain="outdoor")
    cropped = kitti_crop()(sample, np.random.default_rng(0)).target[0].numpy()
    for depth in (sample.target[0].numpy(), cropped):
        prediction, _ = predict(file_of(tmp_path, depth), sample, OUTDOOR)
        np.testing.assert_array_equal(prediction.depth, cropped)


def test_file_of_another_size_cannot_be_cropped(tmp_path: Path) -> None:
    sample = photo((375, 1242), domain="outdoor")
    source = file_of(tmp_path, np.ones((192, 640)))
    with pytest.raises(InputError, match=r"192 x 640 .*375 x 1242, or .*352 x 1216"):
        predict(source, sample, OUTDOOR)
    assert predict(source, sample, PLAIN)[0].depth.shape == (192, 640)


def test_file_that_lies_on_its_side_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"60 x 40, and photo\.jpg 40 x 60 .*turn one"):
        predict(file_of(tmp_path, np.ones((60, 40))), photo((40, 60)), PLAIN)
    with pytest.raises(InputError, match=r"32 x 24, and photo\.jpg 48 x 64 .*turn one"):
        predict(file_of(tmp_path, np.ones((32, 24))), photo((48, 64)), PLAIN)
    assert predict(file_of(tmp_path, np.ones((40, 40))), photo((40, 40)), PLAIN)[0].depth.shape == (40, 40)


def test_exported_model_predicts_as_many_photos_at_a_time_as_it_was_loaded_for(
    tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its threads are fixed when it is loaded."""
    monkeypatch.setattr("zoedepth.evaluation.predictions.cpu_count", lambda: 3)
    assert ModelSource(tiny_model).workers == 3
    assert ModelSource(load_exported(ASSETS / "zoed-lite.onnx")).workers == 1
    loaded = ModelSource.load("zoed-lite", device="cpu")
    assert loaded.workers == 3
    assert isinstance(loaded.model, OnnxModel)
    assert loaded.model.options["threads"] == 1


def test_fast_model_computes_in_what_was_chosen(tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, object]] = []

    def load(name: object, **options: object) -> Fast:
        asked.append({"name": name, **options})
        return Fast(tiny_model, "torch, bfloat16", "measured", "bfloat16", "cpu")

    monkeypatch.setattr("zoedepth.evaluation.predictions.load_fast", load)
    monkeypatch.setattr("zoedepth.evaluation.predictions.cpu_count", lambda: 3)
    said: list[str] = []
    found = ModelSource.load("zoed-lite", compat=["10m"], fast=True, tell=said.append)
    (options,) = asked
    assert (options["name"], options["compat"], options["streams"]) == ("zoed-lite", ["10m"], 3)
    assert said == ["zoed-lite is computed by torch, bfloat16 (measured)"]
    assert found.about == {"model": "zoed-lite", "compat": ["10m"], "fast": "torch, bfloat16"}
    sample = photo((50, 90))
    depth, expected = (
        source.predict(sample, EVERYWHERE).depth for source in (found, ModelSource(tiny_model, precision="bfloat16"))
    )
    np.testing.assert_array_equal(depth, expected)
    assert not np.array_equal(depth, ModelSource(tiny_model).predict(sample, EVERYWHERE).depth)


def test_scores_of_a_fast_model_belong_to_the_file_that_was_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another one may have been exported from the same weights, in 8 bits for other photos."""
    graph = load_exported(ASSETS / "zoed-lite.onnx")
    fast = Fast(graph, "ONNX Runtime, float32", "measured", "float32", "cpu")
    monkeypatch.setattr("zoedepth.evaluation.predictions.load_fast", lambda name, **options: fast)
    found = ModelSource.load("zoed-lite", fast=True)
    assert found.weights == weights_fingerprint(graph.path) != weights_fingerprint(ASSETS / "zoed-lite.safetensors")
    assert found.about["fast"] == "ONNX Runtime, float32"


def test_model_of_the_package_gives_the_depth_of_torch_and_says_what_computed() -> None:
    loaded, expected = ModelSource.load("zoed-lite", device="cpu"), ModelSource(load_model("zoed-lite"))
    assert loaded.about == {"model": "zoed-lite", "compat": [], "runtime": "ONNX Runtime"}
    sample = photo((60, 80))
    one, other = (source.predict(sample, EVERYWHERE) for source in (loaded, expected))
    np.testing.assert_allclose(one.depth, other.depth, rtol=1e-4)
    assert one.std is not None
    assert other.std is not None
    np.testing.assert_allclose(one.std, other.std, rtol=1e-3)
