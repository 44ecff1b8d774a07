"""Score depth edges: how sharp a depth map is where the true depth jumps."""

import numpy as np
from jaxtyping import Bool, Float

THRESHOLDS = tuple(1 + 0.05 * step for step in range(1, 6))
"""Ratios of two neighbouring depths above which there is an edge: 5, 10, 15, 20 and 25 %."""
MIN_PAIRS = 100
"""Fewest edges that the truth must have at the first threshold for an image to get a score."""


def boundary_f1(
    depth: Float[np.ndarray, "height width"],
    truth: Float[np.ndarray, "height width"],
    known: Bool[np.ndarray, "height width"],
) -> float | None:
    """Compute the F1 score of occluding edges, in [0, 1]: the mean over thresholds t, each weighted by t - 1.

    An edge lies between two neighbouring known pixels, in a row or a column, where the farther is more than t times as
    far as the nearer. An edge of the prediction is right if the truth has one at the same place, in the same direction.
    A threshold at which neither map has an edge is left out. A factor on the depth changes nothing. (Bochkovskii et al.
    2024, Depth Pro, section 3.4, for horizontal and vertical neighbours.)

    Returns:
        None where the truth has fewer than ``MIN_PAIRS`` edges. Sparse lidar has none, as no two known pixels touch.
    """
    true, found, right = np.sum([_count_edges(depth, truth, known, *pair) for pair in _NEIGHBOURS], axis=0)
    if true[0] < MIN_PAIRS:
        return None
    there = true + found > 0
    return float(np.average(2 * right[there] / (true + found)[there], weights=np.array(THRESHOLDS)[there] - 1))


_FIRST, _LAST, _ALL = slice(None, -1), slice(1, None), slice(None)
_ROWS, _COLUMNS = ((_ALL, _FIRST), (_ALL, _LAST)), ((_FIRST, _ALL), (_LAST, _ALL))
_NEIGHBOURS = (_ROWS, _ROWS[::-1], _COLUMNS, _COLUMNS[::-1])
"""Where the nearer and the farther pixels of all pairs in one direction are."""


def _count_edges(
    depth: np.ndarray, truth: np.ndarray, known: np.ndarray, near: tuple[slice, slice], far: tuple[slice, slice]
) -> np.ndarray:
    """Count the edges in one direction: of the truth, of the prediction, of both at once. Ints (3, thresholds)."""
    with np.errstate(invalid="ignore"):
        somewhere = (truth[far] > THRESHOLDS[0] * truth[near]) | (depth[far] > THRESHOLDS[0] * depth[near])
    # Most pairs are no edge of either map at the first threshold, and so at none.
    somewhere &= known[near] & known[far]
    true, found = (
        np.stack([x[far][somewhere] > threshold * x[near][somewhere] for threshold in THRESHOLDS])
        for x in (truth, depth)
    )
    return np.stack([true.sum(1), found.sum(1), (true & found).sum(1)])
