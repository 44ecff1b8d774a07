"""The configuration of a model: frozen dataclasses, written into every checkpoint as JSON.

Only ``ZoeDepth.__init__`` reads a ``ModelConfig``; the modules below it take plain keywords. Nothing here imports
torch, so the command line can show and change configurations without waiting for it.
"""

import dataclasses
import types
import typing
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar, Union

from zoedepth.baseline_config import (
    NETWORK_CONFIGS,
    AdaBinsNetwork,
    BtsNetwork,
    DornNetwork,
    LocalBinsNetwork,
    NetworkConfig,
    NewCrfsNetwork,
    PixelBinsNetwork,
)
from zoedepth.errors import InputError
from zoedepth.head_config import (
    HEAD_CONFIGS,
    AdaBinsConfig,
    AttractorConfig,
    BtsConfig,
    DornConfig,
    HeadConfig,
    NaiveConfig,
    NewCrfsConfig,
    PixelBinsConfig,
    SplitterConfig,
    require,
)

__all__ = [
    "INDOOR",
    "OUTDOOR",
    "AdaBinsConfig",
    "AdaBinsNetwork",
    "AnyModelConfig",
    "AttractorConfig",
    "BaselineConfig",
    "BtsConfig",
    "BtsNetwork",
    "DecoderConfig",
    "Domain",
    "DornConfig",
    "DornNetwork",
    "EncoderConfig",
    "HeadConfig",
    "LocalBinsNetwork",
    "ModelConfig",
    "NaiveConfig",
    "NetworkConfig",
    "NewCrfsConfig",
    "NewCrfsNetwork",
    "PixelBinsConfig",
    "PixelBinsNetwork",
    "RouterConfig",
    "SplitterConfig",
    "from_dict",
    "model_config_from_dict",
    "to_dict",
]


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
        return isinstance(self.network, DornNetwork)

    @property
    def encoder_name(self) -> str:
        """timm's name of the encoder."""
        return self.network.encoder


AnyModelConfig = ModelConfig | BaselineConfig
"""The config of any model in this package."""

_TYPES: dict[str, type] = {"zoedepth": ModelConfig, "baseline": BaselineConfig}
_NAMES = {kind: name for table in (_TYPES, HEAD_CONFIGS, NETWORK_CONFIGS) for name, kind in table.items()}
"""Config class → the ``type`` it has in files, where several could stand."""
_TYPE = "type"


def to_dict(config: Any) -> dict[str, Any]:
    """A config dataclass as plain dicts, lists and values, ready for JSON; ``type`` says which of several it is."""
    tag = {_TYPE: _NAMES[type(config)]} if type(config) in _NAMES else {}
    return tag | {item.name: _plain(getattr(config, item.name)) for item in dataclasses.fields(config)}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return to_dict(value)
    return tuple(map(_plain, value)) if isinstance(value, tuple) else value


ConfigType = TypeVar("ConfigType")


def from_dict(config_type: type[ConfigType], values: dict[str, Any], *, where: str = "config") -> ConfigType:
    """The inverse of ``to_dict``. Where ``type`` is missing, it is the oldest: ZoeDepth, with attractors.

    Raises:
        InputError: a field is unknown, of the wrong type, or missing without having a default; the message names it.
    """
    return _build(config_type, values, where)


def model_config_from_dict(values: Any, *, where: str = "config") -> AnyModelConfig:
    """The config of any model, from ``to_dict``'s plain values.

    Raises:
        InputError: see ``from_dict``.
    """
    return _build(AnyModelConfig, values, where)


def _build(kind: Any, value: Any, where: str) -> Any:
    """``value``, from JSON, as the annotated type ``kind``."""
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return _build_dataclass(kind, value, where)
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise InputError(f"{where} must be a list, not {value!r}")
        kinds = [arguments[0]] * len(value) if arguments[-1] is Ellipsis else list(arguments)
        if len(kinds) != len(value):
            raise InputError(f"{where} must have {len(kinds)} entries, not {len(value)}")
        return tuple(_build(k, v, f"{where}[{i}]") for i, (k, v) in enumerate(zip(kinds, value, strict=True)))
    if origin is Literal:
        if not any(value == known and type(value) is type(known) for known in arguments):  # True == 1 to Python
            raise InputError(f"{where} must be one of {list(arguments)}, not {value!r}")
        return value
    if origin in (Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        kinds = [k for k in arguments if k is not type(None)]
        return _build(kinds[0] if len(kinds) == 1 else _chosen(kinds, value, where), value, where)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):  # a bool is an int to Python
        raise InputError(f"{where} must be {kind.__name__}, not {value!r}")
    return value


def _chosen(kinds: list[Any], value: Any, where: str) -> Any:
    """Which of several dataclasses a JSON object is of."""
    known = {_NAMES[kind]: kind for kind in kinds}
    if not isinstance(value, dict):
        names = " or ".join(kind.__name__ for kind in kinds)
        raise InputError(f"{where} must be an object with the fields of {names}, not {value!r}")
    name = value.get(_TYPE, next(iter(known)))
    if not isinstance(name, str) or name not in known:
        raise InputError(f"{where}.{_TYPE} must be one of {list(known)}, not {name!r}")
    return known[name]


def _build_dataclass(kind: Any, value: Any, where: str) -> Any:
    if not isinstance(value, dict):
        raise InputError(f"{where} must be an object with the fields of {kind.__name__}, not {value!r}")
    if kind in _NAMES and value.get(_TYPE, _NAMES[kind]) == _NAMES[kind]:
        value = {name: item for name, item in value.items() if name != _TYPE}
    known = {item.name: item for item in dataclasses.fields(kind)}
    if unknown := sorted(set(value) - set(known)):
        raise InputError(f"{where} has unknown fields {unknown}; {kind.__name__} has {sorted(known)}")
    # Others have defaults: a field that a later version adds must default to what was done before.
    required = (f for f in known.values() if f.default is f.default_factory is dataclasses.MISSING)
    if missing := sorted(f.name for f in required if f.name not in value):
        raise InputError(f"{where} lacks the fields {missing}")
    hints = typing.get_type_hints(kind)
    built = {name: _build(hints[name], item, f"{where}.{name}") for name, item in value.items()}
    return kind(**built)
