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
    scores, weights = [], []
    for threshold in THRESHOLDS:
        true_edges, found_edges = _edges(truth, known, threshold), _edges(depth, known, threshold)
        n_true, n_found = true_edges.sum(), found_edges.sum()
        if not scores and n_true < MIN_PAIRS:
            return None
        if n_true + n_found:
            scores.append(2 * (true_edges & found_edges).sum() / (n_true + n_found))
            weights.append(threshold - 1)
    return float(np.average(scores, weights=weights))


def _edges(x: np.ndarray, known: np.ndarray, threshold: float) -> np.ndarray:
    """Return, for every pair of neighbours and both directions, True where the second is farther by the threshold."""
    pairs = [
        (x[:, :-1], x[:, 1:], known[:, :-1] & known[:, 1:]),
        (x[:-1], x[1:], known[:-1] & known[1:]),
    ]
    with np.errstate(invalid="ignore"):
        return np.concatenate([
            ((b > threshold * a) & both).ravel() if forward else ((a > threshold * b) & both).ravel()
            for a, b, both in pairs
            for forward in (True, False)
        ])  # fmt: skip
