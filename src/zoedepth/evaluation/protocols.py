"""How a data set is scored, as data: all that makes two people's numbers differ (paper section 4.3, appendix)."""

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool

from zoedepth.errors import InputError

Crop = Literal["none", "eigen", "eigen-scaled", "garg"]


@dataclass(frozen=True)
class Protocol:
    """Everything that decides which pixels are scored, against what, and with which prediction."""

    name: str
    """Of the protocol; its ``hash`` tells two of one name apart."""
    max_depth: float
    """Metres. Pixels whose true depth is not below are not scored; predictions are clipped to it."""
    min_depth: float = 1e-3
    """Metres. Likewise, from below; 0 scores every positive depth."""
    crop: Crop = "none"
    """Which part of the true depth is scored: see ``crop_mask``."""
    kitti_crop: bool = False
    """First the photo and its depth are cut to their bottom centre 352x1216."""
    photo_size: tuple[int, int] | None = None
    """(height, width) the photo is resized to first, its proportions lost; None: as it is."""
    photo_short_side: int | None = None
    """Pixels the photo's shorter side is resized to first, its proportions kept; None: as it is."""
    resize: Literal["keep-aspect", "squeeze"] = "keep-aspect"
    """How the model then resizes the photo: keeping its proportions, or to exactly the trained size."""
    pad: bool = False
    """The photo's borders are reflected outwards before the model."""
    flip_average: bool = True
    """The prediction is the mean of those for the photo and for its mirror image."""
    upsampling: Literal["bilinear", "bicubic"] = "bilinear"
    """From the prediction's to the true depth's size; bilinear has its corners aligned."""
    mean: Literal["images", "pixels"] = "images"
    """Metrics are averaged over images, or taken over all pixels at once."""
    use_mask: bool = True
    """Pixels that the data set marks as invalid are left out."""
    alignment: Literal["none", "median", "disparity"] = "none"
    """What the prediction is given of the truth before it is scored. none: metric depth. median: the factor that makes
    the medians equal. disparity: scale and shift of the inverse depth by least squares, for relative depth."""
    decoding: str = "metres"
    """What the stored true depth means, in words; the data set's class acts on it."""

    def __post_init__(self) -> None:
        if not 0 <= self.min_depth < self.max_depth:
            raise InputError(f"need 0 <= min_depth < max_depth, in metres; got {self.min_depth} and {self.max_depth}")
        if self.photo_size is not None and self.photo_short_side is not None:
            raise InputError("a protocol gives the photo's size or its shorter side, not both")

    @property
    def hash(self) -> str:
        """Eight characters that change with every field but the name."""
        values = {**asdict(self), "min_depth": float(self.min_depth), "max_depth": float(self.max_depth)}
        del values["name"]
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:8]

    @property
    def label(self) -> str:
        """Name and hash, as every result carries them."""
        return f"{self.name}#{self.hash}"


def _paper(name: str, max_depth: float, crop: Crop, *, kitti_crop: bool = False, decoding: str) -> Protocol:
    """As the paper says: its data set table, and "resizing to the training resolution"."""
    return Protocol(name, max_depth, crop=crop, kitti_crop=kitti_crop, resize="squeeze", decoding=decoding)


# The paper's data set overview. Its crops are taken as relative to the picture, as for the pictures they were made for.
_NYU = _paper("nyu", 10.0, "eigen", decoding="16-bit PNG, millimetres; 0 unknown")
_SUN = _paper("sunrgbd", 8.0, "eigen-scaled", decoding="16-bit PNG, bits rotated right by 3, millimetres; 0 unknown")
_IBIMS = _paper("ibims", 10.0, "eigen", decoding="16-bit PNG, value * 50 / 65535 m; masks invalid and transparent")
_DIODE_IN = _paper("diode-indoor", 10.0, "eigen-scaled", decoding="float32 metres; validity mask beside it")
_HYPERSIM = _paper("hypersim", 80.0, "eigen-scaled", decoding="float, distance along the ray, metres; NaN unknown")
_KITTI = _paper("kitti", 80.0, "garg", kitti_crop=True, decoding="16-bit PNG, value / 256 m; 0 unknown")
_VKITTI = _paper("vkitti2", 80.0, "garg", kitti_crop=True, decoding="16-bit PNG, centimetres; sky 655.35 m")
_DDAD = _paper("ddad", 80.0, "garg", decoding="float32 metres, projected lidar; 0 unknown")
_DIML = _paper("diml-outdoor", 80.0, "garg", decoding="16-bit PNG, millimetres; 0 unknown")
_DIODE_OUT = _paper("diode-outdoor", 80.0, "garg", decoding="float32 metres; validity mask beside it")

