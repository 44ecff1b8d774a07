"""The configuration of each metric head.

Each difference to the released code and to the paper's other methods is a value here. The heads are in
``model/heads/``. This file does not import torch.
"""

from dataclasses import dataclass
from typing import Literal

from zoedepth.config.checks import require, require_crf_widths, require_intervals


@dataclass(frozen=True)
class AttractorConfig:
    """The metric bins module (paper section 3.2): seed bin centers, attractor layers, probabilities."""

    n_bins: int = 64
    """Number of bin centers at every pixel (N_total)."""
    n_attractors: tuple[int, int, int, int] = (16, 8, 4, 1)
    """Number of attractor points at strides 16, 8, 4, 2."""
    kind: Literal["inverse", "exponential"] = "inverse"
    """The attractor's equation: Eq. 2 or Eq. 3."""
    reduce: Literal["sum", "mean"] = "mean"
    """mean: the pulls of the attractors are averaged, as released, so that no center goes past all of them. sum: they
    are added up, as Eqs. 2 and 3 are printed: with several attractors near, centers jump over them and lose their
    order."""
    alpha: float = 300.0
    """Strength of the attractors: a center is out of reach beyond about alpha ** (-1 / gamma)."""
    gamma: float = 2.0
    """Exponent of the distance in Eqs. 2 and 3."""
    centers: Literal["softplus", "normed"] = "softplus"
    """softplus: metres, positive, unbounded. normed: fractions of the depth range of the domain."""
    attractor_ratio: bool = True
    """normed only. True: an attractor is a0 / (a0 + a1) of a pair, as intended. False: a0 alone, as in the released
    code."""
    relative_input: bool = True
    """True: the probabilities see the relative depth beside the decoder features (paper)."""
    probability: Literal["log-binomial", "softmax"] = "log-binomial"
    """Probabilities of the bins: Eq. 4, or a softmax over free logits (ablation)."""
    bottleneck_factor: int = 2
    """The hidden width of the probability predictor is its input width divided by this."""
    min_temperature: float = 0.0212
    """Lower bound of the temperature t of the log-binomial."""
    max_temperature: float = 50.0
    """Upper bound of the temperature t of the log-binomial."""
    embedding_width: int = 128
    """Channels of the bin embedding that goes from level to level."""
    projector_width: int = 128
    """Hidden channels of the projectors from decoder features to bin embedding."""
    seed_width: int = 256
    """Hidden channels of the seed bin regressor."""
    initial_centers: Literal["random", "geometric"] = "random"
    """random: as released, all near 0.7 m. geometric (softplus only): the centers of a new head are spread
    geometrically over its depth range, which matters when training is short."""

    def __post_init__(self) -> None:
        require(self.n_bins >= 2, "head.n_bins", "at least 2", self.n_bins)
        require(len(self.n_attractors) == 4, "head.n_attractors", "four numbers, coarse to fine", self.n_attractors)
        require(min(self.n_attractors) >= 1, "head.n_attractors", "numbers of at least 1", self.n_attractors)
        require(0 <= self.min_temperature < self.max_temperature, "head.min_temperature",
                f"at least 0 and less than max_temperature, {self.max_temperature}", self.min_temperature)  # fmt: skip
        require(self.centers == "softplus" or self.initial_centers == "random", "head.initial_centers",
                "'random' where head.centers is 'normed'", self.initial_centers)  # fmt: skip


@dataclass(frozen=True)
class SplitterConfig:
    """LocalBins: seed bins at the bottleneck, each split into smaller ones at every level (Bhat et al. 2022)."""

    n_seed_bins: int = 4
    """Number of bins at the bottleneck; there are ``factor ** 4`` times as many at stride 2. 4: ZoeDepth's 64 bins.
    16: the native 256."""
    factor: int = 2
    """Number of bins that each bin is split into at a level (paper Table 5: 2)."""
    embedding_width: int = 128
    """Channels of the bin embeddings."""
    hidden_width: int = 128
    """Hidden channels of the projectors and splitters."""
    seed_width: int = 256
    """Hidden channels of the seed bin regressor."""
    relative_input: bool = True
    """True: the probabilities see the relative depth beside the decoder features."""
    probability: Literal["log-binomial", "softmax"] = "softmax"
    """Probabilities of the bins: LocalBins' softmax, or ZoeDepth's log-binomial (paper Table 5)."""
    bottleneck_factor: int = 2
    """The hidden width of the probability predictor is its input width divided by this."""
    min_temperature: float = 0.0212
    """Log-binomial only: lower bound of its temperature."""
    max_temperature: float = 50.0
    """Log-binomial only: upper bound of its temperature."""
    n_windows: int = 0
    """Number of random windows of each of five sizes in training, whose bins are predicted too, for LocalBins' loss of
    local histograms. 0: none (the paper's choice, for memory). 200: native."""

    def __post_init__(self) -> None:
        require(self.n_seed_bins >= 2, "head.n_seed_bins", "at least 2", self.n_seed_bins)
        require(self.factor >= 2, "head.factor", "at least 2", self.factor)
        require(self.n_windows >= 0, "head.n_windows", "at least 0", self.n_windows)


