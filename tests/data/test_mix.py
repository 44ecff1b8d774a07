"""The endless stream that training reads: shares, epochs, processes, and that it depends on seed and position alone."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.utils.data import DataLoader, Dataset, Subset

from zoedepth.data.mix import Component, Mixture, Positions
from zoedepth.data.sample import Sample
from zoedepth.errors import InputError


class Numbered(Dataset[Sample]):
    """``n`` samples, each named after its data set and its number."""

    def __init__(self, name: str, n: int) -> None:
        self.name, self.n = name, n

    def __len__(self) -> int:
        return self.n

    def __getitem__(self, index: int) -> Sample:
        ones = torch.ones(1, 2, 2)
        return Sample(torch.zeros(3, 2, 2), ones, ones > 0, "depth", self.name, f"{self.name}/{index}")


def add_noise(sample: Sample, rng: np.random.Generator) -> Sample:
    return replace(sample, target=sample.target + rng.random())


def first(samples: list[Sample]) -> list[tuple[str, float]]:
    return [(sample.name, sample.target[0, 0, 0].item()) for sample in samples]


def mixture(sizes: list[int], weights: list[int], *, seed: int = 0, turn: int = 1) -> Mixture:
    sources = [
        Component(Numbered(f"data{index}", size), [add_noise], weight)
        for index, (size, weight) in enumerate(zip(sizes, weights, strict=True))
    ]
    return Mixture(sources, seed=seed, turn=turn)


def test_data_sets_take_turns_within_a_batch_unless_told_otherwise():
    mixed = Mixture([Component(Numbered("one", 3), []), Component(Numbered("two", 3), [])], seed=0)
    assert [mixed.locate(position)[0] for position in range(6)] == [0, 1, 0, 1, 0, 1]


@st.composite
def mixtures(draw: st.DrawFn) -> tuple[list[int], list[int], int, int]:
    """(sizes, weights, turn, seed)"""
    n = draw(st.integers(1, 4))
    numbers = st.integers(1, 7)
    sizes = draw(st.lists(numbers, min_size=n, max_size=n))
    weights = draw(st.lists(st.integers(1, 5), min_size=n, max_size=n))
    return sizes, weights, draw(st.integers(1, 4)), draw(st.integers(0, 2**31))


@settings(deadline=None, max_examples=50)
@given(mixtures(), st.integers(0, 20))
def test_in_every_round_each_data_set_has_the_share_of_its_weight(
    case: tuple[list[int], list[int], int, int], number: int
) -> None:
    sizes, weights, turn, seed = case
    mixed = mixture(sizes, weights, seed=seed, turn=turn)
    length = sum(weights) * turn
    counts = Counter(mixed.locate(position)[0] for position in range(number * length, (number + 1) * length))
    assert counts == {index: weight * turn for index, weight in enumerate(weights)}


@settings(deadline=None, max_examples=50)
@given(mixtures())
def test_every_epoch_of_a_data_set_is_a_permutation_of_it(case: tuple[list[int], list[int], int, int]) -> None:
    sizes, weights, turn, seed = case
    mixed = mixture(sizes, weights, seed=seed, turn=turn)
    read: list[list[tuple[int, int]]] = [[] for _ in sizes]
    for position in range(6 * max(sizes) * sum(weights) * turn):
        index, item, epoch = mixed.locate(position)
        read[index].append((epoch, item))
    for size, items in zip(sizes, read, strict=True):
        for epoch in range(len(items) // size):
            assert sorted(items[epoch * size : (epoch + 1) * size]) == [(epoch, item) for item in range(size)]


@settings(deadline=None, max_examples=50)
@given(mixtures(), st.permutations(range(40)))
def test_a_place_in_the_stream_does_not_depend_on_what_was_read_before(
    case: tuple[list[int], list[int], int, int], order: list[int]
) -> None:
    sizes, weights, turn, seed = case
    in_order = mixture(sizes, weights, seed=seed, turn=turn)
    expected = [in_order.locate(position) for position in range(40)]
    other = mixture(sizes, weights, seed=seed, turn=turn)
    assert {position: other.locate(position) for position in order} == dict(enumerate(expected))


def test_samples_and_their_augmentation_are_a_function_of_seed_and_position() -> None:
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002  # the global state must not matter
    expected = first([mixture([5, 3], [2, 1])[position] for position in range(30)])
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002  # the global state must not matter
    mixed = mixture([5, 3], [2, 1])
    backwards = first([mixed[position] for position in reversed(range(30))])
    assert backwards[::-1] == expected


def test_a_sample_is_augmented_anew_at_every_position() -> None:
    mixed = mixture([1], [1])
    assert len({value for _, value in first([mixed[position] for position in range(20)])}) == 20


def test_sample_says_from_which_data_set_it_is_and_its_augmentation_depends_on_the_seed() -> None:
    mixed = mixture([1, 1], [1, 1])
    assert [(mixed[i].source, mixed[i].name) for i in range(2)] == [(0, "data0/0"), (1, "data1/0")]
    assert mixed[0].target[0, 0, 0] != mixture([1, 1], [1, 1], seed=1)[0].target[0, 0, 0]


def test_epochs_and_seeds_and_data_sets_have_orders_of_their_own() -> None:
    def order(index: int, epoch: int, *, seed: int = 0) -> tuple[int, ...]:
        mixed = mixture([30, 30], [1, 1], seed=seed)
        places = [mixed.locate(position) for position in range(60 * epoch, 60 * (epoch + 1))]
        return tuple(item for which, item, _ in places if which == index)

    orders = [order(0, 0), order(0, 1), order(1, 0), order(0, 0, seed=1)]
    assert len(set(orders)) == 4
    assert tuple(range(30)) not in orders


def test_turns_are_spread_over_the_round() -> None:
    mixed = mixture([9, 9], [3, 1])
    assert [mixed.locate(position)[0] for position in range(8)] == [0, 0, 1, 0, 0, 0, 1, 0]


def test_turns_of_a_batch_give_batches_of_one_data_set() -> None:
    mixed = mixture([5, 7], [1, 1], turn=4)
    batches = [[mixed.locate(position)[0] for position in range(4 * step, 4 * step + 4)] for step in range(10)]
    assert batches == [[0] * 4, [1] * 4] * 5


@pytest.mark.parametrize("n_workers", [0, 2])
def test_any_number_of_workers_gives_the_same_samples(n_workers: int) -> None:
    mixed = mixture([5, 3], [2, 1], seed=3)
    expected = [first([mixed[position] for position in range(4 * step, 4 * step + 4)]) for step in range(6)]
    positions = Positions(0, 6, batch_size=4)
    loader = DataLoader(mixed, batch_sampler=positions, num_workers=n_workers, collate_fn=first)
    assert list(loader) == expected


def test_no_data_and_no_share_are_errors() -> None:
    with pytest.raises(InputError, match="no data"):
        Mixture([], seed=0)
    with pytest.raises(InputError, match="weights"):
        mixture([3, 3], [1, 0])


# ---------------------------------------------------------------------------------------------------- positions


@given(st.integers(0, 9), st.integers(0, 9), st.integers(1, 5), st.integers(1, 4))
def test_processes_share_every_step_among_them(first_step: int, n_steps: int, share: int, n_processes: int) -> None:
    batch_size = share * n_processes
    last_step = first_step + n_steps
    ranks = [
        list(Positions(first_step, last_step, batch_size=batch_size, rank=rank, n_processes=n_processes))
        for rank in range(n_processes)
    ]
    for offset, step in enumerate(range(first_step, last_step)):
        shares = [batches[offset] for batches in ranks]
        assert all(len(positions) == share for positions in shares)
        together = sorted(position for positions in shares for position in positions)
        assert together == list(range(step * batch_size, (step + 1) * batch_size))


@given(st.integers(0, 12), st.integers(0, 1))
def test_resuming_at_a_step_reads_what_was_left_to_read(step: int, rank: int) -> None:
    whole = Positions(0, 12, batch_size=4, rank=rank, n_processes=2)
    rest = Positions(step, 12, batch_size=4, rank=rank, n_processes=2)
    assert list(rest) == list(whole)[step:]
    assert len(rest) == 12 - step


def test_positions_can_be_read_again() -> None:
    positions = Positions(0, 3, batch_size=2)
    assert list(positions) == list(positions) == [[0, 1], [2, 3], [4, 5]]


def test_batch_that_cannot_be_shared_equally_is_an_error() -> None:
    with pytest.raises(InputError, match="6 cannot be shared equally by 4"):
        Positions(0, 1, batch_size=6, n_processes=4)


# -------------------------------------------------------------------------------------------- orders of the data's own


class InOrder(Numbered):
    """Has an order of its own: backwards, from a place that is drawn."""

    def order(self, rng: np.random.Generator) -> np.ndarray:
        return np.roll(np.arange(self.n)[::-1], rng.integers(self.n))


def items(dataset: Dataset[Sample], n: int) -> list[int]:
    mixed = Mixture([Component(dataset, [])], seed=0)
    return [mixed.locate(position)[1] for position in range(n)]


def test_data_without_an_order_is_shuffled_as_ever() -> None:
    expected = [np.random.default_rng((0, 0, epoch)).permutation(5) for epoch in range(2)]
    assert items(Numbered("data", 5), 10) == np.concatenate(expected).tolist()


def test_order_of_the_data_is_kept() -> None:
    read = items(InOrder("data", 10), 20)
    assert {(read[i] - read[i + 1]) % 10 for i in (*range(9), *range(10, 19))} == {1}
    assert sorted(read[:10]) == sorted(read[10:]) == list(range(10))


def test_order_of_the_data_is_kept_in_a_part_of_it() -> None:
    """The items 8, 6, 4 are numbers 0, 1, 2 of the part: backwards in the data is forwards in the part."""
    read = items(Subset(InOrder("data", 10), [8, 6, 4]), 3)
    assert sorted(read) == [0, 1, 2]
    assert {(read[i + 1] - read[i]) % 3 for i in range(2)} == {1}