_RELEASED = {
    # Where the released code (``data_mono.py``, ``config.py``, ``misc.py::compute_metrics``) does another thing than
    # the paper says. "eigen" are rows 45 to 470 and columns 41 to 600 whatever the size of the picture.
    "nyu": {},
    "sunrgbd": {"min_depth": 0.0, "crop": "eigen", "decoding": "16-bit PNG, millimetres; beyond 8 m unknown"},
    "ibims": {"min_depth": 0.0},
    "diode-indoor": {"crop": "eigen", "use_mask": False, "photo_short_side": 480},
    "hypersim": {"crop": "eigen", "photo_size": (480, 640),
                 "decoding": "float, distance along the ray of a camera of f = 886.81 px, metres; NaN unknown"},
    "kitti": {},
    "vkitti2": {"decoding": "16-bit PNG, centimetres; beyond 80 m unknown"},
    "ddad": {"photo_size": (352, 1216)},
    "diml-outdoor": {"min_depth": 2.0},
    "diode-outdoor": {"use_mask": False, "photo_short_side": 480},
}  # fmt: skip

_PAPER = (_NYU, _SUN, _IBIMS, _DIODE_IN, _HYPERSIM, _KITTI, _VKITTI, _DDAD, _DIML, _DIODE_OUT)

INDOOR = Protocol("indoor", max_depth=10.0, crop="eigen-scaled")
OUTDOOR = Protocol("outdoor", max_depth=80.0, crop="garg", kitti_crop=True)
PLAIN = Protocol("plain", max_depth=1000.0)

PROTOCOLS: dict[str, Protocol] = {
    **{protocol.name: protocol for protocol in _PAPER},
    **{
        f"{protocol.name}-released": replace(protocol, name=f"{protocol.name}-released", **_RELEASED[protocol.name])
        for protocol in _PAPER
    },
    # For data of your own, by its domain: NYU's and KITTI's, but for photos that keep their proportions, and an Eigen
    # crop that goes with the size of the photo (on 480x640 it is the same).
    "indoor": INDOOR,
    "outdoor": OUTDOOR,
    "plain": PLAIN,
}
"""Name → protocol. The ten evaluation sets as the paper says, the same "-released" as its code does, and three for data
of your own: "indoor", "outdoor", and "plain", which scores every known pixel up to 1 km."""


def protocol_of(domain: str) -> Protocol:
    """The protocol of a domain: "plain" for one that is not indoor or outdoor."""
    return {"indoor": INDOOR, "outdoor": OUTDOOR}.get(domain, PLAIN)


def find_protocol(name: str) -> Protocol:
    """A protocol by name.

    Raises:
        InputError: there is none.
    """
    if name not in PROTOCOLS:
        raise InputError(f"there is no protocol {name!r}; there are {sorted(PROTOCOLS)}")
    return PROTOCOLS[name]


def crop_mask(size: tuple[int, int], crop: Crop) -> Bool[np.ndarray, "height width"]:
    """True where pixels are scored, for a true depth of (height, width).

    "eigen" is rows 45 to 470, columns 41 to 600 whatever the size, as released; "eigen-scaled" the same share of the
    picture as of 480x640; "garg" the middle columns and lower rows, as shares. (Released
    ``utils/misc.py::compute_metrics``.) Of a small picture nothing may be left.
    """
    height, width = size
    rows, columns = {
        "none": (slice(0, height), slice(0, width)),
        "eigen": (slice(45, 471), slice(41, 601)),
        "eigen-scaled": (
            slice(round(45 / 480 * height), round(471 / 480 * height)),
            slice(round(41 / 640 * width), round(601 / 640 * width)),
        ),
        "garg": (
            slice(int(0.40810811 * height), int(0.99189189 * height)),
            slice(int(0.03594771 * width), int(0.96405229 * width)),
        ),
    }[crop]
    mask = np.zeros(size, dtype=bool)
    mask[rows, columns] = True
    return mask
