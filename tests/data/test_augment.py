"""Augmentations: what moves a pixel moves its depth along, and depth stays what a camera would measure."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from zoedepth.data import augment
from zoedepth.data.augment import Augmentation
from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

GROUND, MARK = 3.0, 7.0
"""Depth (metres) of the black ground and of the white mark on it."""


def marked(size: tuple[int, int], top: int, left: int, *, side: int = 9) -> Sample:
    """A black photo of depth GROUND with a white square of depth MARK; everything is known."""
    image, target = torch.zeros(3, *size), torch.full((1, *size), GROUND)
    image[:, top : top + side, left : left + side] = 1
    target[:, top : top + side, left : left + side] = MARK
    return Sample(image, target, torch.ones(1, *size, dtype=torch.bool), "depth", "indoor", "marked")


def noise(size: tuple[int, int], *, seed: int = 0) -> Sample:
    """A photo and depths (1 to 9 m) at random, a third of the depths unknown."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1, 9, size=(1, *size)) * (rng.random((1, *size)) > 1 / 3)
    target = torch.tensor(depth, dtype=torch.float32)
    image = torch.tensor(rng.random((3, *size)), dtype=torch.float32)
    return Sample(image, target, target > 0, "depth", "indoor", "noise")


def centroid(where: torch.Tensor) -> tuple[float, float]:
    """Mean row and column of the True pixels of (height, width)."""
    rows, columns = where.nonzero(as_tuple=True)
    return rows.float().mean().item(), columns.float().mean().item()


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


EVERY: dict[str, Augmentation] = {
    "fit_crop": augment.fit_crop((32, 48), max_zoom=2.0),
    "fit_crop, framed": augment.fit_crop((32, 48), min_zoom=0.5, max_zoom=2.0),
    "window": augment.window((32, 48)),
    "squeeze": augment.squeeze((32, 48)),
    "kitti_crop": augment.kitti_crop(),
    "flip": augment.flip(),
    "rotate": augment.rotate(degrees=20.0),
    "jitter_colors": augment.jitter_colors(saturation=(0.0, 2.0)),
    "limit_depth": augment.limit_depth(2.0, 8.0),
    "to_disparity": augment.to_disparity(),
}


@pytest.mark.parametrize("name", EVERY)
def test_result_is_a_function_of_sample_and_generator_and_the_sample_is_left_alone(name: str) -> None:
    before, sample = noise((60, 90)), noise((60, 90))

    first, second = EVERY[name](sample, rng(3)), EVERY[name](sample, rng(3))

    for field in ("image", "target", "mask"):
        assert torch.equal(getattr(first, field), getattr(second, field))
        assert torch.equal(getattr(sample, field), getattr(before, field))


@pytest.mark.parametrize("name", ["fit_crop", "window", "flip", "rotate", "jitter_colors"])
def test_other_draws_give_other_results(name: str) -> None:
    results = [EVERY[name](noise((60, 90)), rng(seed)).image for seed in range(8)]
    assert any(not torch.equal(results[0], result) for result in results[1:])


@pytest.mark.parametrize("name", EVERY)
def test_shapes_agree_and_unknown_stays_unknown(name: str) -> None:
    for seed in range(4):
        result = EVERY[name](noise((60, 90), seed=seed), rng(seed))
        assert result.image.shape[-2:] == result.target.shape[-2:] == result.mask.shape[-2:]
        assert result.image.min() >= 0
        assert result.image.max() <= 1
        if name != "to_disparity":  # there 0 is the farthest known, too
            assert (result.target[result.mask] > 0).all()


@pytest.mark.parametrize("name", ["squeeze", "kitti_crop", "flip", "rotate"])
def test_depths_are_moved_never_invented(name: str) -> None:
    sample = noise((60, 90))
    result = EVERY[name](sample, rng(1))
    known = result.target[result.mask]
    assert len(known) > 0
    assert torch.isin(known, sample.target[sample.mask]).all()


