"""Agreement of depth edges: how sharp a depth map is where the truth jumps."""

import numpy as np
from jaxtyping import Bool, Float

THRESHOLDS = tuple(1 + 0.05 * step for step in range(1, 6))
"""Ratios of neighbouring depths above which there is an edge; 5 to 25 %, the larger of more weight."""
MIN_PAIRS = 100
"""Below this many edges of the truth at the first threshold there is nothing to measure."""


def boundary_f1(
    depth: Float[np.ndarray, "height width"],
    truth: Float[np.ndarray, "height width"],
    known: Bool[np.ndarray, "height width"],
) -> float | None:
    """F1 of occluding edges, in [0, 1], averaged over thresholds with the threshold's excess as weight.

    A threshold above which neither has an edge says nothing and is left out.

    An edge lies between two neighbouring known pixels, in a row or a column, where the farther is more than t times the
    nearer; it agrees if it lies in the same place and falls in the same direction. It does not see a factor on the
    depth. (Bochkovskii et al. 2024, Depth Pro, section 3.4, for neighbours across and down.)

    Returns:
        None where the truth has too few neighbouring known pixels with an edge: sparse lidar has none.
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
    """For every pair of neighbours, in both directions: whether the second is farther by more than the threshold."""
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
