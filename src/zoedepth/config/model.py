"""The configuration of a model, in frozen dataclasses that every checkpoint carries as JSON."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Literal

from zoedepth.config.baselines import DornNetworkConfig, NetworkConfig
from zoedepth.config.checks import require
from zoedepth.config.heads import AttractorConfig, DornConfig, HeadConfig
from zoedepth.errors import InputError


@dataclass(frozen=True)
class EncoderConfig:
    """An encoder: a timm architecture, and where its four feature maps are taken (``presets.ENCODERS`` lists them)."""

    name: str
    """timm architecture."""
    family: Literal["beit", "swin", "convolutional"]
    """BEiT gives tokens at one stride; the others give maps at strides 4, 8, 16, 32."""
    size: tuple[int, int]
    """(height, width) of the pre-training: the size of BEiT's position tables, and the only size that Swin takes."""
    taps: tuple[int, ...] = ()
    """BEiT: indices of the four blocks whose outputs are the maps. Others: empty; their four stages give the maps."""
    channels: tuple[int, ...] = ()
    """BEiT: channels that the four maps are reassembled to. Others: empty; the maps are used as they are."""
    width: int | None = None
    """Width of the first stage, in place of timm's: for small random twins."""
    depth: tuple[int, ...] | None = None
    """Number of blocks (of each stage), in place of timm's."""
    heads: tuple[int, ...] | None = None
    """Number of attention heads (of each stage), in place of timm's."""
    mlp_width: int | None = None
    """BEiT: hidden channels of the blocks' MLPs, in place of four times the width."""

    def __post_init__(self) -> None:
        n_maps = 4 if self.family == "beit" else 0
        require(len(self.taps) == n_maps and list(self.taps) == sorted(set(self.taps)), "encoder.taps",
                f"{n_maps} increasing numbers for {self.family}", self.taps)  # fmt: skip
        require(len(self.channels) == n_maps, "encoder.channels", f"{n_maps} numbers for {self.family}", self.channels)
        if self.mlp_width is not None and (self.family != "beit" or self.width is None):
            raise InputError(
                f"encoder.mlp_width is {self.mlp_width}, which only a BEiT with encoder.width can have. "
                "Set encoder.width too, or leave mlp_width out."
            )


@dataclass(frozen=True)
class DecoderConfig:
    """DPT decoder: reassemble, four fusion levels, relative head."""

    widths: tuple[int, int, int, int] = (256, 256, 256, 256)
    """Channels of the levels at strides 4, 8, 16, 32."""
    features: int = 32
    """Channels of the last decoder map, from which the relative depth and the probabilities are predicted."""
    output_stride: Literal[1, 2] = 1
    """Stride of that last map. 1: as published. 2: a quarter of the work."""
    upsampling: Literal["bilinear", "convex"] = "bilinear"
    """How depth gets the size of the pixels. bilinear: as published. convex (output stride 2 only): each pixel is a
    weighted mean of the nine depths around it, with weights learned from the last map and the photo (Teed & Deng 2020);
    edges of depth can be as sharp as those of the photo."""

    def __post_init__(self) -> None:
        require(self.upsampling == "bilinear" or self.output_stride == 2, "decoder.upsampling",
                "'bilinear' where decoder.output_stride is 1", self.upsampling)  # fmt: skip