def test_zoomed_depths_are_the_old_ones_over_one_factor_never_invented() -> None:
    sample = noise((60, 90))
    result = augment.fit_crop((32, 48), max_zoom=2.0)(sample, rng(1))
    known = result.target[result.mask].double()
    old = sample.target[sample.mask].double()
    # The factor that takes the first known depth to one of the old ones must take all of them.
    factors = old / known[0]
    assert any(
        (known[:, None] * factor - old[None]).abs().min(dim=1).values.max() < 1e-5
        for factor in factors[(factors >= 1) & (factors <= 2)]
    )


def test_augmentations_are_applied_in_order() -> None:
    sample = marked((40, 60), 0, 0)
    wide, tall = augment.squeeze((20, 80)), augment.squeeze((80, 20))
    assert augment.augment(sample, [wide, tall], rng()).image.shape == (3, 80, 20)
    assert augment.augment(sample, [tall, wide], rng()).image.shape == (3, 20, 80)
    assert augment.augment(sample, [], rng()) is sample


# ---------------------------------------------------------------------------------------------------- flip


def test_flip_mirrors_photo_depth_and_mask_alike() -> None:
    sample = noise((6, 7))
    result = augment.flip(probability=1.0)(sample, rng())
    for row in range(6):
        for column in range(7):
            assert torch.equal(result.image[:, row, column], sample.image[:, row, 6 - column])
            assert result.target[0, row, column] == sample.target[0, row, 6 - column]
            assert result.mask[0, row, column] == sample.mask[0, row, 6 - column]


def test_flip_happens_with_its_probability() -> None:
    sample = marked((20, 20), 0, 0)
    generator = rng()
    flipped = sum(
        augment.flip(probability=0.25)(sample, generator).target[0, 0, 0].item() == GROUND for _ in range(2000)
    )
    assert 0.25 * 2000 - 100 < flipped < 0.25 * 2000 + 100  # 5 standard deviations
    assert augment.flip(probability=0.0)(sample, rng()).target[0, 0, 0] == MARK


# ---------------------------------------------------------------------------------------------------- rotate


