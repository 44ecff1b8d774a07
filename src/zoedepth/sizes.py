"""The size at which the network sees a photo, and the focal length that the photo then has."""

import math


def network_size(
    size: tuple[int, int], target: tuple[int, int], *, multiple: int = 32, keep_aspect_ratio: bool = True
) -> tuple[int, int]:
    """Return the (height, width) a photo is resized to before the network.

    One factor makes the photo's height equal the target's, another its width. The photo is scaled by the factor that
    changes it least ("minimal"). Both sides are then rounded to the nearest multiple, halves to even, and are at least
    one multiple. (MiDaS ``transforms.py::Resize.get_size`` as ZoeDepth calls it.)

    Args:
        size: (height, width) of the photo, pixels.
        target: (height, width) the network was trained at, pixels.
        multiple: both sides of the result are multiples of this.
        keep_aspect_ratio: False gives the target itself.
    """
    if not keep_aspect_ratio:
        return target
    scales = (target[0] / size[0], target[1] / size[1])
    scale = scales[1] if abs(1 - scales[1]) < abs(1 - scales[0]) else scales[0]
    height, width = (max(multiple, round(scale * side / multiple) * multiple) for side in size)
    return height, width


def border(size: tuple[int, int]) -> tuple[int, int]:
    """Return how many rows and columns a photo of ``size`` is padded by on each side, as released: 3 sqrt(side / 2)."""
    return int(math.sqrt(size[0] / 2) * 3), int(math.sqrt(size[1] / 2) * 3)


def network_focal(focal_px: float, height: int, network_height: int) -> float:
    """Return the focal length of a photo as the network sees it, in pixels of the network's input.

    It is the vertical one. Where photos are squeezed, depth follows their height, not their width: docs/results.md,
    "Which of the two focal lengths counts".

    Args:
        focal_px: fy, pixels of the photo.
        height: rows of the photo, with its padding if it gets any: padding makes things look smaller, too.
        network_height: rows to which the padded photo is resized.
    """
    return focal_px * network_height / height
