"""The size at which the network sees a photo: integers only."""


def network_size(
    size: tuple[int, int], target: tuple[int, int], *, multiple: int = 32, keep_aspect_ratio: bool = True
) -> tuple[int, int]:
    """(height, width) a photo is resized to before the network.

    The photo is scaled by the one factor, of the two that make its height or its width equal the target's, that
    changes it least ("minimal"); both sides are then rounded to the nearest multiple, halves to even, and are at least
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
