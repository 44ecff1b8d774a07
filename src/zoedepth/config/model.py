"""The configuration of a model: frozen dataclasses, written into every checkpoint as JSON."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Literal

from zoedepth.config.baselines import DornNetworkConfig, NetworkConfig
from zoedepth.config.checks import require
from zoedepth.config.heads import AttractorConfig, DornConfig, HeadConfig


@dataclass(frozen=True)
class EncoderConfig:
    """An encoder: a timm architecture and where its four feature maps are taken (table in ``model/encoder.py``)."""

    name: str
    """timm architecture."""
    family: Literal["beit", "swin", "convolutional"]
    """How its features are read: BEiT gives tokens at one stride, the others a pyramid at strides 4, 8, 16, 32."""
    size: tuple[int, int]
    """(height, width) of the pre-training: the size of BEiT's position tables, the only size Swin takes."""
    taps: tuple[int, ...] = ()
    """BEiT: index of the four blocks whose outputs are the maps. Others: empty, they have exactly four stages."""
    channels: tuple[int, ...] = ()
    """BEiT: channels the four maps are reassembled to. Others: empty, the maps are used as they are."""
    width: int | None = None
    """Width of the first stage in place of timm's, for small random twins."""
    depth: tuple[int, ...] | None = None
    """Number of blocks (of each stage) in place of timm's."""
    heads: tuple[int, ...] | None = None
    """Number of attention heads (of each stage) in place of timm's."""
    mlp_width: int | None = None
    """BEiT: hidden channels of the blocks' MLPs in place of four times the width."""

    def __post_init__(self) -> None:
        n_maps = 4 if self.family == "beit" else 0
        require(len(self.taps) == n_maps and list(self.taps) == sorted(set(self.taps)), "encoder.taps",
                f"{n_maps} increasing numbers for {self.family}", self.taps)  # fmt: skip
        require(len(self.channels) == n_maps, "encoder.channels", f"{n_maps} numbers for {self.family}", self.channels)
        require(self.mlp_width is None or (self.family == "beit" and self.width is not None), "encoder.mlp_width",
                 "of BEiT, beside a width", self.mlp_width)  # fmt: skip


@dataclass(frozen=True)
class DecoderConfig:
    """DPT decoder: reassemble, four fusion levels, relative head."""

    widths: tuple[int, int, int, int] = (256, 256, 256, 256)
    """Channels of the levels at strides 4, 8, 16, 32."""
    features: int = 32
    """Channels of the last decoder map, the one the relative depth and the probabilities are predicted from."""
    output_stride: Literal[1, 2] = 1
    """Stride of that last map. 1: as published. 2: a quarter of the work; depth is then upsampled bilinearly."""


@dataclass(frozen=True)
class RouterConfig:
    """Which metric head an image takes (paper section 3.3)."""

    kind: Literal["labeled", "trained", "auto"] = "trained"
    """R.1: told by the caller. R.2: a classifier trained on labels. R.3: a classifier trained by the depth alone."""
    classifier: Literal["mlp", "transformer"] = "mlp"
    """mlp: of the pooled bottleneck (paper). transformer: four layers over the bottleneck's tokens (released)."""
    width: int = 128
    """Channels of the classifier."""
    attention_heads: int = 4
    """Transformer only: heads of each layer."""
    feedforward_width: int = 1024
    """Transformer only: hidden channels of each layer's MLP."""
    vote: Literal["image", "batch"] = "image"
    """image: each image takes the head of its own best score. batch: all take that of the best sum of scores over the
    batch (what the released code and transformers do)."""

    def __post_init__(self) -> None:
        require(self.vote == "image" or self.kind == "trained", "router.vote", "'image' unless the router is trained",
                 self.vote)  # fmt: skip
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
    """Farthest depth, metres. Bounds normed centers; softplus centers may go beyond."""

    def __post_init__(self) -> None:
        require(bool(self.name), "domain.name", "a name", self.name)
        require(0 < self.min_depth < self.max_depth, f"domain {self.name!r}", "0 < min_depth < max_depth, in metres",
                 (self.min_depth, self.max_depth))  # fmt: skip


MAX_SIDE = 8192
"""Of a network input, pixels: a config from elsewhere may not ask for any amount of memory."""