@dataclass(frozen=True)
class PixelBinsConfig:
    """PixelBins: bin widths and probabilities at every pixel, from one map (Sarwari et al. 2021)."""

    n_bins: int = 64
    """Number of bins at every pixel. Native: 128."""
    width: int = 128
    """Channels of the map from which both are predicted."""
    exact: bool = False
    """True: as published, ReLU + 1e-6 and edges that begin one width late; its widths can die, with gradients of 0 for
    ever. False: softplus + 1e-3 and edges from the nearest to the farthest depth."""

    def __post_init__(self) -> None:
        require(self.n_bins >= 2, "head.n_bins", "at least 2", self.n_bins)


@dataclass(frozen=True)
class DornConfig:
    """DORN: ordinal regression over intervals of depth (Fu et al. 2018)."""

    n_intervals: int = 80
    """Number of intervals between the nearest and the farthest depth (K)."""
    spacing: Literal["increasing", "uniform"] = "increasing"
    """increasing: widths grow in proportion to depth (SID). uniform: all widths are equal (UD)."""
    decode: Literal["hard", "soft"] = "hard"
    """hard: the middle of the interval up to which the probabilities are at least 0.5 (DORN). soft: the expectation."""
    width: int = 128
    """Hidden channels; with ``scene``, the channels of each branch of the scene module, where DORN has 512."""
    scene: bool = False
    """True: predict from the bottleneck, through DORN's five-branch scene module. False: from the finest level."""

    def __post_init__(self) -> None:
        require_intervals(self.n_intervals, "head")


@dataclass(frozen=True)
class NewCrfsConfig:
    """NeWCRFs: four levels of window attention as conditional random fields (Yuan et al. 2022)."""

    widths: tuple[int, int, int, int] = (1024, 512, 256, 128)
    """Channels of queries and keys at strides 32, 16, 8, 4."""
    attention_heads: tuple[int, int, int, int] = (32, 16, 8, 4)
    """Attention heads at strides 32, 16, 8, 4."""
    window: int = 7
    """Side of the windows of attention, tokens."""
    n_blocks: int = 2
    """Number of attention blocks at each level; every second one is shifted by half a window."""
    seed_width: int = 512
    """Channels of the first value at stride 32."""
    pyramid_pooling: bool = False
    """True: pyramid pooling makes the first value of the bottleneck (native). False: one convolution does."""

    def __post_init__(self) -> None:
        require_crf_widths(self.widths, self.attention_heads, self.seed_width, "head")
        require(self.window >= 2, "head.window", "at least 2", self.window)
        require(self.n_blocks >= 1, "head.n_blocks", "at least 1", self.n_blocks)


@dataclass(frozen=True)
class NaiveConfig:
    """Depth straight from the decoder features by two convolutions (paper Table 5, "naive head")."""

    width: int = 32
    """Hidden channels."""
    relative_input: bool = True
    """True: the head sees the relative depth beside the decoder features."""
    initial_depth: float = 2.0
    """Metres: the depth that a new head predicts, so that the first steps do not explode."""

    def __post_init__(self) -> None:
        require(self.initial_depth > 0, "head.initial_depth", "more than 0 metres", self.initial_depth)


@dataclass(frozen=True)
class AdaBinsConfig:
    """AdaBins: bins of the whole image by a small vision transformer (Bhat et al. 2021). Not in the paper's Table 2."""

    n_bins: int = 64
    """Number of bins of an image. Native: 256."""
    width: int = 128
    """Channels of tokens, queries and features."""
    patch: int = 16
    """Side of a patch, pixels of the finest level. At most 16, the side of that level for the smallest photo."""
    n_layers: int = 4
    """Number of transformer layers."""
    attention_heads: int = 4
    """Number of attention heads of each layer."""
    feedforward_width: int = 1024
    """Hidden channels of each layer's MLP."""
    n_queries: int = 128
    """Number of tokens, after the first, that are used as 1x1 kernels."""

    def __post_init__(self) -> None:
        require(self.n_bins >= 2, "head.n_bins", "at least 2", self.n_bins)
        require(1 <= self.patch <= 16, "head.patch", "1 to 16", self.patch)
        require(self.width % self.attention_heads == 0, "head.attention_heads", f"a divisor of the width {self.width}",
                self.attention_heads)  # fmt: skip


@dataclass(frozen=True)
class BtsConfig:
    """BTS: local planar guidance at three levels (Lee et al. 2019). Not in the paper's Table 2."""

    widths: tuple[int, int, int] = (128, 64, 32)
    """Channels before the planes of strides 8, 4, 2."""
    width: int = 32
    """Hidden channels of the last convolution."""

    def __post_init__(self) -> None:
        require(min(self.widths) >= 8, "head.widths", "numbers of at least 8", self.widths)


HeadConfig = (
    AttractorConfig
    | SplitterConfig
    | PixelBinsConfig
    | DornConfig
    | NewCrfsConfig
    | NaiveConfig
    | AdaBinsConfig
    | BtsConfig
)
"""The config of any metric head."""

HEAD_CONFIGS: dict[str, type[HeadConfig]] = {
    "attractor": AttractorConfig,
    "splitter": SplitterConfig,
    "pixelbins": PixelBinsConfig,
    "dorn": DornConfig,
    "newcrfs": NewCrfsConfig,
    "naive": NaiveConfig,
    "adabins": AdaBinsConfig,
    "bts": BtsConfig,
}
"""Name of a head, in files and on the command line → its config."""
