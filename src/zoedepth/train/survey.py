"""A look at somebody's data before a model is trained on it: what is in it, and what that asks of the training."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from zoedepth.checking import SPARSE, evenly
from zoedepth.data.sample import DepthDataset, Sample
from zoedepth.errors import InputError

MOST = 200
"""Pairs that are looked at, evenly spread, of what may be millions."""


@dataclass(frozen=True)
class Survey:
    """What is known of a data set after a look at some of its pairs."""

    n: int
    """Pairs in all."""
    n_seen: int
    """Pairs looked at."""
    sizes: tuple[tuple[int, int], ...]
    """(height, width) of the photos that occur, the most frequent first."""
    known: float
    """Median share of pixels whose depth is known."""
    near: dict[str, float]
    """By domain: metres that 0.5 % of the known pixels are nearer than."""
    far: dict[str, float]
    """By domain: metres that 0.5 % of the known pixels are farther than."""
    count: dict[str, int]
    """By domain: pairs among those looked at."""

    @property
    def sparse(self) -> bool:
        """Whether depth is known at scattered points only."""
        return self.known < SPARSE


def survey(data: DepthDataset, *, name: str) -> tuple[Survey, list[Sample]]:
    """Look at evenly spread pairs; also up to six of them, to show.

    Raises:
        InputError: a pair cannot be read, its depth is disparity, or no depth is known at all.
    """
    places = evenly(range(len(data)), MOST)
    shown = set(evenly(places, 6))
    sizes: Counter[tuple[int, int]] = Counter()
    count: Counter[str] = Counter()
    known, values, samples = [], {}, []
    for place in places:
        sample = data[place]
        if sample.kind != "depth":
            raise InputError(f"{name} has disparity ({sample.name}); metres cannot be learned from it")
        sizes[(sample.image.shape[1], sample.image.shape[2])] += 1
        count[sample.domain] += 1
        known.append(float(sample.mask.float().mean()))
        depth = sample.target[sample.mask].numpy()
        values.setdefault(sample.domain, []).append(depth[:: max(1, len(depth) // 2000)])
        if place in shown:
            samples.append(sample)
    depths = {domain: np.concatenate(found) for domain, found in values.items()}
    if empty := sorted(domain for domain, depth in depths.items() if not len(depth)):
        raise InputError(f"{name}: no depth is known in any of {len(places)} photos of {empty}")
    found = Survey(
        n=len(data),
        n_seen=len(places),
        sizes=tuple(size for size, _ in sizes.most_common()),
        known=float(np.median(known)),
        near={domain: float(np.percentile(depth, 0.5)) for domain, depth in depths.items()},
        far={domain: float(np.percentile(depth, 99.5)) for domain, depth in depths.items()},
        count=dict(count),
    )
    return found, samples
