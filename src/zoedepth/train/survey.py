"""Look at data before a model is trained on it: how much there is, how large, how far, how dense."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from zoedepth.checking import SPARSE, evenly
from zoedepth.data.sample import DepthDataset, Sample
from zoedepth.errors import InputError

MOST = 200
"""Largest number of pairs that are looked at, evenly spread over the data set."""


@dataclass(frozen=True)
class Survey:
    """Findings about a data set, from a look at some of its pairs."""

    n: int
    """Number of pairs in the data set."""
    n_seen: int
    """Number of pairs looked at."""
    sizes: tuple[tuple[int, int], ...]
    """Sizes (height, width) of the photos, the most frequent first."""
    known: float
    """Median share of pixels whose depth is known."""
    near: dict[str, float]
    """Domain → depth in metres that 0.5 % of the known pixels are nearer than."""
    far: dict[str, float]
    """Domain → depth in metres that 0.5 % of the known pixels are farther than."""
    count: dict[str, int]
    """Domain → number of pairs among those looked at."""

    @property
    def sparse(self) -> bool:
        """True if depth is known at scattered points only."""
        return self.known < SPARSE


def survey(data: DepthDataset, *, name: str) -> tuple[Survey, list[Sample]]:
    """Look at evenly spread pairs of a data set.

    Args:
        data: the data set.
        name: its name, for errors.

    Returns:
        The findings, and up to six samples to show.

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
            raise InputError(f"{name} has disparity ({sample.name}): fine-tuning needs depth in metres")
        sizes[(sample.image.shape[1], sample.image.shape[2])] += 1
        count[sample.domain] += 1
        known.append(float(sample.mask.float().mean()))
        depth = sample.target[sample.mask].numpy()
        values.setdefault(sample.domain, []).append(depth[:: max(1, len(depth) // 2000)])
        if place in shown:
            samples.append(sample)
    depths = {domain: np.concatenate(found) for domain, found in values.items()}
    if empty := sorted(domain for domain, depth in depths.items() if not len(depth)):
        raise InputError(f"{name}: no depth is known in any of {len(places)} photos of {empty}. Check the files")
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