@pytest.mark.parametrize("size", [(60, 120), (120, 60), (81, 81)])
def test_rotation_moves_the_mark_with_its_depth_on_a_circle_about_the_centre(size: tuple[int, int]) -> None:
    sample = marked(size, size[0] // 4, size[1] // 4)
    centre = ((size[0] - 1) / 2, (size[1] - 1) / 2)
    before = centroid(sample.target[0] == MARK)
    before = complex(before[1] - centre[1], before[0] - centre[0])
    angles = []
    for seed in range(12):
        result = augment.rotate(degrees=15.0)(sample, rng(seed))
        depth = centroid(result.target[0] == MARK)
        photo = centroid(result.image[0] > 0.5)
        assert depth == pytest.approx(photo, abs=0.3)
        after = complex(depth[1] - centre[1], depth[0] - centre[0])
        # On a circle in pixels, whatever the shape of the picture.
        assert abs(after) == pytest.approx(abs(before), abs=0.4)
        angles.append(math.degrees(np.angle(after / before)))
    assert max(map(abs, angles)) <= 15.5
    assert min(angles) < -5
    assert max(angles) > 5


def test_rotated_in_corners_are_black_and_unknown() -> None:
    size = (41, 61)
    sample = Sample(
        torch.ones(3, *size), torch.full((1, *size), GROUND), torch.ones(1, *size, dtype=torch.bool), "depth", "", ""
    )
    # Of 8 draws from +-45 degrees, one is large enough to turn the corners out of the picture.
    results = [augment.rotate(degrees=45.0)(sample, rng(seed)) for seed in range(8)]
    result = min(results, key=lambda result: int(result.mask.sum()))
    for row, column in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        assert not result.mask[0, row, column]
        assert (result.image[:, row, column] == 0).all()
    assert result.mask[0, 20, 30]
    assert (result.target[result.mask] == GROUND).all()


def test_rotation_by_zero_degrees_changes_nothing() -> None:
    sample = noise((30, 50))
    result = augment.rotate(degrees=0.0)(sample, rng())
    torch.testing.assert_close(result.image, sample.image, atol=1e-4, rtol=0)
    assert torch.equal(result.target * result.mask, sample.target)
    assert torch.equal(result.mask, sample.mask)


# ---------------------------------------------------------------------------------------------------- crops and sizes


@pytest.mark.parametrize(("size", "target"), [((64, 96), (32, 48)), ((64, 96), (32, 32)), ((50, 40), (32, 64))])
def test_squeeze_keeps_the_whole_photo_and_its_depth(size: tuple[int, int], target: tuple[int, int]) -> None:
    top, left, side = 20, 16, 16
    result = augment.squeeze(target)(marked(size, top, left, side=side), rng())

    assert result.image.shape == (3, *target)
    assert set(result.target.unique().tolist()) == {GROUND, MARK}
    rows, columns = target[0] / size[0], target[1] / size[1]
    middle = ((top + side / 2) * rows - 0.5, (left + side / 2) * columns - 0.5)
    assert centroid(result.target[0] == MARK) == pytest.approx(middle, abs=0.5)
    assert centroid(result.image[0] > 0.5) == pytest.approx(middle, abs=0.5)


@pytest.mark.parametrize("size", [(480, 640), (352, 1216), (300, 200)])
def test_fit_crop_without_zoom_takes_the_largest_window_of_the_shape(size: tuple[int, int]) -> None:
    height, width = size
    ramp = torch.arange(width).expand(size)[None] + 1.0
    image = torch.zeros(3, *size)
    sample = Sample(image, ramp, torch.ones_like(ramp, dtype=torch.bool), "depth", "", "")
    result = augment.fit_crop((64, 96))(sample, rng())

    assert result.image.shape == (3, 64, 96)
    # Columns were numbered: from the first to the last seen is the width of the window.
    seen = (result.target.max() - result.target.min()).item() * 96 / 95
    assert seen == pytest.approx(min(width, height * 96 / 64), rel=0.02)


@pytest.mark.parametrize("size", [(128, 192), (96, 256)])
def test_zoom_by_z_magnifies_by_z_and_divides_depth_by_z(size: tuple[int, int]) -> None:
    # The mark lies in the middle and is small, so most windows hold all of it.
    sample = marked(size, size[0] // 2 - 8, size[1] // 2 - 8, side=16)
    fit = max(64 / size[0], 96 / size[1])
    zooms = []
    for seed in range(40):
        result = augment.fit_crop((64, 96), max_zoom=2.0)(sample, rng(seed))
        near, far = result.target.min().item(), result.target.max().item()
        zoom = GROUND / near
        zooms.append(zoom)
        assert 1 <= zoom <= 2
        photo = result.image[0] > 0.5
        inside = photo.any() and not (photo[0].any() or photo[-1].any() or photo[:, 0].any() or photo[:, -1].any())
        if not inside:
            continue
        assert far == pytest.approx(MARK / zoom, rel=1e-5)
        assert photo.any(dim=0).sum() == pytest.approx(16 * fit * zoom, abs=1.5)
        assert photo.any(dim=1).sum() == pytest.approx(16 * fit * zoom, abs=1.5)
        assert centroid(result.target[0] == far) == pytest.approx(centroid(photo), abs=0.6)
    assert min(zooms) < 1.2 < 1.7 < max(zooms)
    # Log-uniform: half of the zooms are below sqrt(2).
    assert 10 < sum(zoom < math.sqrt(2) for zoom in zooms) < 30


def test_window_lies_anywhere_in_the_photo() -> None:
    size = (64, 256)
    columns = torch.arange(256).expand(size)[None] + 1.0
    sample = Sample(torch.zeros(3, *size), columns, torch.ones(1, *size, dtype=torch.bool), "depth", "", "")
    firsts = [augment.fit_crop((32, 32))(sample, rng(seed)).target.min().item() for seed in range(60)]
    assert min(firsts) < 20
    assert max(firsts) > 256 - 64 - 20


def test_window_of_pixels_is_a_piece_of_the_photo_as_it_is() -> None:
    sample = noise((60, 90))
    places = set()
    for seed in range(40):
        cut = augment.window((32, 48))(sample, rng(seed))
        found = [
            (top, left)
            for top in range(60 - 32 + 1)
            for left in range(90 - 48 + 1)
            if torch.equal(sample.image[:, top : top + 32, left : left + 48], cut.image)
        ]
        assert len(found) == 1
        top, left = found[0]
        assert torch.equal(sample.target[:, top : top + 32, left : left + 48], cut.target)
        places.add((top, left))
    assert len(places) > 30


def test_window_larger_than_the_photo_is_its_largest_part_of_that_shape() -> None:
    cut = augment.window((64, 96))(marked((40, 120), 10, 50), rng())
    assert cut.image.shape == (3, 64, 96)
    assert set(cut.target.unique().tolist()) <= {GROUND, MARK}


def test_share_of_zoomed_samples_is_the_probability() -> None:
    sample = marked((40, 60), 10, 10)
    apply, generator = augment.fit_crop((32, 48), max_zoom=2.0, probability=0.25), rng()
    n_zoomed = sum(apply(sample, generator).target.min().item() < GROUND for _ in range(400))
    assert 60 < n_zoomed < 140


def test_change_of_focal_length_leaves_depth() -> None:
    apply = augment.fit_crop((64, 96), max_zoom=2.0, scale_depth=False)
    for seed in range(8):
        assert set(apply(marked((128, 192), 60, 90), rng(seed)).target.unique().tolist()) <= {GROUND, MARK}


def test_zoom_leaves_disparity_which_has_no_scale() -> None:
    sample = marked((128, 192), 60, 90)
    sample = Sample(sample.image, sample.target, sample.mask, "disparity", "", "")
    for seed in range(8):
        result = augment.fit_crop((64, 96), max_zoom=2.0)(sample, rng(seed))
        assert set(result.target.unique().tolist()) <= {GROUND, MARK}


@pytest.mark.parametrize(
    ("size", "rows", "columns"),
    [
        ((375, 1242), (23, 375), (13, 1229)),
        ((370, 1226), (18, 370), (5, 1221)),
        ((376, 1241), (24, 376), (12, 1228)),
        ((352, 1216), (0, 352), (0, 1216)),
        ((300, 1000), (0, 300), (0, 1000)),
        ((300, 1300), (0, 300), (0, 1300)),
        ((1080, 1920), (0, 1080), (0, 1920)),  # no frame of KITTI
        ((480, 640), (0, 480), (0, 640)),
    ],
)
def test_kitti_crop_is_the_bottom_centre(
    size: tuple[int, int], rows: tuple[int, int], columns: tuple[int, int]
) -> None:
    number = torch.arange(size[0] * size[1], dtype=torch.float64).reshape(1, *size)
    sample = Sample(number.expand(3, -1, -1).float() * 0, number.float(), number % 2 == 0, "depth", "", "")
    result = augment.kitti_crop()(sample, rng())
    assert torch.equal(result.target, sample.target[:, rows[0] : rows[1], columns[0] : columns[1]])
    assert torch.equal(result.mask, sample.mask[:, rows[0] : rows[1], columns[0] : columns[1]])
    assert result.image.shape == (3, rows[1] - rows[0], columns[1] - columns[0])


# ---------------------------------------------------------------------------------------------------- values


def test_colors_change_as_their_ranges_say_and_depth_does_not() -> None:
    sample = noise((8, 8))
    apply = augment.jitter_colors(probability=1.0, gamma=(2, 2), brightness=(0.5, 0.5), channel_gain=(0.8, 0.8))
    result = apply(sample, rng())
    torch.testing.assert_close(result.image, 0.4 * sample.image**2)
    assert torch.equal(result.target, sample.target)
    assert torch.equal(result.mask, sample.mask)


def test_no_saturation_is_grey_and_twice_is_farther_from_grey() -> None:
    sample = noise((8, 8))
    sample = Sample(0.4 + 0.2 * sample.image, sample.target, sample.mask, "depth", "", "")
    same = {"probability": 1.0, "gamma": (1, 1), "brightness": (1, 1), "channel_gain": (1, 1)}
    mean = sample.image.mean(dim=0, keepdim=True).expand(3, -1, -1)

    grey = augment.jitter_colors(**same, saturation=(0, 0))(sample, rng()).image
    strong = augment.jitter_colors(**same, saturation=(2, 2))(sample, rng()).image

    torch.testing.assert_close(grey, mean)
    torch.testing.assert_close(strong - mean, 2 * (sample.image - mean))


def test_each_channel_has_its_own_gain() -> None:
    sample = Sample(torch.full((3, 4, 4), 0.5), torch.ones(1, 4, 4), torch.ones(1, 4, 4) > 0, "depth", "", "")
    apply = augment.jitter_colors(probability=1.0, gamma=(1, 1), brightness=(1, 1), channel_gain=(0.5, 1.5))
    image = apply(sample, rng()).image
    assert len(image[:, 0, 0].unique()) == 3
    assert all(len(channel.unique()) == 1 for channel in image)


def test_colors_stay_without_probability() -> None:
    sample = noise((8, 8))
    assert torch.equal(augment.jitter_colors(probability=0.0)(sample, rng()).image, sample.image)


def test_depth_at_or_beyond_the_bounds_is_unknown() -> None:
    target = torch.tensor([[[0.0, 0.5, 1.0, 1.01, 9.99, 10.0, 60.0]]])
    sample = Sample(torch.zeros(3, 1, 7), target, target > 0, "depth", "", "")
    result = augment.limit_depth(1.0, 10.0)(sample, rng())
    assert result.mask[0, 0].tolist() == [False, False, False, True, True, False, False]
    assert torch.equal(result.target, target)


def test_bounds_on_depth_leave_disparity() -> None:
    target = torch.tensor([[[0.0, 0.5, 200.0]]])
    sample = Sample(torch.zeros(3, 1, 3), target, target > 0, "disparity", "", "")
    assert augment.limit_depth(1.0, 10.0)(sample, rng()).mask[0, 0].tolist() == [False, True, True]


def test_disparity_of_depth_is_its_inverse_scaled_to_the_unit_range() -> None:
    # 1/1 = 1, 1/2 = 0.5, 1/4 = 0.25: (x - 0.25) / 0.75.
    target = torch.tensor([[[1.0, 2.0, 4.0, 0.0]]])
    sample = Sample(torch.zeros(3, 1, 4), target, target > 0, "depth", "", "")
    result = augment.to_disparity()(sample, rng())
    torch.testing.assert_close(result.target, torch.tensor([[[1.0, 1 / 3, 0.0, 0.0]]]))
    assert torch.equal(result.mask, sample.mask)
    assert result.kind == "disparity"


def test_disparity_spans_the_unit_range_in_the_order_reversed_to_depth() -> None:
    sample = noise((20, 30))
    result = augment.to_disparity()(sample, rng())
    known = result.target[result.mask]
    assert (known.min(), known.max()) == (0, 1)
    order = sample.target[sample.mask].argsort()
    assert (known[order].diff() <= 0).all()
    assert (result.target[~result.mask] == 0).all()


def test_disparity_of_disparity_keeps_its_order() -> None:
    target = torch.tensor([[[51.0, 255.0, 0.0, 153.0]]])
    sample = Sample(torch.zeros(3, 1, 4), target, target > 0, "disparity", "", "")
    result = augment.to_disparity()(sample, rng())
    torch.testing.assert_close(result.target, torch.tensor([[[0.0, 1.0, 0.0, 0.5]]]))


@pytest.mark.parametrize("value", [0.0, 2.0], ids=["all unknown", "all equal"])
def test_disparity_without_contrast_is_zero(value: float) -> None:
    target = torch.full((1, 3, 4), value)
    result = augment.to_disparity()(Sample(torch.zeros(3, 3, 4), target, target > 0, "depth", "", ""), rng())
    assert (result.target == 0).all()
    assert result.kind == "disparity"


# --- scattered points -----------------------------------------------------------------------------------------------


def test_every_scattered_point_is_kept_and_the_nearest_of_a_pixel_wins():
    """Four by four to two by two: each quarter keeps its nearest point; every second pixel would have found one."""
    depth = torch.zeros(1, 4, 4)
    for row, column, metres in ((0, 1, 7.0), (1, 1, 3.0), (1, 2, 5.0), (3, 3, 2.0)):
        depth[0, row, column] = metres
    target, known = augment.gather_points(depth, depth > 0, (2, 2), nearest_is_smallest=True)
    assert target.tolist() == [[[3.0, 5.0], [0.0, 2.0]]]
    assert known.tolist() == [[[True, True], [False, True]]]
    target, _ = augment.gather_points(depth, depth > 0, (2, 2), nearest_is_smallest=False)
    assert target.tolist() == [[[7.0, 5.0], [0.0, 2.0]]]


def test_squeezed_lidar_keeps_its_points():
    depth = torch.where(torch.rand(1, 64, 96, generator=torch.Generator().manual_seed(0)) < 0.01, 5.0, 0.0)
    lidar = Sample(torch.zeros(3, 64, 96), depth, depth > 0, "depth", "outdoor", "")
    sparse = augment.squeeze((32, 48), sparse=True)(lidar, rng())
    dense = augment.squeeze((32, 48))(lidar, rng())
    assert sparse.mask.sum() > 0.9 * lidar.mask.sum()
    assert dense.mask.sum() < 0.5 * lidar.mask.sum()
    assert (sparse.target[sparse.mask] == 5).all()


# --- one camera -----------------------------------------------------------------------------------------------------


def seen(size: tuple[int, int] = (60, 90), *, focal: float = 80.0, depth: float = 4.0) -> Sample:
    """A photo of a wall at one depth, whose camera looks through its middle."""
    camera = Intrinsics(focal, focal, (size[1] - 1) / 2, (size[0] - 1) / 2)
    return replace(
        noise(size), target=torch.full((1, *size), depth), mask=torch.ones(1, *size, dtype=bool), camera=camera
    )


def test_canonical_depth_is_the_depth_times_the_ratio_of_the_focal_lengths() -> None:
    result = augment.canonical_camera({"indoor": 100.0, "outdoor": 7.0}, data="rooms")(seen(), rng())
    assert torch.allclose(result.target, torch.tensor(4.0 * 100 / 80))
    assert result.camera == Intrinsics(100.0, 100.0, 44.5, 29.5)
    street = replace(seen(), domain="outdoor")
    assert augment.canonical_camera({"indoor": 100.0, "outdoor": 7.0}, data="x")(street, rng()).camera.fx == 7
    # A model of one domain takes every photo; of two focal lengths the vertical one counts.
    oblong = replace(seen(), domain="attic", camera=Intrinsics(50.0, 200.0, 44.5, 29.5))
    result = augment.canonical_camera({"indoor": 300.0}, data="x")(oblong, rng())
    assert torch.allclose(result.target, torch.tensor(6.0))
    assert result.camera == Intrinsics(75.0, 300.0, 44.5, 29.5)


@pytest.mark.parametrize("scale_depth", [True, False])
@pytest.mark.parametrize(("low", "high"), [(1.0, 1.0), (1.0, 3.0), (0.5, 1.0)])
def test_a_zoom_is_a_change_of_the_lens_in_a_canonical_camera(low: float, high: float, scale_depth: bool) -> None:
    """However the zoom is told, twice as large a picture of a wall is one at half the canonical depth."""
    canonical = augment.canonical_camera({"indoor": 100.0}, data="rooms")
    for seed in range(6):
        crop = augment.fit_crop((32, 48), min_zoom=low, max_zoom=high, scale_depth=scale_depth)
        cropped = crop(seen(), rng(seed))
        assert cropped.camera is not None
        zoomed = augment.fit_crop((32, 48), min_zoom=low, max_zoom=high, scale_depth=False)(seen(), rng(seed))
        result = canonical(cropped, rng())
        assert result.target[result.mask].unique().numpy() == pytest.approx(4.0 * 100 / zoomed.camera.fy, rel=0.03)
        assert result.camera.fy == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("change", "side"),
    [
        (augment.squeeze((96, 80)), 1),
        (augment.window((90, 120)), 1),
        (augment.fit_crop((60, 80)), 1),
        (augment.fit_crop((60, 80), max_zoom=1.3, scale_depth=False), 1),
        (augment.fit_crop((120, 160), min_zoom=0.5, scale_depth=False), 1),
        (augment.flip(probability=1.0), -1),
        (augment.canonical_camera({"indoor": 300.0}, data="rooms"), 1),
    ],
    ids=["squeeze", "window", "fit", "zoom", "framed", "flip", "canonical"],
)
def test_camera_puts_a_thing_as_far_to_the_side_as_before(change: Augmentation, side: int) -> None:
    """Metres to the right and down, (u - cx) / fx z: cropping and resizing keep the point, the one camera only moves
    it along the axis, and the mirror takes it to the other side."""
    sample = replace(marked((120, 160), 60, 90, side=15), camera=Intrinsics(150.0, 140.0, 80.0, 57.0))

    def place(found: Sample) -> tuple[float, float]:
        row, column = centroid(found.target[0] > (GROUND + MARK) / 2 * found.target.max() / MARK)
        assert found.camera is not None
        z = found.target.max().item()
        return (row - found.camera.cy) / found.camera.fy * z, (column - found.camera.cx) / found.camera.fx * z

    (down, right), (new_down, new_right) = place(sample), place(change(sample, rng(2)))
    assert new_down == pytest.approx(down, abs=0.05)
    assert right > 0.5
    assert new_right == pytest.approx(side * right, abs=0.05)


def test_photo_without_a_camera_is_refused_by_name_or_taken_as_it_is() -> None:
    bare = replace(seen(), camera=None)
    with pytest.raises(InputError, match=r"rooms says no camera for noise, .* fx, fy, cx, cy .* without_camera"):
        augment.canonical_camera({"indoor": 100.0}, data="rooms")(bare, rng())
    assert augment.canonical_camera({"indoor": 100.0}, data="rooms", assume=True)(bare, rng()) is bare
    known = augment.assume_camera(80.0)(bare, rng())
    assert known.camera == Intrinsics(80.0, 80.0, 44.5, 29.5)
    assert augment.assume_camera(33.0)(known, rng()) is known
    for focal_px in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="focal_px must be above 0 and finite"):
            augment.assume_camera(focal_px)
    disparity = replace(bare, kind="disparity")
    assert augment.canonical_camera({"indoor": 100.0}, data="rooms")(disparity, rng()) is disparity


