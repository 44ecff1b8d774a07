"""Look at data before a model is trained on it: number and size of the photos, range and density of the depth."""

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from zoedepth.checking import SPARSE, depth_file, evenly
from zoedepth.data.integrity import most_broken, named
from zoedepth.data.plausible import Doubts, doubts, glance
from zoedepth.data.sample import DepthDataset, Sample
from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera

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
    """Domain → far end of its depth in metres: 0.5 % of the known pixels are farther. Maps unlike the others and a mark
    that stands for unknown do not count."""
    count: dict[str, int]
    """Domain → number of its pairs among those looked at."""
    cameras: dict[str, tuple[Camera, ...]]
    """Domain → the cameras of its photos, one for each photo that has one."""
    doubts: Doubts = field(default_factory=Doubts)
    """Findings about the depth that are not plausible."""
    max_depth: float | None = None
    """Metres from which on a mark stands for unknown, where there certainly is one."""
    unreadable: dict[int, str] = field(default_factory=dict)
    """Number of a pair that could not be read → what is wrong with it."""

    @property
    def n_cameras(self) -> int:
        """Number of the photos looked at whose camera is known."""
        return sum(len(cameras) for cameras in self.cameras.values())

    @property
    def sparse(self) -> bool:
        """True if depth is known at scattered points only, as from a lidar."""
        return self.known < SPARSE


def survey(
    data: DepthDataset, *, name: str, broken: Collection[int] = (), trusted: bool = False
) -> tuple[Survey, list[Sample]]:
    """Look at up to ``MOST`` pairs of a data set, evenly spread over it. Pairs that cannot be read are left out.

    Args:
        data: the data set.
        name: its name, for error messages.
        broken: numbers of pairs that are known to be broken.
        trusted: True takes all values for depth, however implausible.

    Returns:
        The findings, and up to six samples to show.

    Raises:
        InputError: no pair can be read, or more than a tenth cannot; the data has disparity in place of depth, or a
            domain has no known depth in any of the pairs looked at.
    """
    places = evenly([place for place in range(len(data)) if place not in broken], MOST)
    shown = set(evenly(places, 6))
    sizes: Counter[tuple[int, int]] = Counter()
    count: Counter[str] = Counter()
    cameras: dict[str, list[Camera]] = {}
    glances, n_pixels, samples = [], [], []
    unreadable: dict[int, str] = {}
    for place in places:
        try:
            sample = data[place]
        except InputError as error:
            unreadable[place] = str(error)
            continue
        if sample.kind != "depth":
            raise InputError(
                f"{name} has disparity for {sample.name}, but fine-tuning needs depth in metres. Leave this data "
                "out, or give its depth"
            )
        sizes[(sample.image.shape[1], sample.image.shape[2])] += 1
        count[sample.domain] += 1
        if sample.camera is not None:
            size = (sample.image.shape[1], sample.image.shape[2])
            cameras.setdefault(sample.domain, []).append(Camera.of(sample.camera, size))
        n_pixels.append(sample.mask.numel())
        glances.append(glance(depth_file(data, place, sample), sample.domain, sample.target[sample.mask].numpy()))
        if place in shown:
            samples.append(sample)
    if len(unreadable) == len(places) or len(unreadable) > most_broken(len(places)):
        raise InputError(
            f"{len(unreadable)} of the {len(places)} pairs of {name} that were looked at cannot be read: "
            f"{named(unreadable.values())}. Mend or remove them"
        )
    found = Doubts() if trusted else doubts(glances, max_depth=getattr(data, "max_depth", None))
    mark = found.mark if found.mark is not None and found.mark.certain else None
    max_depth = None if mark is None else mark.max_depth
    if mark is not None:
        samples = [replace(sample, mask=sample.mask & (sample.target < mark.value)) for sample in samples]
    known = [
        each.n * (1.0 if mark is None or not each.n else float((each.values < mark.value).mean())) / n
        for each, n in zip(glances, n_pixels, strict=True)
    ]
    depths: dict[str, np.ndarray] = {}
    for domain in count:
        values = [each.values for each in glances if each.domain == domain and each.name not in found.unlike]
        depths[domain] = np.concatenate(values)
        depths[domain] = depths[domain][depths[domain] < (max_depth or np.inf)]
    if empty := sorted(domain for domain, depth in depths.items() if not len(depth)):
        scenes = ", ".join(empty)
        raise InputError(
            f"{name} has no known depth for any photo of {scenes} ({len(places)} pairs were read). Look at its depth "
            "files with zoedepth data check"
        )
    return (
        Survey(
            n=len(data),
            n_seen=len(places) - len(unreadable),
            sizes=tuple(size for size, _ in sizes.most_common()),
            known=float(np.median(known)),
            near={domain: float(np.percentile(depth, 0.5)) for domain, depth in depths.items()},
            far={domain: float(np.percentile(depth, 99.5)) for domain, depth in depths.items()},
            count=dict(count),
            cameras={domain: tuple(found) for domain, found in cameras.items()},
            doubts=found,
            max_depth=max_depth,
            unreadable=unreadable,
        ),
        samples,
    )
