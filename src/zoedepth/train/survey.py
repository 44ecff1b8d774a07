"""Look at data before a model is trained on it: number and size of the photos, range and density of the depth."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from zoedepth.checking import SPARSE, evenly
from zoedepth.data.sample import DepthDataset, Sample
from zoedepth.errors import InputError

MOST = 200
"""Largest number of pairs to look at. Of more pairs, this many are taken, evenly spread over the data set."""


@dataclass(frozen=True)
class Survey:
    """The findings about a data set, from a look at some of its pairs of photo and depth."""

    n: int
    """Number of pairs in the data set."""
    n_seen: int
    """Number of pairs looked at."""
    sizes: tuple[tuple[int, int], ...]
    """The different sizes (height, width) of the photos, the most frequent first."""
    known: float
    """Share of the pixels whose depth is known: the median over the photos."""
    near: dict[str, float]
    """Domain → near end of its depth in metres: 0.5 % of the known pixels are nearer."""
    far: dict[str, float]
    """Domain → far end of its depth in metres: 0.5 % of the known pixels are farther."""
    count: dict[str, int]
    """Domain → number of its pairs among those looked at."""

    @property
    def sparse(self) -> bool:
        """True if depth is known at scattered points only, as from a lidar."""
        return self.known < SPARSE


def survey(data: DepthDataset, *, name: str) -> tuple[Survey, list[Sample]]:
    """Look at up to ``MOST`` pairs of a data set, evenly spread over it.

    Args:
        data: the data set.
        name: its name, for error messages.

    Returns:
        The findings, and up to six samples to show.

    Raises:
        InputError: a pair cannot be read, it has disparity in place of depth, or a domain has no known depth in any
            of the pairs looked at.
    """
    places = evenly(range(len(data)), MOST)
    shown = set(evenly(places, 6))
    sizes: Counter[tuple[int, int]] = Counter()
    count: Counter[str] = Counter()
    known, values, samples = [], {}, []
    for place in places:
        sample = data[place]
        if sample.kind != "depth":
            raise InputError(
                f"{name} has disparity for {sample.name}, but fine-tuning needs depth in metres. Leave this data "
                "out, or give its depth"
            )
        sizes[(sample.image.shape[1], sample.image.shape[2])] += 1
        count[sample.domain] += 1
        known.append(float(sample.mask.float().mean()))
        depth = sample.target[sample.mask].numpy()
        values.setdefault(sample.domain, []).append(depth[:: max(1, len(depth) // 2000)])
        if place in shown:
            samples.append(sample)
    depths = {domain: np.concatenate(found) for domain, found in values.items()}
    if empty := sorted(domain for domain, depth in depths.items() if not len(depth)):
        scenes = ", ".join(empty)
        raise InputError(
            f"{name} has no known depth for any photo of {scenes} ({len(places)} pairs were read). Look at its depth "
            "files with zoedepth data check"
        )
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
