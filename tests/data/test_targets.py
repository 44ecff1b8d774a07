"""A photo and a stored map to a sample: units, unknown values, masks, and sizes."""

import numpy as np
import pytest
import torch

from zoedepth.data.facts import Facts
from zoedepth.data.sample import Sample
from zoedepth.data.targets import to_sample
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics
from zoedepth.stored import StoredMap

PHOTO = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
LEVELS = np.array([[0, 500, 1000], [2000, 1, 65535]], np.uint16)


def make(values: np.ndarray | None, scale: float | None = None, **options) -> Sample:
    options = {"kind": "depth", "facts": Facts(domain="indoor"), "name": "a", "files": ("a.jpg", "a.png"), **options}
    photo = options.pop("photo", PHOTO)
    if isinstance(mask := options.get("mask"), np.ndarray):
        options["mask"] = StoredMap(mask)
    return to_sample(photo, None if values is None else StoredMap(values, scale), **options)


def test_sample_has_photo_facts_and_name() -> None:
    camera = Intrinsics(5, 6, 2, 1)
    sample = make(LEVELS, 1000, facts=Facts(None, "attic", camera))
    assert (sample.kind, sample.domain, sample.name, sample.camera) == ("depth", "attic", "a", camera)
    np.testing.assert_array_equal((sample.image * 255).round().permute(1, 2, 0), PHOTO)


@pytest.mark.parametrize(
    ("said", "own", "default", "metres"), [(500, 1000, 250, 2), (None, 1000, 250, 1), (None, None, 250, 4)]
)
def test_unit_is_the_first_that_is_said(said, own, default, metres: float) -> None:
    sample = make(LEVELS, own, facts=Facts(said), default_scale=default)
    assert sample.target[0, 0, 2] == metres


def test_whole_numbers_without_a_unit_are_an_error_and_floats_are_metres() -> None:
    with pytest.raises(InputError, match=r"a\.png has whole numbers.*give depth_scale"):
        make(LEVELS)
    assert make(LEVELS.astype(np.float64)).target[0, 0, 2] == 1000


def test_default_unit_is_for_whole_numbers_only() -> None:
    metres = np.array([[2.5]], np.float32).repeat(3, 1).repeat(2, 0)
    assert make(metres, default_scale=1000).target[0, 0, 0] == 2.5
    assert make(metres, facts=Facts(1000)).target[0, 0, 0] == np.float32(2.5) / 1000  # said of this very file


@pytest.mark.parametrize("mark", [65504.0, 1e10, 655.35])
def test_depth_of_the_largest_or_more_is_unknown(mark: float) -> None:
    values = np.array([[1.0, 59.9, 60.0], [mark, 0.0, 2.0]], np.float32)
    sample = make(values, facts=Facts(max_depth=60.0))
    assert sample.mask[0].tolist() == [[True, True, False], [False, False, True]]
    assert sample.target[0].tolist() == [[1.0, np.float32(59.9), 0], [0, 0, 2.0]]
    masked = make(values, facts=Facts(max_depth=60.0), mask=np.ones((2, 3), bool), mask_decides=True)
    assert torch.equal(masked.mask, sample.mask)


def test_depth_of_8_bits_is_a_picture_and_disparity_may_have_them() -> None:
    values = LEVELS.astype(np.uint8)
    with pytest.raises(InputError, match=r"a\.png has 8 bits a pixel: it is a picture of depth"):
        make(values, facts=Facts(10))
    assert make(values, kind="disparity").mask.any()


def test_disparity_has_no_unit() -> None:
    assert make(LEVELS, 1000, kind="disparity", facts=Facts(500), default_scale=250).target[0, 0, 2] == 1000


def test_values_that_are_not_positive_or_not_finite_are_unknown() -> None:
    sample = make(np.array([[1, 0, -1], [np.nan, np.inf, 1e300]]))
    assert sample.mask[0].tolist() == [[True, False, False], [False, False, False]]
    assert sample.target[0].tolist() == [[1, 0, 0], [0, 0, 0]]


def test_mask_decides_about_disparity_only_where_it_should() -> None:
    values, mask = np.array([[-1.0, 0, 2], [3, np.nan, 0]]), np.array([[True, True, True], [False, True, False]])
    known = [[True, True, True], [False, False, False]]
    positive = [[False, False, True], [False, False, False]]
    for kind, decides, expected in (
        ("disparity", True, known),
        ("disparity", False, positive),
        ("depth", True, positive),
    ):
        sample = make(values, kind=kind, mask=mask, mask_decides=decides)
        assert sample.mask[0].tolist() == expected
        assert (sample.target[~sample.mask] == 0).all()


def test_without_a_map_nothing_is_known() -> None:
    assert not make(None).mask.any()


def test_sizes_must_agree() -> None:
    with pytest.raises(InputError, match=r"a\.jpg is \(2, 3\) and a\.png is \(3, 2\)"):
        make(LEVELS.T, 1)
    with pytest.raises(InputError, match=r"a\.jpg is \(2, 3\) and the mask of a\.png is \(1, 3\)"):
        make(LEVELS, 1, mask=np.ones((1, 3), bool))


