"""Depth maps whose truth is known, and readings in them."""

import numpy as np

from zoedepth.calibration import Point
from zoedepth.images import DepthArray

SIZE = (60, 80)


def room(*, error: float = 0.1, seed: int = 0) -> tuple[DepthArray, DepthArray]:
    """Return a model's depth and the truth of a room from 1 to 4 m: errors are log-normal, each over 10 x 10 pixels."""
    generator = np.random.default_rng(seed)
    across, along = np.meshgrid(np.linspace(1, 2, SIZE[1]), np.linspace(1, 2, SIZE[0]))
    truth = (across * along).astype(np.float32)
    errors = np.kron(generator.normal(0, error, (SIZE[0] // 10, SIZE[1] // 10)), np.ones((10, 10)))
    return (truth * np.exp(errors)).astype(np.float32), truth


def read(truth: DepthArray, n: int, *, seed: int = 0) -> list[Point]:
    """Return the truth in the middle of ``n`` of the patches that have one error each."""
    generator = np.random.default_rng(seed)
    patches = generator.permutation(48)[:n]
    places = [(10 * int(patch % 8) + 5, 10 * int(patch // 8) + 5) for patch in patches]
    return [(x, y, float(truth[y, x])) for x, y in places]
