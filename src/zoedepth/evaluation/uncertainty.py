"""Score the model's own uncertainty: does its standard deviation go with its errors?"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from zoedepth.errors import InputError

STEPS = 20
"""Number of equal parts in which the pixels are removed for the area under the sparsification error."""


@dataclass(frozen=True)
class UncertaintyScores:
    """Numbers of one image that say how far its standard deviations can be believed."""

    ause: float
    """Area under the sparsification error, divided by the area for pixels removed at random. The error is REL of the
    pixels that remain when the most uncertain are removed first, minus REL of those that remain when the worst are
    removed first. 0: the uncertainty ranks the pixels as their errors do. 1: it ranks them no better than chance."""
    coverage1: float
    """Share of pixels whose truth lies within one standard deviation (0.68 if errors were normal)."""
    coverage2: float
    """Share of pixels whose truth lies within two standard deviations (0.95 if errors were normal)."""


def score_uncertainty(
    depth: Float[np.ndarray, " pixels"], truth: Float[np.ndarray, " pixels"], std: Float[np.ndarray, " pixels"]
) -> UncertaintyScores:
    """Compare the standard deviation of the scored pixels with their errors; everything in metres."""
    error = np.abs(depth - truth)
    relative = error / truth
    by_uncertainty = _remaining(relative[_decreasing(std / depth)])
    by_error = _remaining(np.sort(relative)[::-1])
    chance = float(np.mean(relative.mean() - by_error))
    ause = float(np.mean(by_uncertainty - by_error)) / chance if chance > 0 else 0.0
    return UncertaintyScores(ause, float(np.mean(error <= std)), float(np.mean(error <= 2 * std)))


def fit_std_factor(errors: Sequence[Float[np.ndarray, " _"]]) -> float:
    """Return the factor on standard deviations that makes errors as large as they say: the root mean square.

    It is the most likely one if errors were normal. Every photo counts the same.

    Args:
        errors: |depth - truth| / std of the scored pixels of each photo, of photos that no training has seen.

    Raises:
        InputError: there is no photo, or a standard deviation is 0.
    """
    if not errors:
        raise InputError("a factor on the standard deviation needs photos with known depth; there are none")
    factor = float(np.sqrt(np.mean([np.mean(np.square(of_photo, dtype=np.float64)) for of_photo in errors])))
    if not 0 < factor < math.inf:
        raise InputError(
            f"the factor on the standard deviation would be {factor}: leave out photos where the deviation is 0, and "
            "photos on which the model makes no error"
        )
    return factor


def _decreasing(values: np.ndarray) -> np.ndarray:
    """Return the order of decreasing values, equal ones as they come.

    A stable sort returns the same, and takes three times as long where the processor has AVX-512 (38 ms for the pixels
    of a photo of NYU, and 10).
    """
    order = np.argsort(-values)
    ordered = values[order]
    equal = ordered[1:] == ordered[:-1]
    tied = np.flatnonzero(np.append(equal, False) | np.append(False, equal))
    order[tied] = order[tied][np.lexsort((order[tied], -ordered[tied]))]
    return order


def _remaining(relative: np.ndarray) -> np.ndarray:
    """Return the mean error of what remains after 0, 1/STEPS, 2/STEPS ... of the pixels are removed in this order."""
    n = len(relative)
    tails = np.cumsum(relative[::-1])[::-1]
    starts = np.arange(STEPS) * n // STEPS
    return tails[starts] / (n - starts)