def test_smaller_map_becomes_points_of_the_photo() -> None:
    values = np.array([[500, 1000], [0, 4000]], np.uint16)
    photo = np.zeros((4, 4, 3), np.uint8)
    mask = np.array([[True, False], [True, True]])
    for given, expected in (
        (None, {(1, 1): 0.5, (1, 3): 1.0, (3, 3): 4.0}),
        (mask, {(1, 1): 0.5, (3, 3): 4.0}),  # of the size of the map
        (np.tri(4, k=-1, dtype=bool).T, {(1, 3): 1.0}),  # of the size of the photo
    ):
        sample = make(values, 1000, photo=photo, mask=given)
        known = {
            (row, column): sample.target[0, row, column].item() for row, column in sample.mask[0].nonzero().tolist()
        }
        assert known == expected


def test_zero_disparity_between_points_is_not_known() -> None:
    values, photo, mask = np.array([[0.0, 2.0]]), np.zeros((2, 4, 3), np.uint8), np.ones((2, 4), bool)
    sample = make(values, photo=photo, mask=mask, kind="disparity", mask_decides=True)
    assert sample.mask[0].nonzero().tolist() == [[1, 1], [1, 3]]


def test_mask_of_neither_size_is_an_error() -> None:
    with pytest.raises(InputError, match=r"the mask of a\.png is \(1, 2\).*photo, \(4, 8\), or of the map, \(2, 4\)"):
        make(np.ones((2, 4)), photo=np.zeros((4, 8, 3), np.uint8), mask=np.ones((1, 2), bool))


@pytest.mark.parametrize("orientation", [2, 3, 4])
def test_photo_that_exif_turns_upside_down_is_an_error_unless_the_map_must_lie_alike(orientation: int) -> None:
    word = rf"a\.jpg is turned upright by its EXIF orientation {orientation}, and nothing says whether {{}} is, too"
    with pytest.raises(InputError, match=word.format(r"a\.png")):
        make(LEVELS, facts=Facts(1000), orientation=orientation)
    assert make(LEVELS, 1000, orientation=orientation).mask.any()  # says its scale: a prediction of this package
    with pytest.raises(InputError, match=word.format(r"the mask of a\.png")):
        make(LEVELS, 1000, mask=np.ones((2, 3), bool), orientation=orientation)
    assert not make(None, orientation=orientation).mask.any()


def test_photo_that_exif_turns_by_90_degrees_shows_how_the_map_lies() -> None:
    assert make(LEVELS, facts=Facts(1000), orientation=6).mask.any()
    square = np.zeros((2, 2, 3), np.uint8)
    with pytest.raises(InputError, match="EXIF orientation 6, and nothing says"):
        make(LEVELS[:, :2], facts=Facts(1000), photo=square, orientation=6)


@pytest.mark.parametrize(
    ("camera", "word"),
    [
        (Intrinsics(5, 5, 3, 1), "looks through a point outside of the photo, so it is that of another size"),
        (Intrinsics(5, 5, 1, -0.6), "outside of the photo"),
        (Intrinsics(0.1, 5, 1, 1), "it would see 172 degrees"),
        (Intrinsics(5000, 5000, 1, 1), "it would see 0.03"),
    ],
)
def test_camera_of_another_photo_is_an_error(camera: Intrinsics, word: str) -> None:
    with pytest.raises(InputError, match=rf"a\.jpg is 3 x 2 pixels, and its camera has fx, fy, cx, cy = .*{word}"):
        make(LEVELS, 1000, facts=Facts(camera=camera))


def test_mask_that_its_own_exif_turns_must_lie_as_the_photo_does() -> None:
    mask = StoredMap(np.ones((2, 3), bool), orientation=3)
    with pytest.raises(InputError, match=r"the mask of a\.png is turned upright by its EXIF orientation 3"):
        make(LEVELS, 1000, mask=mask)
    assert make(LEVELS, 1000, mask=mask, orientation=3).mask.any()


def test_map_that_its_own_exif_turns_must_lie_as_the_photo_does() -> None:
    for stored, photo, fits in ((3, 3, True), (3, 1, False), (2, 3, False), (6, 1, True), (1, 6, True)):
        found = StoredMap(LEVELS, orientation=stored)
        options = {"kind": "depth", "facts": Facts(1000), "name": "a", "files": ("a.jpg", "a.png")}
        if fits:
            assert to_sample(PHOTO, found, orientation=photo, **options).mask.any()
            continue
        turned, other = ("a.jpg", "a.png") if photo == 3 else ("a.png", "a.jpg")
        with pytest.raises(InputError, match=f"{turned} is turned upright by its EXIF .* whether {other} is, too"):
            to_sample(PHOTO, found, orientation=photo, **options)


def test_relative_depth_is_no_depth() -> None:
    found = StoredMap(LEVELS, relative=True)
    options = {"facts": Facts(1000), "name": "a", "files": ("a.jpg", "a.png")}
    with pytest.raises(InputError, match=r"a\.png holds relative depth, which has no metres"):
        to_sample(PHOTO, found, kind="depth", **options)
    assert to_sample(PHOTO, found, kind="disparity", **options).mask.any()
