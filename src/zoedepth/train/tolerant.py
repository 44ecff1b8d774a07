"""Samples of which some cannot be read: a training goes on without them, and says which they are."""

from collections.abc import Iterator, Mapping, Sequence, Sized

import numpy as np
import torch
from jaxtyping import Int64
from torch.utils.data import Dataset

from zoedepth.data.integrity import most_broken, named
from zoedepth.data.mix import shuffled
from zoedepth.data.sample import Sample, Samples
from zoedepth.errors import InputError

_TRIES = 100


class Tolerant(Dataset[Sample]):
    """Samples in which another one stands in for each that cannot be read.

    Which one it is depends on the number of the broken sample alone. So a resumed training reads what an uninterrupted
    one would have read, whenever and in whichever process the damage is found.

    Args:
        samples: the samples.
        name: their name, for messages.
        broken: number of a sample that is known to be broken → message that says why.
        doubts: sentences about depth that is hardly right.
    """

    def __init__(
        self,
        samples: Samples,
        *,
        name: str,
        broken: Mapping[int, str] | None = None,
        doubts: Sequence[str] = (),
    ) -> None:
        self.samples = samples
        self.name = name
        self.doubts = doubts
        self.problems = dict(broken or {})
        """Number of a broken sample → message, as far as this process knows them."""
        # Processes that read samples tell this one which are broken.
        self._broken = torch.zeros(len(samples), dtype=torch.bool).share_memory_()
        self._broken[list(self.problems)] = True

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, index: int) -> Sample:
        """Read a sample, or one that stands in for it.

        Raises:
            InputError: no sample at all seems to be readable.
        """
        problem, place = "", index
        for attempt in range(_TRIES):
            if not self._broken[place]:
                try:
                    return self.samples[place]
                except InputError as error:
                    problem = str(error)
                    self._broken[place] = True
            place = int(np.random.default_rng((index, attempt)).integers(len(self)))
        raise InputError(f"no sample of {self.name} can be read: {problem or named(self.problems.values())}")

    def order(self, rng: np.random.Generator) -> Int64[np.ndarray, " samples"]:
        """Shuffle the numbers of all samples, as the samples themselves would."""
        return shuffled(self.samples, rng)

    def newly_broken(self) -> list[str]:
        """Return a message for each sample that was found to be broken since the last call."""
        found = []
        for index in torch.nonzero(self._broken)[:, 0].tolist():
            if index not in self.problems:
                try:
                    self.samples[index]
                    self.problems[index] = f"sample {index} of {self.name} could not be read a moment ago"
                except InputError as error:
                    self.problems[index] = str(error)
                found.append(self.problems[index])
        return found

    @property
    def too_many(self) -> bool:
        """True if more than a tenth of the samples is broken, and more than one."""
        return too_many(self.problems, len(self))

    def explain(self) -> str:
        """Return the message for too many broken samples, which names them."""
        return explained(self.name, self.problems, len(self))


def too_many(problems: Sized, n: int) -> bool:
    """Return True if more than a tenth of ``n`` samples is broken, and more than one, or all."""
    return len(problems) > most_broken(n) or len(problems) == n


def explained(name: str, problems: Mapping[int, str], n: int) -> str:
    """Return the message for data of which too much is broken."""
    return (
        f"{len(problems):,} of {n:,} pairs of {name} cannot be read, more than a tenth: {named(problems.values())}. "
        "Mend them, or remove them from the data"
    )


def readable(samples: Samples) -> Iterator[Sample]:
    """Yield the samples that can be read."""
    for index in range(len(samples)):
        try:
            sample = samples[index]
        except InputError:
            continue
        yield sample