@dataclass(frozen=True)
class RouterConfig:
    """The router, which chooses the metric head of each image (paper section 3.3)."""

    kind: Literal["labeled", "trained", "auto"] = "trained"
    """labeled (R.1): the caller chooses. trained (R.2): a classifier, trained on labels. auto (R.3): a classifier,
    trained by the depth loss alone."""
    classifier: Literal["mlp", "transformer"] = "mlp"
    """mlp: on the pooled bottleneck (paper). transformer: four layers over the bottleneck's tokens (released)."""
    width: int = 128
    """Channels of the classifier."""
    attention_heads: int = 4
    """Transformer only: number of attention heads of each layer."""
    feedforward_width: int = 1024
    """Transformer only: hidden channels of each layer's MLP."""
    vote: Literal["image", "batch"] = "image"
    """image: each image takes the head of its own best score. batch: all take the head with the best sum of scores over
    the batch, as in the released code and in transformers."""

    def __post_init__(self) -> None:
        require(self.vote == "image" or self.kind == "trained", "router.vote",
                f"'image' where router.kind is {self.kind!r}", self.vote)  # fmt: skip
        if self.classifier == "transformer":
            require(self.attention_heads >= 1 and self.width % self.attention_heads == 0, "router.attention_heads",
                     f"a divisor of the width {self.width}", self.attention_heads)  # fmt: skip


@dataclass(frozen=True)
class Domain:
    """A scene type with its own metric head."""

    name: str
    """Scene type, as in the data's ``domain`` column: "indoor", "outdoor" or your own."""
    min_depth: float = 1e-3
    """Nearest depth, metres."""
    max_depth: float = 10.0
    """Farthest depth, metres. It bounds normed centers; softplus centers may go beyond. In a canonical camera it bounds
    the depth that is scaled to that camera, which is ``focal_px`` / focal length times the depth of the scene."""
    focal_px: float | None = None
    """Focal length (the vertical one) of the photos that the model learned this domain's metres from, in pixels of the
    photo as the network saw it, see ``zoedepth.sizes.network_focal``. None: not known. It belongs to the config's
    ``size``."""
    std_factor: float = 1.0
    """Factor on the standard deviation of the bins, fitted on photos that no training has seen, so that errors are as
    large as it says (``scripts/fit_std.py``). ``Predictor`` applies it, the network does not. It belongs to the
    weights. 1: as published, not fitted."""

    def __post_init__(self) -> None:
        require(bool(self.name), "domain.name", "a name of at least one letter", self.name)
        require(self.focal_px is None or 0 < self.focal_px < math.inf, "domain.focal_px",
                "a finite number of pixels > 0, or None", self.focal_px)  # fmt: skip
        require(0 < self.std_factor < math.inf, "domain.std_factor", "a finite number > 0", self.std_factor)
        if not 0 < self.min_depth < self.max_depth:
            raise InputError(
                f"domain {self.name!r} has a min_depth of {self.min_depth} and a max_depth of {self.max_depth}. "
                "Set them in metres, with 0 < min_depth < max_depth."
            )


MAX_SIDE = 8192
"""Largest side of a network input, pixels: a config from elsewhere must not ask for unlimited memory."""

INDOOR = Domain("indoor", 1e-3, 10.0)
OUTDOOR = Domain("outdoor", 1e-3, 80.0)


