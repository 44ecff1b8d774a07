"""What is found in a download, and what is drawn of it, on folders that are in order and in every kind of disorder."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.data.test_registration import scene
from tests.datasets.base import write_photo, write_png
from tests.folders import write_csv, write_disparity_pairs, write_pairs

from zoedepth.checking import N_READ, Values, check, contact_sheet, evenly
from zoedepth.colors import INVALID_COLOR
from zoedepth.data.pairs import PairDataset
from zoedepth.datasets.nyu import NYU

SIZE = (10, 20)


@pytest.fixture
def nyu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> NYU:
    """Four pairs, as many as are published: 1, 2, 3 and 4 m, the upper half unknown."""
    for number in range(1, 5):
        write_photo(tmp_path / f"sync/kitchen/rgb_{number:05d}.jpg", SIZE)
        stored = np.full(SIZE, 1000 * number, np.uint16)
        stored[:5] = 0
        write_png(tmp_path / f"sync/kitchen/sync_depth_{number:05d}.png", stored)
    monkeypatch.setattr(NYU, "about", replace(NYU.about, splits={"train": 4}))
    return NYU(tmp_path, allow_missing=True)


def test_a_download_in_order(nyu: NYU):
    report = check(nyu)
    assert report.problems == []
    assert (report.kind, report.n_pairs, report.n_expected) == ("depth", 4, 4)
    assert report.readable == (0, 1, 2, 3)
    assert report.photo_sizes == {SIZE: 4}
    assert report.values == Values(1, 1, 2.5, 4, 4)
    assert report.known == 0.5
    assert report.n_cameras == 4


def test_photos_have_the_size_of_their_files_and_the_most_frequent_comes_first(nyu: NYU):
    write_photo(nyu.pairs[0].image, (30, 60))
    assert list(check(nyu).photo_sizes.items()) == [(SIZE, 3), ((30, 60), 1)]


def test_missing_files_are_named_and_their_pairs_not_read(nyu: NYU):
    nyu.pairs[1].image.unlink()
    report = check(nyu)
    assert report.missing == (nyu.pairs[1].image,)
    assert report.readable == (0, 2, 3)
    assert report.problems == ["1 files are missing"]


def test_fewer_pairs_than_expected_are_a_problem_and_more_are_none(nyu: NYU):
    nyu.pairs.pop()
    assert check(nyu).problems == ["3 of 4 pairs are here"]
    nyu.pairs.extend(nyu.pairs)
    assert check(nyu).problems == []


def test_every_unreadable_pair_is_named(nyu: NYU):
    for index in (0, 3):
        nyu.pairs[index].image.write_bytes(b"not a photo")
    report = check(nyu)
    assert report.readable == (1, 2)
    assert [str(nyu.pairs[index].image) in text for index, text in zip((0, 3), report.unreadable, strict=True)] == [
        True,
        True,
    ]
    assert report.problems == ["2 of 4 pairs cannot be read"]
    assert report.values == Values(2, 2, 2.5, 3, 3)


def test_pairs_without_truth_are_counted_and_no_problem(nyu: NYU):
    nyu.pairs[0] = replace(nyu.pairs[0], target=None)
    report = check(nyu)
    assert (report.n_without_truth, report.readable, report.problems) == (1, (1, 2, 3), [])


def test_a_depth_of_nothing_is_named_and_a_problem_only_if_all_are(nyu: NYU):
    targets = [frame.target for frame in nyu.pairs if frame.target is not None]
    write_png(targets[0], np.zeros(SIZE, np.uint16))
    report = check(nyu)
    assert (report.empty, report.problems) == (("sync/kitchen/rgb_00001.jpg",), [])
    assert report.known == 0.375
    for target in targets:
        write_png(target, np.zeros(SIZE, np.uint16))
    report = check(nyu)
    assert (report.values, report.problems) == (None, ["no pixel of any pair has a known depth"])


def test_a_sample_of_the_pairs_is_read_or_every_one(tmp_path: Path):
    write_pairs(tmp_path, n=1, size=(8, 8))
    row = {"image": "image/train_000.jpg", "depth": "depth/train_000.png", "depth_scale": 1000, "domain": "indoor"}
    dataset = PairDataset(write_csv(tmp_path / "train.csv", [row] * (N_READ + 2)))
    tracked: list[int] = []

    def track(indices):
        tracked.extend(indices)
        return indices

    assert len(check(dataset, track=track).readable) == N_READ
    assert (len(tracked), tracked[0], tracked[-1]) == (N_READ, 0, N_READ + 1)
    assert len(check(dataset, every=True).readable) == N_READ + 2


def test_pairs_of_ones_own(tmp_path: Path):
    dataset = PairDataset(write_pairs(tmp_path, n=3, size=(16, 24)))
    report = check(dataset)
    assert (report.n_pairs, report.n_expected, report.problems) == (3, None, [])
    assert report.photo_sizes == {(16, 24): 3}
    assert report.values is not None
    assert 1 <= report.values.least <= report.values.median <= report.values.greatest <= 5
    assert report.known == 1 - 3 / 24


def test_photos_without_depth_in_ones_own_list(tmp_path: Path):
    write_pairs(tmp_path, n=2, size=(8, 8))
    rows = [{"image": f"image/train_00{n}.jpg", "depth": depth, "depth_scale": 1000, "domain": "indoor"}
            for n, depth in ((0, "None"), (1, "depth/train_001.png"))]  # fmt: skip
    report = check(PairDataset(write_csv(tmp_path / "train.csv", rows), allow_missing=True))
    assert (report.n_without_truth, report.readable) == (1, (1,))


def test_disparity(tmp_path: Path):
    report = check(PairDataset(write_disparity_pairs(tmp_path, size=(16, 24))))
    assert report.kind == "disparity"
    assert report.values is not None
    assert report.values.greatest > 200


@pytest.mark.parametrize(
    ("n", "expected"),
    [(1, [10]), (2, [10, 50]), (3, [10, 30, 50]), (5, [10, 20, 30, 40, 50]), (9, [10, 20, 30, 40, 50])],
)
def test_evenly_has_the_first_and_the_last(n: int, expected: list[int]):
    assert evenly([10, 20, 30, 40, 50], n) == expected


def test_sheet_has_two_pairs_in_a_row_and_grey_where_nothing_is_known(nyu: NYU):
    picture = contact_sheet(nyu, [0, 1, 2])
    # 440 x 220 each and 12 between; the first row ends before the second begins.
    assert picture.shape[0] > 2 * 220 + 3 * 12
    assert picture.shape[1] > 4 * 440 + 5 * 12
    grey = (picture == INVALID_COLOR).all(axis=2)
    assert grey.sum() == pytest.approx(3 * 440 * 110, rel=0.02)


def test_wide_photos_are_below_each_other(tmp_path: Path):
    dataset = PairDataset(write_pairs(tmp_path, n=2, size=(16, 64)))
    picture = contact_sheet(dataset, [0, 1])
    assert picture.shape[0] > 2 * 220
    assert 2 * 880 < picture.shape[1] < 4 * 880


def test_scattered_points_are_seen(nyu: NYU):
    """8 of 200 pixels are known: 4 %, of which nothing would be left on a picture many times the size."""
    target = nyu.pairs[0].target
    assert target is not None
    stored = np.zeros(SIZE, np.uint16)
    stored[2::5, 2::5] = 1000
    write_png(target, stored)
    picture = contact_sheet(nyu, [0])
    right = picture[:, 12 + 440 + 12 :][40:230, :440]
    assert not (right == INVALID_COLOR).all(axis=2).any()


def test_disparity_is_drawn_light_where_near_and_grey_where_unknown(tmp_path: Path):
    """The first pair is nearest at the top, farthest at the bottom, and unknown in the last eighth of the width."""
    dataset = PairDataset(write_disparity_pairs(tmp_path, n=1, size=(64, 96)))
    right = contact_sheet(dataset, [0])[:, 12 + 440 + 12 :]
    assert right[40, 200].min() > 100
    assert right[-20, 200].max() < 30
    assert tuple(right[150, 430]) == INVALID_COLOR


def test_disparity_of_0_and_the_same_everywhere_can_be_drawn(tmp_path: Path):
    write_disparity_pairs(tmp_path, n=1, size=(8, 8))
    dataset = PairDataset(tmp_path)
    sample = dataset[0]
    flat = replace(sample, target=sample.target * 0, mask=sample.target == sample.target)
    picture = contact_sheet([flat], [0])
    assert (picture == 0).all(axis=2).any(), "the farthest"


def test_depth_of_another_camera_is_worth_a_note(tmp_path: Path):
    rows = []
    for seed in range(4):
        image, depth = scene(seed, scale=1.11)
        Image.fromarray((image.transpose(1, 2, 0) * 255).astype(np.uint8)).save(tmp_path / f"{seed}.png")
        Image.fromarray((depth * 1000).astype(np.uint16)).save(tmp_path / f"{seed}d.png")
        rows.append({"image": f"{seed}.png", "depth": f"{seed}d.png", "depth_scale": 1000, "domain": "indoor"})
    report = check(PairDataset(write_csv(tmp_path / "test.csv", rows)))
    assert report.registration is not None
    assert any("0.90 times as large" in note for note in report.notes)
    assert not report.problems
