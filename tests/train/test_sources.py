"""The data of a training: which data sets, which pairs are held out, and how samples are augmented."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.folders import write_pairs

from zoedepth.data.augment import augment
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.pixels import resize_pixels
from zoedepth.train.config import SourceConfig, TrainConfig
from zoedepth.train.sources import augmentations, load_sources

MakeConfig = Callable[..., TrainConfig]
Data = dict[str, Path]


# ---------------------------------------------------------------------------------------------------- data


def test_data_finds_its_source_by_name(make_config: MakeConfig, data: Data) -> None:
    training, validation = load_sources(make_config(), data)
    assert [(source.name, len(subset)) for source, subset in training] == [("indoor", 4), ("outdoor", 2)]
    assert validation == {}


def test_last_pairs_are_held_out(make_config: MakeConfig, data: Data) -> None:
    training, validation = load_sources(make_config(holdout=1), data)
    assert [len(subset) for _, subset in training] == [3, 1]
    assert [sample.name for sample in validation["indoor"]] == [str(Path("image/train_003.jpg"))]
    assert [sample.name for sample in validation["outdoor"]] == [str(Path("image/train_001.jpg"))]


def test_sources_are_in_the_order_of_the_config(make_config: MakeConfig, data: Data) -> None:
    training, _ = load_sources(make_config(), dict(reversed(data.items())))
    assert [source.name for source, _ in training] == ["indoor", "outdoor"]


def test_disparity_is_held_out_too(make_config: MakeConfig, stills: Path) -> None:
    training, validation = load_sources(make_config("relative", holdout=1), {"relative": stills})
    assert [len(subset) for _, subset in training] == [2]
    assert [sample.name for sample in validation["relative"]] == [str(Path("image/still_002.jpg"))]


def test_unsuitable_data_is_an_error_that_says_why(
    make_config: MakeConfig, data: Data, stills: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"nyu.*indoor.*outdoor"):
        load_sources(make_config(), {"nyu": data["indoor"]})
    with pytest.raises(InputError, match="there is no data to train on"):
        load_sources(make_config(), {})
    with pytest.raises(InputError, match=r"stills.*disparity"):
        load_sources(make_config(), {"relative": stills})
    with pytest.raises(InputError, match="holdout of 2 leaves none"):
        load_sources(make_config(holdout=2), data)
    attic = write_pairs(tmp_path, n=1)
    attic.write_text(attic.read_text().replace(",indoor", ",attic"))
    with pytest.raises(InputError, match=r"photos of \['attic'\], but the model has heads for \['indoor', 'outdoor'\]"):
        load_sources(make_config(), {"indoor": attic})
    # A model of one domain, and stage 1, take any.
    one = make_config(model=dataclasses.replace(make_config().model, domains=make_config().model.domains[:1]))
    load_sources(one, {"indoor": attic})
    load_sources(make_config("relative"), {"indoor": attic})


def test_depth_that_no_photo_has_is_refused_before_stage_2(make_config: MakeConfig, tmp_path: Path) -> None:
    wrong = write_pairs(tmp_path, n=2)
    wrong.write_text(wrong.read_text().replace(",1000,", ",1,"))  # millimetres, said to be metres
    with pytest.raises(
        InputError, match=r"train\.csv: the median depth of its indoor photos is \d+ m.* --config.check off"
    ):
        load_sources(make_config(), {"indoor": wrong})
    load_sources(make_config(check="off"), {"indoor": wrong})
    load_sources(make_config("relative"), {"indoor": wrong})


def test_holes_that_are_stored_as_the_largest_number_are_named(make_config: MakeConfig, tmp_path: Path) -> None:
    listed = write_pairs(tmp_path, n=2)
    assert load_sources(make_config(), {"indoor": listed})[0][0][1].doubts == []
    for file in sorted((tmp_path / "depth").iterdir()):
        stored = np.asarray(Image.open(file)).copy()
        stored[:9] = 65535
        Image.fromarray(stored).save(file)
    (doubt,) = load_sources(make_config(), {"indoor": listed})[0][0][1].doubts
    assert "hold the largest value, 65.535 m" in doubt


def test_data_set_read_by_a_run_is_that_of_its_train_list(make_config: MakeConfig, data: Data) -> None:
    folder = data["indoor"].parent
    training, _ = load_sources(make_config(), {"indoor": folder})
    assert len(training[0][1]) == len(PairDataset(folder / "train.csv"))


# ---------------------------------------------------------------------------------------------------- augmentation

PLAIN = SourceConfig("indoor", rotate_degrees=0.0, color_probability=0.0)


def outdoor_sample(size: tuple[int, int] = (375, 1242)) -> Sample:
    """Depth grows with the columns, 1 to 100 m."""
    target = torch.linspace(1, 100, size[1]).expand(1, *size).clone()
    return Sample(torch.full((3, *size), 0.5), target, target > 0, "depth", "outdoor", "")


@pytest.mark.parametrize("stage", ["relative", "metric"])
@pytest.mark.parametrize("crop", ["fit", "squeeze"])
def test_samples_come_at_the_models_size(make_config: MakeConfig, crop: str, stage: str) -> None:
    source = dataclasses.replace(PLAIN, crop=crop, max_zoom=2.0, kitti_crop=True)
    result = augment(outdoor_sample(), augmentations(source, make_config(stage)), np.random.default_rng(0))
    assert result.image.shape == (3, 64, 64)
    assert result.kind == ("disparity" if stage == "relative" else "depth")


def test_depth_beyond_the_range_of_its_domain_is_unknown(make_config: MakeConfig) -> None:
    result = augment(outdoor_sample(), augmentations(PLAIN, make_config()), np.random.default_rng(0))
    assert 75 < result.target[result.mask].max() < 80
    indoor = dataclasses.replace(outdoor_sample(), domain="indoor")
    result = augment(indoor, augmentations(PLAIN, make_config()), np.random.default_rng(0))
    assert 8 < result.target[result.mask].max() < 10


def test_kitti_crop_leaves_the_top_and_the_sides_out(make_config: MakeConfig) -> None:
    sample = outdoor_sample()
    whole = augment(sample, augmentations(PLAIN, make_config()), np.random.default_rng(0))
    cropped = augment(
        sample, augmentations(dataclasses.replace(PLAIN, kitti_crop=True), make_config()), np.random.default_rng(0)
    )
    # The first column stays the first. 13 of 1242 columns at the left: 13 / 1241 * 99 m more than 1 m.
    assert whole.target.min() == pytest.approx(1)
    assert cropped.target.min() == pytest.approx(1 + 13 / 1241 * 99)


def test_every_number_of_a_source_changes_its_samples(make_config: MakeConfig) -> None:
    changes: dict[str, object] = {
        "crop": "fit",
        "kitti_crop": True,
        "rotate_degrees": 10.0,
        "color_probability": 1.0,
    }
    with_colors: dict[str, object] = {
        "gamma": (2.0, 2.0),
        "brightness": (0.5, 0.5),
        "channel_gain": (0.5, 0.5),
        "saturation": (0.0, 0.0),
    }
    with_fit: dict[str, object] = {"max_zoom": 3.0, "min_zoom": 0.5}
    with_zoom: dict[str, object] = {"zoom_probability": 0.0}
    cases = [
        (PLAIN, changes),
        (dataclasses.replace(PLAIN, color_probability=1.0), with_colors),
        (dataclasses.replace(PLAIN, crop="fit"), with_fit),
        (dataclasses.replace(PLAIN, crop="fit", max_zoom=3.0), with_zoom),
        (dataclasses.replace(PLAIN, crop="window"), {"window": (32, 96)}),
    ]
    tested = {name for _, values in cases for name in values}
    # Fails where a new field has no case. The others are the mixture's, the reader's or the loss's; sparse has its own.
    elsewhere = {
        "name", "weight", "gradient_term", "domain", "depth_scale", "max_depth", "root", "sparse", "focal_px",
        "without_camera", "min_depth",
    }  # fmt: skip
    assert {field.name for field in dataclasses.fields(SourceConfig)} - elsewhere == tested

    rng = np.random.default_rng(0)
    sample = outdoor_sample()
    sample = dataclasses.replace(sample, image=torch.tensor(rng.random(sample.image.shape), dtype=torch.float32))

    def result(source: SourceConfig) -> torch.Tensor:
        augmented = augment(sample, augmentations(source, make_config()), np.random.default_rng(0))
        return torch.cat([augmented.image, augmented.target])

    for source, values in cases:
        for name, value in values.items():
            assert not torch.equal(result(source), result(dataclasses.replace(source, **{name: value}))), name


def test_half_of_the_samples_are_mirrored(make_config: MakeConfig) -> None:
    steps = augmentations(PLAIN, make_config())
    samples = [augment(outdoor_sample((64, 64)), steps, np.random.default_rng(seed)) for seed in range(40)]
    mirrored = [sample.target[0, 0, 0] > sample.target[0, 0, 40] for sample in samples]
    assert 10 <= sum(mirrored) <= 30


@pytest.mark.parametrize(("crop", "side"), [("fit", 256), ("squeeze", 256), ("window", 32)])
def test_scattered_points_are_kept_and_not_multiplied_where_the_source_says_so(
    make_config: MakeConfig, crop: str, side: int
) -> None:
    """A window resizes only a photo that is smaller than it."""
    sample = outdoor_sample((side, side))
    mask = torch.rand(1, side, side, generator=torch.Generator().manual_seed(0)) < 0.01
    sample = dataclasses.replace(sample, mask=mask, target=sample.target * mask)
    known = {}
    for sparse in (False, True):
        source = dataclasses.replace(PLAIN, crop=crop, sparse=sparse)
        result = augment(sample, augmentations(source, make_config()), np.random.default_rng(0))
        known[sparse] = int(result.mask.sum())
    if side > 64:  # every n-th pixel of the photo, or every point of it
        assert known[True] > 8 * known[False]
    else:  # every point once, or as often as the photo is enlarged
        assert known[False] > 2 * known[True] > 0


# ---------------------------------------------------------------------------------------------------- one camera


def canonical(config: TrainConfig, **fields: object) -> TrainConfig:
    """The config of a model in one camera: 50 pixels indoors, 100 outdoors."""
    focal = {"indoor": 50.0, "outdoor": 100.0}
    domains = tuple(dataclasses.replace(each, focal_px=focal[each.name]) for each in config.model.domains)
    model = dataclasses.replace(config.model, domains=domains, canonical_camera=True)
    sources = tuple(dataclasses.replace(source, **fields) for source in config.sources)
    return dataclasses.replace(config, model=model, sources=sources)


def test_depth_is_scaled_to_the_one_camera_before_it_is_limited(make_config: MakeConfig) -> None:
    sample = dataclasses.replace(outdoor_sample((64, 64)), camera=Intrinsics(200.0, 200.0, 31.5, 31.5))
    config = canonical(make_config())
    result = augment(sample, augmentations(PLAIN, config), np.random.default_rng(0))
    # 1 to 100 m through a lens of twice the focal length: 0.5 to 50 m in the one camera, and nothing is beyond 80 m.
    assert result.mask.all()
    assert result.target.max() == pytest.approx(50, rel=0.03)
    rooms = dataclasses.replace(sample, domain="indoor")
    near = augment(rooms, augmentations(PLAIN, config), np.random.default_rng(0))
    assert 9.5 < near.target[near.mask].max() < 10, "10 m of the one camera are 40 m of this lens"
    # Disparity has no scale, and stage 1 asks for no camera.
    stills = augmentations(PLAIN, canonical(make_config("relative")))
    assert augment(outdoor_sample(), stills, np.random.default_rng(0)).kind == "disparity"


def test_data_without_cameras_is_refused_unless_a_lens_is_given_or_assumed(
    make_config: MakeConfig, tmp_path: Path
) -> None:
    bare = write_pairs(tmp_path / "bare", n=3, size=(64, 64))
    with pytest.raises(InputError, match=r"indoor says no camera for \S*train_000\.jpg.* focal_px of the source"):
        load_sources(canonical(make_config()), {"indoor": bare})
    load_sources(canonical(make_config("relative")), {"indoor": bare})
    load_sources(make_config(), {"indoor": bare})

    def first(config: TrainConfig) -> tuple[Sample, Sample]:
        """The first sample of training, augmented, and the one that is validated on."""
        training, validation = load_sources(dataclasses.replace(config, holdout=1), {"indoor": bare})
        source, samples = training[0]
        return augment(samples[0], augmentations(source, config), np.random.default_rng(0)), validation["indoor"][0]

    plain = {"rotate_degrees": 0.0, "color_probability": 0.0}
    assumed, held_out = first(canonical(make_config(), **plain, without_camera="assume"))
    assert held_out.camera is None
    given, held_out = first(canonical(make_config(), **plain, focal_px=25.0))
    assert held_out.camera == Intrinsics(25.0, 25.0, 31.5, 31.5)
    assert torch.equal(given.image, assumed.image)
    both = given.mask & assumed.mask
    torch.testing.assert_close(given.target[both], 2 * assumed.target[both])


# ---------------------------------------------------------------------------------------------------- resizing


@pytest.mark.parametrize("crop", ["fit", "squeeze"])
@pytest.mark.parametrize("antialias", [True, False])
def test_training_resizes_photos_as_the_model_does_when_it_predicts(
    make_config: MakeConfig, crop: str, antialias: bool
) -> None:
    config = make_config()
    config = dataclasses.replace(config, model=dataclasses.replace(config.model, antialias=antialias))
    size = (4 * config.model.size[0], 4 * config.model.size[1])
    image = (torch.arange(size[1]) % 3 == 0).float().expand(3, *size).clone()  # fine stripes
    sample = dataclasses.replace(outdoor_sample(size), image=image)
    steps = augmentations(dataclasses.replace(PLAIN, crop=crop), config)
    found = next(  # one that was not mirrored
        result
        for seed in range(9)
        if (result := augment(sample, steps, np.random.default_rng(seed))).target[0, 0, 0]
        < result.target[0, 0, -1].clamp(min=1)
    )
    expected = resize_pixels(image[None], config.model.size, antialias=antialias)[0]
    # To turn it by nothing costs a rounding.
    torch.testing.assert_close(found.image, expected, rtol=0, atol=1e-4)
    assert (found.image.std() < 0.1) == antialias


@pytest.mark.parametrize("antialias", [True, False])
@pytest.mark.parametrize("sparse", [True, False])
def test_depth_stays_where_the_photo_shows_it(make_config: MakeConfig, antialias: bool, sparse: bool) -> None:
    """The photo is as red as its depth is far, and smooth: after resizing, both still say the same everywhere."""
    config = make_config()
    config = dataclasses.replace(config, model=dataclasses.replace(config.model, antialias=antialias))
    size = (150, 240)
    slope = 0.5 * torch.linspace(0.1, 0.9, size[1]) + 0.5 * torch.linspace(0.1, 0.9, size[0])[:, None]
    sample = Sample(slope.expand(3, *size).clone(), 10 * slope[None], slope[None] > 0, "depth", "outdoor", "")
    source = dataclasses.replace(PLAIN, sparse=sparse)
    found = augment(sample, augmentations(source, config), np.random.default_rng(0))
    assert found.mask.all()
    error = 10 * found.image[:1] - found.target
    assert error.abs().max() < 10 * 1.6 * 0.4 * (1 / 150 + 1 / 240)  # a pixel and a half of the photo, both ways
    if not sparse:  # where several points fall together, the nearest wins
        assert abs(error.mean()) < 1e-3


def test_truth_keeps_its_size_where_the_loss_is_taken_there(make_config: MakeConfig) -> None:
    sample = outdoor_sample((375, 1242))
    lidar = dataclasses.replace(sample, mask=torch.rand(1, 375, 1242, generator=torch.Generator().manual_seed(0)) < 0.1)
    source = dataclasses.replace(PLAIN, kitti_crop=True, sparse=True)
    kept = augment(lidar, augmentations(source, make_config(loss_size="truth")), np.random.default_rng(0))
    gathered = augment(lidar, augmentations(source, make_config()), np.random.default_rng(0))
    assert (kept.image.shape, kept.target.shape, kept.mask.shape) == ((3, 64, 64), (1, 352, 1216), (1, 352, 1216))
    known = lidar.mask[:, 23:, 13:1229] & (sample.target[:, 23:, 13:1229] < 80)
    assert kept.mask.sum() == known.sum() > 5 * gathered.mask.sum()  # none is lost, and the small picture has no room
    assert gathered.target.shape == (1, 64, 64)
    with pytest.raises(InputError, match="set loss_size to 'network'"):
        make_config(loss_size="truth", sources=(dataclasses.replace(PLAIN, crop="fit"),))


def test_a_degree_is_a_degree_of_the_photo_before_it_is_squeezed(make_config: MakeConfig) -> None:
    """A vertical line of KITTI, turned by 1 degree, leans by its height times tan(1 degree) of the photo's pixels."""
    image = torch.zeros(3, 352, 1216)
    image[:, :, 604:612] = 1
    sample = dataclasses.replace(outdoor_sample((352, 1216)), image=image)
    leaning = []
    config = make_config()
    config = dataclasses.replace(config, model=dataclasses.replace(config.model, antialias=True))
    for seed in range(6):
        source = dataclasses.replace(PLAIN, rotate_degrees=1.0)
        found = augment(sample, augmentations(source, config), np.random.default_rng(seed))
        places = torch.arange(64.0)
        top, bottom = ((found.image[0, row] * places).sum() / found.image[0, row].sum() for row in (4, -5))
        rng = np.random.default_rng(seed)
        rng.random()  # whether it is mirrored
        angle = np.radians(rng.uniform(-1, 1))
        leaning.append((abs(float(bottom - top)) * 1216 / 64, abs(np.tan(angle)) * 352 * 55 / 64))
    for measured, expected in leaning:
        assert measured == pytest.approx(expected, abs=0.5)


def test_source_can_leave_out_what_is_too_near(make_config: MakeConfig) -> None:
    source = dataclasses.replace(PLAIN, min_depth=5.0)
    result = augment(outdoor_sample(), augmentations(source, make_config()), np.random.default_rng(0))
    assert 5 < result.target[result.mask].min() < 7
