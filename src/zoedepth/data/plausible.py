"""Is this depth plausible? Marks that stand for "unknown", units that cannot be, and maps unlike the others.

A depth map is a picture of numbers, and nothing in it says whether they are metres. What is found here is said to the
user in words; nobody's data is changed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

MANY = 0.01
"""Share of the known pixels beyond which one value at the top of the range is suspicious."""

POSSIBLE = (0.01, 1000.0)
"""Medians of depth in metres that a photo can have: from a centimetre to a kilometre."""

USUAL = {"indoor": (0.2, 20.0), "outdoor": (1.0, 300.0)}
"""Domain → medians in metres that are usual for its photos; a tenfold unit leads out of them."""

UNLIKE = 8.0
"""Factor by which the median of a map differs from those of its domain, where its unit is not theirs."""

UNIT = (
    "Metres are the stored value divided by depth_scale: 1000 for millimetres (also where a sensor says 0.001 metres a "
    "unit), 256 as in KITTI; floating point must be metres"
)
"""A sentence about the unit, for messages."""

_BAND = 0.1  # part of the range below the largest value, in which it is compared with others
_TIMES = 5  # as many pixels as other values have there: then it is not merely the end of a slope
_GAP, _GROUP = 10.0, 1.5  # between two neighbouring depths, and from the nearest to the farthest beyond it
_FAR, _HALL = 5.0, 20.0  # times as far as nearly all others, and farther than a hall is long: certainly no depth
_MOST_NAMED = 5
_KEPT = 2000  # values of a map


@dataclass(frozen=True)
class Glance:
    """The known depth of one map, as much of it as is needed here."""

    name: str
    domain: str
    n: int
    """Number of known pixels."""
    greatest: float
    """Largest known depth."""
    n_greatest: int
    """Number of pixels that hold it."""
    values: Float[np.ndarray, " some"]
    """A part of the known depth, evenly spread over the map."""


def glance(name: str, domain: str, depth: Float[np.ndarray, " known"]) -> Glance:
    """Look at the known depth of a map, and keep about 2,000 of its values, or all where there are fewer."""
    greatest = float(depth.max()) if depth.size else 0.0
    return Glance(
        name, domain, depth.size, greatest, int((depth == greatest).sum()), depth[:: max(1, depth.size // _KEPT)]
    )


@dataclass(frozen=True)
class Mark:
    """One value at the top of the range that many pixels hold: it stands for "unknown", or is where a sensor ends.

    Several values that lie together, far from all others, are one mark: a sky may be noisy, or another in each file.
    """

    value: float
    """The value, or the least of several."""
    share: float
    """Share of the known pixels that hold it."""
    others: float
    """95 % of the other values are nearer."""
    greatest: float = 0.0
    """The greatest of several; 0: there is one."""

    @property
    def certain(self) -> bool:
        """True if it is so much farther than nearly all others that it cannot be depth."""
        return self.value > _HALL and self.value >= _FAR * self.others

    @property
    def max_depth(self) -> float:
        """The value, rounded down to four digits: with it as ``max_depth`` the value is unknown."""
        unit = 10.0 ** (math.floor(math.log10(self.value)) - 3)
        rounded = float(f"{math.floor(self.value / unit) * unit:.4g}")
        return rounded if rounded <= self.value else float(f"{rounded - unit:.4g}")

    def __str__(self) -> str:
        what = (
            "it stands for unknown (a hole, the sky, the background). Write"
            if self.certain
            else "does it stand for unknown? Then write"
        )
        held = (
            f"are {self.value:.6g} to {self.greatest:.6g} m away"
            if self.greatest
            else f"hold the largest value, {self.value:.6g} m"
        )
        return (
            f"{self.share:.1%} of the known pixels {held}, and nearly all others "
            f'are nearer than {self.others:.4g} m: {what} {{"max_depth": {self.max_depth:g}}} into dataset.json. If it '
            "is depth after all, write a larger max_depth"
        )


@dataclass(frozen=True)
class Doubts:
    """The findings about the depth of a data set that are not plausible."""

    mark: Mark | None = None
    most: float = POSSIBLE[1]
    """Largest median in metres that is possible."""
    medians: dict[str, float] = field(default_factory=dict)
    """Domain → median of its known depth, without a certain mark."""
    unlike: dict[str, str] = field(default_factory=dict)
    """Name of a map whose unit is likely another one → what is said of it."""
    floor: str = ""
    """A sentence about one value at the bottom of the range that likely stands for unknown; empty: there is none."""

    @property
    def impossible(self) -> list[str]:
        """Sentences about medians that no photo has."""
        return [
            f"the median depth of its{_named(domain)} photos is {median:.4g} m. {UNIT}"
            for domain, median in self.medians.items()
            if not POSSIBLE[0] <= median <= self.most
        ]

    @property
    def named(self) -> list[str]:
        """Sentences about all that is hardly right: medians, maps, and a mark that is no depth."""
        marks = [str(self.mark)] if self.mark is not None and self.mark.certain else []
        return self.impossible + self.unlikely + marks

    @property
    def unlikely(self) -> list[str]:
        """Sentences about medians and maps that are hardly right."""
        found = [self.floor] if self.floor else []
        for domain, median in self.medians.items():
            low, high = USUAL.get(domain, (POSSIBLE[0], self.most))
            if POSSIBLE[0] <= median <= self.most and not low <= median <= high:
                found.append(
                    f"the median depth of its{_named(domain)} photos is {median:.4g} m, where {low:g} to {high:g} m "
                    f"are usual: is the unit right? {UNIT}"
                )
        shown = list(self.unlike.values())[:_MOST_NAMED]
        more = len(self.unlike) - len(shown)
        return found + shown + ([f"and {more:,} more maps unlike the others"] if more else [])


def doubts(glances: Sequence[Glance], *, max_depth: float | None = None) -> Doubts:
    """Judge the depth of a data set by some of its maps.

    Args:
        glances: one for each of them.
        max_depth: metres from which on depth is unknown, where the data says so. What is left is depth then.
    """
    mark = find_mark(glances) if max_depth is None else None
    limit = mark.value if mark is not None and mark.certain else math.inf
    kept = [(each, each.values[each.values < limit]) for each in glances]
    kept = [(each, values) for each, values in kept if len(values)]
    medians, unlike = {}, {}
    for domain in sorted({each.domain for each, _ in kept}):
        of_domain = [(each, values) for each, values in kept if each.domain == domain]
        medians[domain] = float(np.median(np.concatenate([values for _, values in of_domain])))
        own = {each.name: float(np.median(values)) for each, values in of_domain}
        typical = float(np.median(list(own.values())))
        if len(own) > 2:
            unlike |= {
                name: f"{name}: its median depth is {median:.4g} m, and that of the others is {typical:.4g} m: is its "
                "unit another one?"
                for name, median in own.items()
                if not typical / UNLIKE < median < typical * UNLIKE
            }
    return Doubts(mark, max(POSSIBLE[1], max_depth or 0.0), medians, unlike, find_floor(glances))


def find_mark(glances: Sequence[Glance]) -> Mark | None:
    """Find the one value at the top of the range that many pixels hold, and few others come near to."""
    n, top = sum(each.n for each in glances), max((each.greatest for each in glances), default=0.0)
    if not n:
        return None
    share = sum(each.n_greatest for each in glances if each.greatest == top) / n
    values = np.concatenate([each.values for each in glances])
    others = values[values < top]
    near = others[others >= (1 - _BAND) * top]
    usual = len(near) / len(values) / max(1, len(np.unique(near)))
    if share <= MANY or not len(others) or share < _TIMES * usual:
        return _find_group(np.sort(values))
    return Mark(top, share, float(np.percentile(others, 95)))


def _find_group(values: Float[np.ndarray, " sorted"]) -> Mark | None:
    """Find values at the top of the range that lie together, and so far from all others that they cannot be depth."""
    gaps = np.flatnonzero((values[1:] > _HALL) & (values[1:] >= _GAP * values[:-1]))
    if not len(gaps):
        return None
    first = int(gaps[-1]) + 1
    share = (len(values) - first) / len(values)
    if share <= MANY or values[-1] > _GROUP * values[first]:
        return None
    return Mark(float(values[first]), share, float(np.percentile(values[:first], 95)), float(values[-1]))


def find_floor(glances: Sequence[Glance]) -> str:
    """Return what is to be said of one value at the bottom of the range that many pixels hold; empty for nothing.

    Programs that clip depth leave holes there, such as 0.001 m.
    """
    if not glances:
        return ""
    values = np.concatenate([each.values for each in glances])
    if not len(values):
        return ""
    least = values.min()
    share, others = float((values == least).mean()), values[values > least]
    if share <= MANY or not len(others) or least * _FAR > np.percentile(others, 5):
        return ""
    return (
        f"{share:.1%} of the known pixels hold the smallest value, {least:.4g} m, and nearly all others are farther "
        f"than {np.percentile(others, 5):.4g} m: does it stand for unknown? Then store 0 there"
    )


def _named(domain: str) -> str:
    return f" {domain}" if domain else ""
