"""Broken samples are skipped, always in favour of the same others, and told to the process that trains."""

import multiprocessing
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.folders import write_pairs
from torch.utils.data import DataLoader, Subset

from zoedepth.data.pairs import PairDataset
from zoedepth.errors import InputError
from zoedepth.train.tolerant import Tolerant, readable


@pytest.fixture
def broken(tmp_path: Path) -> Subset:
    """Twenty pairs, of which the photos 3 and 11 are cut short."""
    dataset = PairDataset(write_pairs(tmp_path, n=20, size=(8, 8)))
    for index in (3, 11):
        content = dataset.pairs[index].image.read_bytes()
        dataset.pairs[index].image.write_bytes(content[:200])
    return Subset(dataset, range(20))


def names(samples: Tolerant) -> list[str]:
    return [samples[i].name for i in range(len(samples))]


def test_broken_samples_are_replaced_by_the_same_ones_whenever_they_are_found(broken: Subset) -> None:
    lazily, told = Tolerant(broken, name="rooms"), Tolerant(broken, name="rooms", broken={3: "cut", 11: "cut"})
    found = names(lazily)
    assert found == names(told)
    assert found == [lazily[i].name for i in range(20)], "the second time nothing is tried"
    whole = [Path(name).stem[-3:] for name in found]
    assert [i for i in range(20) if whole[i] != f"{i:03d}"] == [3, 11]
    assert not {"003", "011"} & set(whole)


def test_each_broken_sample_is_told_once_by_its_file(broken: Subset) -> None:
    samples = Tolerant(broken, name="rooms")
    assert samples.newly_broken() == []
    names(samples)
    told = samples.newly_broken()
    assert ["train_003.jpg" in told[0], "train_011.jpg" in told[1]] == [True, True]
    assert samples.newly_broken() == []
    assert not samples.too_many  # 2 of 20
    samples._broken[5] = True
    assert samples.newly_broken() == ["sample 5 of rooms could not be read a moment ago"]
    assert samples.too_many
    assert samples.explain().startswith("3 of 20 pairs of rooms cannot be read, more than a tenth: ")
    assert "train_003.jpg" in samples.explain()


# Windows has no fork: training spawns there.
@pytest.mark.parametrize("method", sorted({"fork", "spawn"} & set(multiprocessing.get_all_start_methods())))
def test_processes_that_read_tell_the_one_that_trains(broken: Subset, method: str) -> None:
    samples = Tolerant(broken, name="rooms")
    loader = DataLoader(samples, num_workers=1, batch_size=None, sampler=[3, 4], multiprocessing_context=method)
    assert len(list(loader)) == 2
    assert len(samples.newly_broken()) == 1


def test_nothing_readable_is_an_error(broken: Subset) -> None:
    samples = Tolerant(Subset(broken.dataset, [3, 11]), name="rooms")
    with pytest.raises(InputError, match=r"no sample of rooms can be read: .*train_0(03|11)\.jpg"):
        samples[0]
    samples.newly_broken()
    assert samples.too_many


def test_order_is_that_of_the_samples(broken: Subset) -> None:
    expected = np.random.default_rng(0).permutation(20)
    assert Tolerant(broken, name="rooms").order(np.random.default_rng(0)).tolist() == expected.tolist()


def test_readable_leaves_out_what_is_not(broken: Subset) -> None:
    assert len(list(readable(broken))) == 18
    assert torch.equal(next(readable(broken)).target, broken[0].target)
