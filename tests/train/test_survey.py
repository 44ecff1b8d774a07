"""The look at data before training: its ranges, sizes and density."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.folders import write_csv, write_disparity_pairs, write_pairs
from tests.train.runs import write_sparse

from zoedepth.data.plausible import Doubts
from zoedepth.errors import InputError
from zoedepth.opening import open_dataset
from zoedepth.train.survey import survey


def test_survey_finds_ranges_sizes_and_density(tmp_path: Path):
    found, samples = survey(open_dataset(write_pairs(tmp_path / "rooms", n=3)), name="rooms")
    assert (found.n, found.n_seen, found.sizes, found.count) == (3, 3, ((64, 96),), {"indoor": 3})
    assert found.known == pytest.approx(7 / 8)
    depths = np.concatenate([sample.target[sample.mask].numpy() for sample in samples])
    # A part of the pixels is enough to know them to 1 %.
    assert found.near["indoor"] == pytest.approx(np.percentile(depths, 0.5), rel=0.01)
    assert found.far["indoor"] == pytest.approx(np.percentile(depths, 99.5), rel=0.01)
    assert not found.sparse
    assert len(samples) == 3


def test_survey_finds_the_cameras(tmp_path: Path):
    found, _ = survey(open_dataset(write_pairs(tmp_path / "rooms", n=3, focal_px=(50.0, 70.0))), name="rooms")
    assert {domain: [camera.fx for camera in cameras] for domain, cameras in found.cameras.items()} == {
        "indoor": [50.0, 70.0]
    }
    assert found.cameras["indoor"][0].size == (64, 96)
    assert found.n_cameras == 2
    bare, _ = survey(open_dataset(write_pairs(tmp_path / "bare")), name="bare")
    assert (bare.cameras, bare.n_cameras) == ({}, 0)


def test_survey_sees_scattered_points(tmp_path: Path):
    found, _ = survey(open_dataset(write_sparse(tmp_path)), name="lidar")
    assert found.sparse
    assert found.known == pytest.approx(0.02, abs=0.006)


def test_data_without_metres_or_without_depth_is_an_error(tmp_path: Path):
    with pytest.raises(InputError, match=r"stills has disparity for \S*\.jpg, but fine-tuning needs depth in metres"):
        survey(open_dataset(write_disparity_pairs(tmp_path / "stills")), name="stills")
    empty = write_pairs(tmp_path / "empty", n=2, without_truth=(0, 1))
    with pytest.raises(InputError, match=r"empty has no known depth for any photo of indoor \(2 pairs were read\)"):
        survey(open_dataset(empty), name="empty")


def test_many_pairs_are_looked_at_here_and_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("zoedepth.train.survey.MOST", 3)
    found, samples = survey(open_dataset(write_pairs(tmp_path / "rooms", n=7)), name="rooms")
    assert (found.n, found.n_seen, found.count) == (7, 3, {"indoor": 3})
    assert [Path(sample.name).name for sample in samples] == ["train_000.jpg", "train_003.jpg", "train_006.jpg"]


# ---------------------------------------------------------------------------------------------------- odd data


def write_floats(folder: Path, *maps: np.ndarray, **facts: object) -> Path:
    """Write photos with depth in metres as .npy, and a list of them; ``facts`` are said of all."""
    folder.mkdir(parents=True)
    (folder / "dataset.json").write_text(json.dumps({"domain": "indoor", **facts}))
    rows = []
    for index, depth in enumerate(maps):
        Image.fromarray(np.full((*depth.shape, 3), 9 * index, np.uint8)).save(folder / f"{index}.png")
        np.save(folder / f"{index}.npy", depth.astype(np.float32))
        rows.append({"image": f"{index}.png", "depth": f"{index}.npy"})
    return write_csv(folder / "train.csv", rows)


def slope(near: float, far: float) -> np.ndarray:
    return np.linspace(near, far, 48)[:, None].repeat(32, 1)


def background(value: float) -> np.ndarray:
    depth = slope(1, 4)
    depth[:12] = value
    return depth


@pytest.mark.parametrize("value", [65504.0, 1e10, 655.35])
def test_a_background_is_unknown_and_stretches_no_range(tmp_path: Path, value: float):
    found, samples = survey(open_dataset(write_floats(tmp_path / "a", *[background(value)] * 3)), name="a")
    assert found.far["indoor"] <= 4
    assert found.known == pytest.approx(0.75)
    assert found.max_depth == pytest.approx(value, rel=1e-3)
    assert found.doubts.impossible == []
    assert all(sample.target[sample.mask].max() <= 4 for sample in samples)


def test_what_the_data_says_or_who_trusts_it_is_believed(tmp_path: Path):
    path = write_floats(tmp_path / "said", *[background(65.535)] * 3, max_depth=100)
    assert survey(open_dataset(path), name="said")[0].far["indoor"] == pytest.approx(65.535)
    path = write_floats(tmp_path / "far", slope(2000, 4000))
    assert survey(open_dataset(path), name="far")[0].doubts.impossible
    assert survey(open_dataset(path), name="far", trusted=True)[0].doubts == Doubts()


def test_one_map_in_another_unit_stretches_no_range_and_is_named_by_its_file(tmp_path: Path):
    path = write_floats(tmp_path / "a", slope(1, 4), slope(10, 40), slope(1, 5), slope(1, 4))
    found, _ = survey(open_dataset(path), name="a")
    assert found.far["indoor"] < 5.1
    assert list(found.doubts.unlike) == [str(tmp_path / "a/1.npy")]


def test_pairs_that_cannot_be_read_are_left_out_up_to_a_tenth(tmp_path: Path):
    path = write_floats(tmp_path / "a", *[slope(1, 4)] * 12)
    (tmp_path / "a/5.npy").write_bytes(b"cut short")
    found, _ = survey(open_dataset(path), name="a")
    assert (found.n, found.n_seen) == (12, 11)
    assert list(found.unreadable) == [5]
    assert survey(open_dataset(path), name="a", broken={5})[0].unreadable == {}
    (tmp_path / "a/6.png").write_bytes(b"cut short")
    with pytest.raises(InputError, match=r"2 of the 12 pairs of a that were looked at cannot be read: .*5\.npy.*; .*6"):
        survey(open_dataset(path), name="a")