INDOOR = Domain("indoor", 1e-3, 10.0)
OUTDOOR = Domain("outdoor", 1e-3, 80.0)


@dataclass(frozen=True, kw_only=True)
class _PhotoConfig(ABC):
    """What every model says of its domains, and of the photos it takes."""

    domains: tuple[Domain, ...] = (INDOOR,)
    """One metric head each. None at all: the model gives relative depth only (MiDaS)."""
    size: tuple[int, int] = (384, 512)
    """(height, width) the model is trained at; photos are resized near it."""
    antialias: bool = False
    """Photos are resized with a filter that does not alias. False in the released models."""
    resize: Literal["keep-aspect", "squeeze"] = "keep-aspect"
    """keep-aspect: photos keep their proportions, up to rounding. squeeze: they become exactly ``size`` (the released
    code's "eval" and "train" modes; Swin encoders can do no other)."""
    pad: bool = True
    """Borders of photos are reflected outwards before the network, and cut off after, unless the caller says otherwise
    (released ``infer``). The photo then fills less of the input, which is right for a model trained or used to it."""

    def __post_init__(self) -> None:
        names = [domain.name for domain in self.domains]
        require(len(set(names)) == len(names), "domains", "domains of different names", names)
        require(all(0 < side <= MAX_SIDE and side % self.multiple == 0 for side in self.size), "size",
                f"(height, width), multiples of {self.multiple} up to {MAX_SIDE}", self.size)  # fmt: skip

    @property
    def multiple(self) -> int:
        """Sides of the network input are multiples of this: the stride of the coarsest map."""
        return 32

    @property
    def one_size(self) -> bool:
        """Whether the network takes inputs of ``size`` only."""
        return False

    @property
    def keep_aspect_ratio(self) -> bool:
        """Whether photos keep their proportions."""
        return self.resize == "keep-aspect" and not self.one_size

    @property
    @abstractmethod
    def encoder_name(self) -> str:
        """timm's name of the encoder."""


@dataclass(frozen=True)
class ModelConfig(_PhotoConfig):
    """A whole ZoeDepth model (paper Fig. 2)."""

    encoder: EncoderConfig
    decoder: DecoderConfig = field(default_factory=DecoderConfig)
    head: HeadConfig = field(default_factory=AttractorConfig)
    """Every domain has its own head of this kind."""
    router: RouterConfig = field(default_factory=RouterConfig)
    """Ignored with a single domain."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.encoder.family == "swin":
            require(self.size == self.encoder.size, "size",
                    f"{self.encoder.size}, the only one {self.encoder.name} takes", self.size)  # fmt: skip
        if self.router.kind == "auto" and len(self.domains) > 1:
            require(not isinstance(self.head, DornConfig), "router.kind",
                    "'labeled' or 'trained' with DORN's head, whose loss no mixture of depths has", "auto")  # fmt: skip

    @property
    def one_size(self) -> bool:
        """Swin's position tables and windows allow one size only."""
        return self.encoder.family == "swin"

    @property
    def encoder_name(self) -> str:
        """timm's name of the encoder."""
        return self.encoder.name


@dataclass(frozen=True)
class BaselineConfig(_PhotoConfig):
    """A system the paper compares with, as its authors built it: no DPT decoder, no relative depth, no router."""

    network: NetworkConfig
    size: tuple[int, int] = field(default=(480, 640), kw_only=True)
    """(height, width) the model is trained at; photos are resized near it."""
    pad: bool = field(default=False, kw_only=True)
    """Borders of photos are reflected outwards before the network, and cut off after. None of the baselines does it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.domains) == 1, "domains", "one: a baseline has one head", self.domains)

    @property
    def multiple(self) -> int:
        """DORN's sides are 8 n + 1."""
        return 1 if self.one_size else 32

    @property
    def one_size(self) -> bool:
        """DORN has a layer of fixed size over the whole photo."""
        return isinstance(self.network, DornNetworkConfig)

    @property
    def encoder_name(self) -> str:
        """timm's name of the encoder."""
        return self.network.encoder


AnyModelConfig = ModelConfig | BaselineConfig
"""The config of any model in this package."""
