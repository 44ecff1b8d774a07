"""Protocols: how a data set is scored, as data; all that makes two people's numbers differ (paper section 4.3)."""

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool

from zoedepth.errors import InputError, no_such

Crop = Literal["none", "eigen", "eigen-scaled", "garg"]


@dataclass(frozen=True)
class Protocol:
    """Everything that decides which pixels are scored, against which truth, and with which prediction."""

    name: str
    """Name of the protocol; ``hash`` tells two protocols of one name apart."""
    max_depth: float
    """Metres. Only pixels whose true depth is below are scored; predictions are clipped to it."""
    min_depth: float = 1e-3
    """Metres. Only pixels whose true depth is above are scored, predictions are clipped to it; 0 scores every positive
    depth."""
    crop: Crop = "none"
    """Part of the true depth that is scored; see ``crop_mask``."""
    kitti_crop: bool = False
    """True where photos of the size of KITTI's frames, and their depth, are first cut to 352x1216 pixels, see
    ``augment.kitti_crop``."""
    photo_size: tuple[int, int] | None = None
    """(height, width) to which the photo is resized first, whatever its proportions; None leaves it as it is."""
    photo_short_side: int | None = None
    """Pixels to which the photo's shorter side is resized first, in proportion; None leaves it as it is."""
    photo_antialias: bool = True
    """True where that first resizing filters against aliasing; False as torchvision did it for the released code."""
    resize: Literal["keep-aspect", "squeeze"] = "keep-aspect"
    """How the model then resizes the photo: in proportion, or to exactly the trained size."""
    pad: bool = False
    """True where the photo's borders are reflected outwards before the model."""
    flip_average: bool = True
    """True where the prediction is the mean of those for the photo and for its mirror image."""
    upsampling: Literal["bilinear", "bicubic"] = "bilinear"
    """Interpolation from the network's output to the size of the photo; bilinear has its corners aligned."""
    mean: Literal["images", "pixels"] = "images"
    """Metrics are averaged over images, or taken over all pixels at once."""
    use_mask: bool = True
    """True where pixels that the data set marks as invalid are left out."""
    alignment: Literal["none", "median", "disparity"] = "none"
    """How the prediction is aligned with the truth before it is scored. none: not at all; it is metric depth. median:
    by the factor that makes the medians equal. disparity: by scale and shift of the inverse depth, found by least
    squares, for relative depth."""
    decoding: str = "metres"
    """Meaning of the stored true depth, in words; the data set's class does the decoding."""

    def __post_init__(self) -> None:
        if not 0 <= self.min_depth < self.max_depth:
            raise InputError(
                f"a protocol needs 0 <= min_depth < max_depth, in metres; got {self.min_depth} and {self.max_depth}"
            )
        if self.photo_size is not None and self.photo_short_side is not None:
            raise InputError("a protocol has photo_size or photo_short_side, not both: set one of them to None")

    @property
    def hash(self) -> str:
        """Eight characters that depend on every field except the name."""
        values = {**asdict(self), "min_depth": float(self.min_depth), "max_depth": float(self.max_depth)}
        del values["name"]
        if self.photo_antialias:
            del values["photo_antialias"]  # so that protocols keep the hashes from before there was a choice
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:8]

    @property
    def label(self) -> str:
        """Name and hash, as they stand beside every result."""
        return f"{self.name}#{self.hash}"


def _paper(name: str, max_depth: float, crop: Crop, *, kitti_crop: bool = False, decoding: str) -> Protocol:
    """Make a protocol of the paper: a row of its table of data sets, and "resizing to the training resolution"."""
    return Protocol(name, max_depth, crop=crop, kitti_crop=kitti_crop, resize="squeeze", decoding=decoding)


# The paper's overview of data sets. Crops are shares of the picture, taken from the pictures they were made for.
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
    # Differences of the released code (``data_mono.py``, ``config.py``, ``misc.py::compute_metrics``) from the paper.
    # "eigen" is rows 45 to 470 and columns 41 to 600, whatever the size of the picture.
    "nyu": {},
    # SUN RGB-D is not read in millimetres, as the released loader does, which makes the linked files 10 times too far.
    "sunrgbd": {"min_depth": 0.0, "crop": "eigen"},
    "ibims": {"min_depth": 0.0},
    "diode-indoor": {"crop": "eigen", "use_mask": False, "photo_short_side": 480, "photo_antialias": False},
    "hypersim": {"crop": "eigen", "photo_size": (480, 640), "photo_antialias": False,
                 "decoding": "float, distance along the ray of a camera of f = 886.81 px, metres; NaN unknown"},
    "kitti": {},
    "vkitti2": {"decoding": "16-bit PNG, centimetres; beyond 80 m unknown"},
    "ddad": {"photo_size": (352, 1216), "photo_antialias": False},
    "diml-outdoor": {"min_depth": 2.0},
    "diode-outdoor": {"use_mask": False, "photo_short_side": 480, "photo_antialias": False},
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
    # For your own data, by its domain: as NYU and KITTI, except that photos keep their proportions and the Eigen crop
    # is a share of the photo (the same on 480x640).
    "indoor": INDOOR,
    "outdoor": OUTDOOR,
    "plain": PLAIN,
}
"""Name → protocol. The ten evaluation sets as the paper says; with "-released" as its code does; and three for your own
data: "indoor", "outdoor", and "plain", which scores every known pixel up to 1 km."""


def protocol_of(domain: str) -> Protocol:
    """Return the protocol for your own data of a domain: "plain" for one that is neither indoor nor outdoor."""
    return {"indoor": INDOOR, "outdoor": OUTDOOR}.get(domain, PLAIN)


def find_protocol(name: str) -> Protocol:
    """Return a protocol of ``PROTOCOLS`` by name.

    Raises:
        InputError: there is none of this name.
    """
    if name not in PROTOCOLS:
        raise no_such("protocol", name, PROTOCOLS)
    return PROTOCOLS[name]


def crop_mask(size: tuple[int, int], crop: Crop) -> Bool[np.ndarray, "height width"]:
    """Return True where pixels are scored, for a true depth of (height, width).

    "eigen" is rows 45 to 470 and columns 41 to 600 whatever the size, as released; nothing is left of a small picture.
    "eigen-scaled" is the share of the picture that this is of 480x640. "garg" is the middle columns and lower rows, as
    shares. (Released ``utils/misc.py::compute_metrics``.)
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