@dataclass(frozen=True, kw_only=True)
class _PhotoConfig(ABC):
    """The fields that all models have: their domains, and the photos they take."""

    domains: tuple[Domain, ...] = (INDOOR,)
    """The domains, each of which has a metric head. Empty: the model gives relative depth only (MiDaS)."""
    size: tuple[int, int] = (384, 512)
    """(height, width) the model is trained at; photos are resized near it."""
    antialias: bool = False
    """True: photos are resized with a filter against aliasing. False in the released models."""
    resize: Literal["keep-aspect", "squeeze"] = "keep-aspect"
    """keep-aspect: photos keep their proportions, up to rounding. squeeze: they become exactly ``size``, as in the
    released code's "eval" and "train" modes, and always for Swin encoders."""
    pad: bool = True
    """True: unless the caller says otherwise, borders of photos are reflected outwards before the network, and cut off
    after it (released ``infer``). The photo then fills less of the input; a model must be used to it."""
    canonical_camera: bool = False
    """True: while training, depth was scaled to one camera, by ``focal_px`` of the domain / focal length of the photo,
    so that a lens changes nothing; predicted depth is scaled back by the focal length of the photo, where it is known
    (Metric3D, section 3.1). False: as published, metres hold for the lenses that the model was trained with."""

    def __post_init__(self) -> None:
        if self.canonical_camera and (without := [domain.name for domain in self.domains if domain.focal_px is None]):
            raise InputError(
                f"canonical_camera needs the focal length of the one camera in each domain, and {without} have none. "
                "Set focal_px of these domains, in pixels of the network's input"
            )
        names = [domain.name for domain in self.domains]
        require(len(set(names)) == len(names), "the names of domains", "all different", names)
        require(all(0 < side <= MAX_SIDE and side % self.multiple == 0 for side in self.size), "size",
                f"(height, width), multiples of {self.multiple} up to {MAX_SIDE}", self.size)  # fmt: skip

    @property
    def multiple(self) -> int:
        """The number that the sides of the network input are multiples of: the stride of the coarsest map."""
        return 32

    @property
    def one_size(self) -> bool:
        """True where the network takes inputs of ``size`` only."""
        return False

    @property
    def keep_aspect_ratio(self) -> bool:
        """True where photos keep their proportions."""
        return self.resize == "keep-aspect" and not self.one_size

    @property
    @abstractmethod
    def encoder_name(self) -> str:
        """The encoder's name in timm."""


@dataclass(frozen=True)
class ModelConfig(_PhotoConfig):
    """A whole ZoeDepth model (paper Fig. 2)."""

    encoder: EncoderConfig
    decoder: DecoderConfig = field(default_factory=DecoderConfig)
    head: HeadConfig = field(default_factory=AttractorConfig)
    """The kind of metric head; every domain has its own."""
    router: RouterConfig = field(default_factory=RouterConfig)
    """Ignored with a single domain."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.encoder.family == "swin":
            require(self.size == self.encoder.size, "size",
                    f"{self.encoder.size}, the only one that {self.encoder.name} takes", self.size)  # fmt: skip
        if self.router.kind == "auto" and len(self.domains) > 1 and isinstance(self.head, DornConfig):
            raise InputError(
                "router.kind is 'auto', which trains on a mixture of the heads' depths, but DORN's loss needs the "
                "intervals of one head. Set router.kind to 'labeled' or 'trained', or take another head."
            )

    @property
    def one_size(self) -> bool:
        """True for Swin, whose position tables and windows fit one size only."""
        return self.encoder.family == "swin"

    @property
    def encoder_name(self) -> str:
        """The encoder's name in timm."""
        return self.encoder.name


@dataclass(frozen=True)
class BaselineConfig(_PhotoConfig):
    """A system the paper compares with, as its authors built it: no DPT decoder, no relative depth, no router."""

    network: NetworkConfig
    size: tuple[int, int] = field(default=(480, 640), kw_only=True)
    """(height, width) the model is trained at; photos are resized near it."""
    pad: bool = field(default=False, kw_only=True)
    """True: borders of photos are reflected outwards before the network, and cut off after it. No baseline does it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.domains) == 1, "domains", "exactly one, since a baseline has one head", self.domains)

    @property
    def multiple(self) -> int:
        """The number that the sides of the network input are multiples of. DORN's are 8 n + 1: any of them."""
        return 1 if self.one_size else 32

    @property
    def one_size(self) -> bool:
        """True for DORN, which has a layer of fixed size over the whole photo."""
        return isinstance(self.network, DornNetworkConfig)

    @property
    def encoder_name(self) -> str:
        """The encoder's name in timm."""
        return self.network.encoder


AnyModelConfig = ModelConfig | BaselineConfig
"""The config of any model in this package."""


def network_alone(config: AnyModelConfig) -> AnyModelConfig:
    """Return the config of the network alone: without cameras, and without what was fitted to its errors."""
    domains = tuple(replace(domain, focal_px=None, std_factor=1.0) for domain in config.domains)
    return replace(config, domains=domains, canonical_camera=False)