def test_zoom_out_puts_the_photo_in_the_middle_of_its_own_reflection() -> None:
    sample = seen((32, 48))
    result = augment.fit_crop((32, 48), min_zoom=0.5, max_zoom=1.0)(sample, rng(1))
    rows, columns = result.mask[0].any(1).nonzero()[:, 0], result.mask[0].any(0).nonzero()[:, 0]
    zoom = len(rows) / 32
    assert 0.5 <= zoom < 1
    assert len(columns) / 48 == pytest.approx(zoom, abs=0.04)
    assert abs(rows[0] - (31 - rows[-1])) <= 1, "it is not in the middle"
    assert torch.allclose(result.target[result.mask], torch.tensor(4.0 / zoom), rtol=0.04)
    assert (result.target[~result.mask] == 0).all()
    assert result.image[:, ~result.mask[0]].mean() == pytest.approx(0.5, abs=0.1)  # noise, not black
    assert result.camera.cx == pytest.approx(23.5, abs=0.6)
    assert result.camera.cy == pytest.approx(15.5, abs=0.6)


@pytest.mark.parametrize("zooms", [{"min_zoom": 0.4}, {"min_zoom": 1.1}, {"max_zoom": 0.9}, {"max_zoom": math.inf}])
def test_zooms_out_of_range_are_errors(zooms: dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"min_zoom must be from 0\.5 to 1 and max_zoom at least 1"):
        augment.fit_crop((32, 48), **zooms)
