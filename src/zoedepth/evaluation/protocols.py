"""How a data set is scored, as data (paper section 4.3 and its data set table)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool

from zoedepth.errors import InputError

Crop = Literal["none", "eigen", "garg"]


@dataclass(frozen=True)
class Protocol:
    """Everything that decides which pixels are scored, and against what."""

    name: str
    max_depth: float
    """Metres. Pixels whose true depth is not below are not scored; predictions are clipped to it."""
    min_depth: float = 1e-3
    """Metres. Likewise, from below."""
    crop: Crop = "none"
    """Which part of the picture is scored: see :func:`crop_mask`."""
    kitti_crop: bool = False
    """First the photo and its depth are cut to their bottom centre 352x1216."""
    flip_average: bool = True
    """The prediction is the mean of those for the photo and for its mirror image."""

    def __post_init__(self) -> None:
        if not 0 < self.min_depth < self.max_depth:
            raise InputError(f"need 0 < min_depth < max_depth, in metres; got {self.min_depth} and {self.max_depth}")


INDOOR = Protocol("indoor", max_depth=10.0, crop="eigen")
OUTDOOR = Protocol("outdoor", max_depth=80.0, crop="garg", kitti_crop=True)

PROTOCOLS: dict[str, Protocol] = {"indoor": INDOOR, "outdoor": OUTDOOR}
"""Domain → protocol: NYU's for indoor, KITTI's for outdoor data."""


def protocol_of(domain: str) -> Protocol:
    """The protocol of a domain.

    Raises:
        InputError: the domain has none.
    """
    if domain not in PROTOCOLS:
        raise InputError(f"no protocol is known for the domain {domain!r}; known are {sorted(PROTOCOLS)}")
    return PROTOCOLS[domain]


def crop_mask(size: tuple[int, int], crop: Crop) -> Bool[np.ndarray, "height width"]:
    """True where pixels are scored, for a picture of (height, width).

    "eigen" is rows 45..470, columns 41..600 whatever the size, as released; "garg" is the middle columns and lower rows
    as shares of the size. (Released ``utils/misc.py::compute_metrics``.)
    """
    height, width = size
    mask = np.zeros(size, dtype=bool)
    if crop == "none":
        mask[:] = True
    elif crop == "eigen":
        mask[45:471, 41:601] = True
    else:
        rows = slice(int(0.40810811 * height), int(0.99189189 * height))
        columns = slice(int(0.03594771 * width), int(0.96405229 * width))
        mask[rows, columns] = True
    return mask
