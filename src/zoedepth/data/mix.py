"""Mix data sets: say which sample stands at which position of the endless stream that training reads.

Everything is a function of (seed, position). So a resumed run reads what an uninterrupted one would have read, any
number of workers gives the same samples, and processes share the stream by taking every n-th position.
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
class Component:
    """A data set in a mixture."""

    dataset: Samples
    augmentations: Sequence[Augmentation]
    weight: int = 1
    """How many turns it has in a round."""


class Mixture(Dataset[Sample]):
    """Data sets in turn, each in its own shuffled order, epoch after epoch.

    Args:
        components: the data sets; in a round each has ``weight`` turns.
        seed: determines the orders and the augmentations.
        turn: samples in a turn. 1 mixes within a batch; the batch size gives batches of one data set each, as the
            released training does.

    Raises:
        InputError: there are no data sets, or a weight is below 1.
    """

    def __init__(self, components: Sequence[Component], *, seed: int, turn: int = 1) -> None:
        if not components:
            raise InputError("there is no data to train on: name at least one data set")
        self.components = components
        self.seed = seed
        self.turn = turn
        self._round = _interleave([component.weight for component in components])
        self._orders: dict[int, tuple[int, Int64[np.ndarray, " samples"]]] = {}

    def locate(self, position: int) -> tuple[int, int, int]:
        """Return (index of the data set, index in it, its epoch) at a position of the stream."""
        turn, within = divmod(position, self.turn)
        number, place = divmod(turn, len(self._round))
        index = self._round[place]
        component = self.components[index]
        turns_before = number * component.weight + self._round[:place].count(index)
        count = turns_before * self.turn + within
        epoch, rank = divmod(count, len(component.dataset))
        return index, int(self._order(index, epoch)[rank]), epoch

    def _order(self, index: int, epoch: int) -> Int64[np.ndarray, " samples"]:
        # Kept for the present epoch: shuffling a million numbers takes as long as reading a sample.
        if index not in self._orders or self._orders[index][0] != epoch:
            rng = np.random.default_rng((self.seed, index, epoch))
            self._orders[index] = (epoch, shuffled(self.components[index].dataset, rng))
        return self._orders[index][1]

    def __getitem__(self, position: int) -> Sample:
        """Read and augment the sample at a position of the stream."""
        index, item, _ = self.locate(position)
        component = self.components[index]
        rng = np.random.default_rng((self.seed, position))
        return augment(replace(component.dataset[item], source=index), component.augmentations, rng)


def shuffled(dataset: Samples, rng: np.random.Generator) -> Int64[np.ndarray, " samples"]:
    """Shuffle the numbers of all samples; a data set, or the whole it is cut from, may have an ``order`` of its own."""
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
        first_step: the first step to give.
        last_step: the step before which to stop.
        batch_size: samples a step of all processes together; a multiple of their number.
        rank: which of the processes this is, from 0.
        n_processes: how many processes share the stream.

    Raises:
        InputError: the processes cannot share a batch equally.
    """

    def __init__(
        self, first_step: int, last_step: int, *, batch_size: int, rank: int = 0, n_processes: int = 1
    ) -> None:
        if batch_size % n_processes:
            raise InputError(
                f"the batch of {batch_size} cannot be shared equally by {n_processes} processes: "
                "choose a multiple of their number"
            )
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
    """Return a round in which data set i has weights[i] turns, spread out evenly: [3, 1] gives [0, 0, 1, 0]."""
    if any(weight < 1 for weight in weights):
        raise InputError(f"weights of data sets must be >= 1; they are {list(weights)}")
    turns = [((place + 0.5) / weight, index) for index, weight in enumerate(weights) for place in range(weight)]
    return [index for _, index in sorted(turns)]
