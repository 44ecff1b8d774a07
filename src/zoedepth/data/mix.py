"""Mixing data sets: which sample stands at which position of the endless stream that training reads.

Everything is a function of (seed, position). So a resumed run reads what an uninterrupted one would have, any number of
workers gives the same samples, and processes share the stream by taking every n-th position.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int64
from torch.utils.data import Dataset, Sampler, Subset

from zoedepth.data.augment import Augmentation, augment
from zoedepth.data.sample import Ordered, Sample, Samples
from zoedepth.errors import InputError


@dataclass(frozen=True)
class Source:
    """A data set in a mixture."""

    dataset: Samples
    augmentations: Sequence[Augmentation]
    weight: int = 1
    """Its turns in a round."""


class Mixture(Dataset[Sample]):
    """Data sets in turn, each in its own shuffled order, epoch after epoch.

    Args:
        sources: the data sets; in a round each has ``weight`` turns.
        seed: of the orders and the augmentations.
        turn: samples in a turn: 1 mixes within a batch; the batch size gives batches of one data set each (released).
    """

    def __init__(self, sources: Sequence[Source], *, seed: int, turn: int = 1) -> None:
        if not sources:
            raise InputError("no data to train on")
        self.sources = sources
        self.seed = seed
        self.turn = turn
        self._round = _interleave([source.weight for source in sources])
        self._orders: dict[int, tuple[int, Int64[np.ndarray, " samples"]]] = {}

    def locate(self, position: int) -> tuple[int, int, int]:
        """(index of the data set, index in it, its epoch) at a position of the stream."""
        turn, within = divmod(position, self.turn)
        number, place = divmod(turn, len(self._round))
        index = self._round[place]
        source = self.sources[index]
        turns_before = number * source.weight + self._round[:place].count(index)
        count = turns_before * self.turn + within
        epoch, rank = divmod(count, len(source.dataset))
        return index, int(self._order(index, epoch)[rank]), epoch

    def _order(self, index: int, epoch: int) -> Int64[np.ndarray, " samples"]:
        # The last epoch's is kept: to shuffle a million numbers takes as long as to read a sample.
        if index not in self._orders or self._orders[index][0] != epoch:
            rng = np.random.default_rng((self.seed, index, epoch))
            self._orders[index] = (epoch, shuffled(self.sources[index].dataset, rng))
        return self._orders[index][1]

    def __getitem__(self, position: int) -> Sample:
        """The augmented sample at a position of the stream."""
        index, item, _ = self.locate(position)
        source = self.sources[index]
        rng = np.random.default_rng((self.seed, position))
        return augment(replace(source.dataset[item], source=index), source.augmentations, rng)


def shuffled(dataset: Samples, rng: np.random.Generator) -> Int64[np.ndarray, " samples"]:
    """The numbers of all samples of a data set, shuffled: in its own order, if it or what it is a part of has one."""
    if isinstance(dataset, Ordered):
        return dataset.order(rng)
    if isinstance(dataset, Subset) and isinstance(dataset.dataset, Ordered):
        whole = dataset.dataset
        place = np.full(len(whole), -1)
        place[np.asarray(dataset.indices)] = np.arange(len(dataset))
        order = place[whole.order(rng)]
        return order[order >= 0]
    return rng.permutation(len(dataset))


class Positions(Sampler[list[int]]):
    """The batches of positions that one of several processes reads, from a step on.

    Args:
        first_step, last_step: steps to give, the last excluded.
        batch_size: samples a step, of all processes together; a multiple of their number.
        rank, n_processes: which of the processes this is.
    """

    def __init__(
        self, first_step: int, last_step: int, *, batch_size: int, rank: int = 0, n_processes: int = 1
    ) -> None:
        if batch_size % n_processes:
            raise InputError(f"the batch of {batch_size} cannot be shared equally by {n_processes} processes")
        self.steps = range(first_step, last_step)
        self.batch_size = batch_size
        self.rank = rank
        self.n_processes = n_processes

    def __len__(self) -> int:
        return len(self.steps)

    def __iter__(self) -> Iterator[list[int]]:
        for step in self.steps:
            start = step * self.batch_size
            yield list(range(start + self.rank, start + self.batch_size, self.n_processes))


def _interleave(weights: Sequence[int]) -> list[int]:
    """A round in which data set i has weights[i] turns, spread out evenly: [3, 1] gives [0, 0, 1, 0]."""
    if any(weight < 1 for weight in weights):
        raise InputError(f"weights of data sets must be >= 1; they are {list(weights)}")
    turns = [((place + 0.5) / weight, index) for index, weight in enumerate(weights) for place in range(weight)]
    return [index for _, index in sorted(turns)]
