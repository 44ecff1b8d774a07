"""The answer of a network about a photo."""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

from zoedepth.images import DepthArray, ImageArray

Photos = Sequence[tuple[ImageArray, tuple[int, int]]]
"""Photos, each with the (height, width) at which the network sees it."""

Precision = Literal["float32", "bfloat16", "float16"]
"""The number type that torch computes products in; float16 is for GPUs."""


class Answer(NamedTuple):
    """The answer of a network about a photo, at the photo's size."""

    depth: DepthArray
    """Metres. Bicubic upsampling may overshoot at edges, to below zero for near things."""
    std: DepthArray | None
    """Metres: standard deviation, where the network has it."""
    domain: int
    """Index in ``config.domains`` of the head that the photo took."""
    probability: list[float] | None
    """The router's probability of each domain; None where it had nothing to decide."""


def in_groups(
    predict: Callable[[list[ImageArray], tuple[int, int]], list[Answer]], photos: Photos, batch_size: int
) -> list[Answer]:
    """Predict photos of one network size together, ``batch_size`` at most."""
    groups: dict[tuple[int, int], list[int]] = {}
    for row, (_, size) in enumerate(photos):
        groups.setdefault(size, []).append(row)
    answers: dict[int, Answer] = {}
    for size, rows in groups.items():
        for start in range(0, len(rows), batch_size):
            chunk = rows[start : start + batch_size]
            answers |= zip(chunk, predict([photos[row][0] for row in chunk], size), strict=True)
    return [answers[row] for row in range(len(photos))]
