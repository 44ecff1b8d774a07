"""The look at data before training: its ranges, sizes and density."""

from pathlib import Path

import numpy as np
import pytest
from tests.folders import write_disparity_pairs, write_pairs
from tests.train.runs import write_sparse

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
