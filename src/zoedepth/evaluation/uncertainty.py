"""Whether a model knows when it is wrong: its own standard deviation against its errors."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

STEPS = 20


@dataclass(frozen=True)
class Calibration:
    """Of one image."""

    ause: float
    """Area under the sparsification error: the REL that is left when the least sure pixels are taken away first, above
    what is left when the worst are; over the same for pixels taken away by chance. 0: the doubts are in the order of
    the errors, 1: they are in no order."""
    coverage1: float
    """Share of pixels whose truth lies within one standard deviation (0.68 if errors were normal)."""
    coverage2: float
    """The same within two (0.95)."""


def calibration(
    depth: Float[np.ndarray, " pixels"], truth: Float[np.ndarray, " pixels"], std: Float[np.ndarray, " pixels"]
) -> Calibration:
    """How the uncertainty of the scored pixels goes with their errors; all in metres."""
    error = np.abs(depth - truth)
    relative = error / truth
    by_doubt = _left(relative, np.argsort(-(std / depth), kind="stable"))
    by_error = _left(relative, np.argsort(-relative, kind="stable"))
    chance = float(np.mean(relative.mean() - by_error))
    ause = float(np.mean(by_doubt - by_error)) / chance if chance > 0 else 0.0
    return Calibration(ause, float(np.mean(error <= std)), float(np.mean(error <= 2 * std)))


def _left(relative: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Mean error of what is left after 0, 1/STEPS, 2/STEPS ... of the pixels are taken away in the given order."""
    n = len(order)
    tails = np.cumsum(relative[order][::-1])[::-1]
    starts = np.arange(STEPS) * n // STEPS
    return tails[starts] / (n - starts)
