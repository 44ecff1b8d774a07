"""Do a photo and a map about it lie alike and fit each other? A smaller map becomes points of the photo."""

from collections.abc import Sequence

import numpy as np

from zoedepth.errors import InputError
from zoedepth.stored import StoredMap

Size = Sequence[int]

_ALIKE = 0.01
"""Relative difference up to which proportions are the same: a camera's depth has pixels of some photo pixels' size."""
_MUCH = 1.5
"""Factor from which on a map is smaller because its camera is, and not because it was cropped."""


def says_how_it_lies(size: Size, orientation: int) -> bool:
    """Return True if a map of the same size must lie as the photo does.

    Args:
        size: (height, width) of the photo when it stands upright.
        orientation: the EXIF orientation by which it was turned.
    """
    return orientation == 1 or (orientation >= 5 and size[0] != size[1])  # turned by 90 degrees, sizes would differ


def check_fit(size: Size, found: Size, *, names: tuple[object, object], orientation: int = 1) -> None:
    """Check that a map has the size of its photo, or is smaller by a factor.

    Args:
        size: (height, width) of the photo when it stands upright.
        found: (height, width) of the map.
        names: the photo and the map, for the message.
        orientation: the EXIF orientation by which the photo was turned.

    Raises:
        InputError: neither; the message says how they differ, and what to do.
    """
    (height, width), (h, w) = size, found
    if (h, w) == (height, width):
        return
    alike, across = (abs(h * x - w * y) <= _ALIKE * h * x for y, x in ((height, width), (width, height)))
    if alike and height >= _MUCH * h:
        return
    if across and not alike:
        turned = (
            f"EXIF orientation {orientation} turns the photo by 90 degrees, and the map lies as the sensor does. Turn "
            "the map, too, or take the orientation out of the photo"
            if orientation >= 5
            else "one of them lies on its side. Turn it by 90 degrees"
        )
    elif alike and h < height:
        turned = f"the map is a little smaller, cropped or resized. Crop or resize the photo to {w} x {h} likewise"
    elif alike:
        turned = (
            f"the map is larger. Give the photo in its original size, or resize the map to {width} x {height} without "
            "mixing its values (nearest neighbour)"
        )
    else:
        turned = (
            "their proportions differ, so one of them is cropped. Crop the other one likewise; the map may then be "
            f"smaller than the photo by a factor of {_MUCH} or more"
        )
    raise InputError(
        f"{names[0]} is {(height, width)} and {names[1]} is {(h, w)} (height, width): sizes must agree, but {turned}"
    )


def lies_across(size: Size, found: Size) -> bool:
    """Return True if one of two sizes (height, width) is clearly upright and the other lies on its side.

    It is for maps that may be of another size, and squeezed.
    """
    (height, width), (h, w) = size, found
    return (height - width) * (h - w) < 0 and not 0.8 < height * w / (width * h) < 1.25


def check_lies_alike(size: Size, stored: StoredMap, *, names: tuple[object, object], orientation: int) -> None:
    """Check that a map fits its photo, and that both are turned alike.

    Args:
        size: (height, width) of the photo when it stands upright.
        stored: the map, turned by the orientation that its file says.
        names: the photo and the map, for the message.
        orientation: the EXIF orientation by which the photo was turned.

    Raises:
        InputError: the sizes do not fit (see ``check_fit``), or one is turned, and nothing says whether the other is.
    """
    check_fit(size, stored.values.shape, names=names, orientation=orientation)
    # A depth map that says its scale is of this package, which predicts the upright photo.
    own = orientation if stored.scale is not None else stored.orientation
    if own != orientation and not (says_how_it_lies(size, orientation) and says_how_it_lies(size, own)):
        turned, other = names if orientation != 1 else reversed(names)
        number = orientation if orientation != 1 else own
        raise InputError(
            f"{turned} is turned upright by its EXIF orientation {number}, and nothing says whether {other} is, too. "
            f"Save {turned} without the orientation, so that both lie alike"
        )


def spread(values: np.ndarray, size: Size) -> np.ndarray:
    """Put the values of a smaller map where they are in the photo; between them are zeros.

    Nothing is mixed or made up: depth between two values may be that of neither. The map shows what the photo shows, so
    the middle of each of its pixels has a place in the photo.

    Args:
        values: (height, width), of a size that ``check_fit`` lets pass.
        size: (height, width) of the photo.
    """
    if values.shape == tuple(size):
        return values
    rows, columns = (
        ((np.arange(n) + 0.5) * side / n).astype(np.int64) for n, side in zip(values.shape, size, strict=True)
    )
    points = np.zeros(tuple(size), values.dtype)
    points[np.ix_(rows, columns)] = values
    return points
