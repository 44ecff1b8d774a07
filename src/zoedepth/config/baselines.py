"""The configuration of the systems the paper compares with, each as its authors built it.

The networks are in ``baselines/``. This file does not import torch.
"""

from dataclasses import dataclass
from typing import Literal

from zoedepth.config.checks import require, require_crf_widths, require_intervals


@dataclass(frozen=True)
class BtsNetworkConfig:
    """BTS (Lee et al. 2019): dense ASPP and local planar guidance."""

    encoder: str = "densenet161"
    """timm architecture that gives maps at strides 2, 4, 8, 16, 32."""
    width: int = 512
    """Channels of the decoder at stride 16."""
    focal_px: float = 715.0873
    """Focal length of the camera. Depth is multiplied by its ratio to 715.0873, KITTI's, as BTS does for KITTI."""

    def __post_init__(self) -> None:
        require(self.width >= 128 and self.width % 32 == 0, "network.width", "a multiple of 32, 128 or more",
                self.width)  # fmt: skip
        require(self.focal_px > 0, "network.focal_px", "more than 0 pixels", self.focal_px)


@dataclass(frozen=True)
class AdaBinsNetworkConfig:
    """AdaBins (Bhat et al. 2021): U-Net, then bins of the whole image by a small vision transformer."""

    encoder: str = "tf_efficientnet_b5"
    """timm architecture: an EfficientNet."""
    n_bins: int = 256
    """Number of bins of an image."""


@dataclass(frozen=True)
class LocalBinsNetworkConfig:
    """LocalBins (Bhat et al. 2022): U-Net, bins split at every level of its decoder."""

    encoder: str = "tf_efficientnet_b5"
    """timm architecture: an EfficientNet."""
    n_seed_bins: int = 8
    """Number of bins at the bottleneck; there are 16 times as many at the end. 8: the code's default. 16: the paper's
    256 bins."""
    n_windows: int = 200
    """Number of random windows of each of five sizes in training, for the loss of local histograms; 0: none."""
    front_padding: bool = True
    """True: the edges of bins begin at the nearest depth. False: one width later, as in the public code."""

    def __post_init__(self) -> None:
        require(self.n_seed_bins >= 2, "network.n_seed_bins", "at least 2", self.n_seed_bins)
        require(self.n_windows >= 0, "network.n_windows", "at least 0", self.n_windows)


@dataclass(frozen=True)
class PixelBinsNetworkConfig:
    """PixelBins (Sarwari et al. 2021): AdaBins without the transformer, bins at every pixel."""

    encoder: str = "tf_efficientnet_b5"
    """timm architecture: an EfficientNet."""
    n_bins: int = 128
    """Number of bins at every pixel."""
    exact: bool = True
    """True: as published, ReLU + 1e-6 and edges that begin one width late. False: see ``PixelBinsConfig``."""


@dataclass(frozen=True)
class NewCrfsNetworkConfig:
    """NeWCRFs (Yuan et al. 2022): Swin, pyramid pooling, four levels of window attention."""

    encoder: str = "swin_large_patch4_window7_224"
    """timm architecture that gives maps at strides 4, 8, 16, 32."""
    widths: tuple[int, int, int, int] = (1024, 512, 256, 128)
    """Channels of queries and keys at strides 32, 16, 8, 4."""
    attention_heads: tuple[int, int, int, int] = (32, 16, 8, 4)
    """Attention heads at strides 32, 16, 8, 4."""
    seed_width: int = 512
    """Channels of the first value at stride 32, which pyramid pooling makes of the coarsest map."""

    def __post_init__(self) -> None:
        require_crf_widths(self.widths, self.attention_heads, self.seed_width, "network")


@dataclass(frozen=True)
class DornNetworkConfig:
    """DORN (Fu et al. 2018): dilated ResNet, scene module, ordinal regression. It takes photos of one size only."""

    encoder: str = "resnet101s"
    """timm architecture that can be built with an output stride of 8. "resnet101s" begins as DORN does, with three
    convolutions of 64, 64 and 128 channels."""
    n_intervals: int = 68
    """Number of intervals of depth. 68: NYU. 71: KITTI."""
    rates: tuple[int, int, int] = (4, 8, 12)
    """Dilations of the scene module. 4, 8, 12: NYU. 6, 12, 18: KITTI."""
    pooling: int = 8
    """Side of the averages that the full-image branch begins with. 8: NYU. 16: KITTI."""
    decode: Literal["hard", "soft"] = "hard"
    """See ``DornConfig.decode``."""

    def __post_init__(self) -> None:
        require_intervals(self.n_intervals, "network")
        require(min(self.rates) >= 1, "network.rates", "three dilations of at least 1", self.rates)
        require(self.pooling >= 1, "network.pooling", "at least 1", self.pooling)


NetworkConfig = (
    BtsNetworkConfig
    | AdaBinsNetworkConfig
    | LocalBinsNetworkConfig
    | PixelBinsNetworkConfig
    | NewCrfsNetworkConfig
    | DornNetworkConfig
)
"""The config of any baseline's network."""

NETWORK_CONFIGS: dict[str, type[NetworkConfig]] = {
    "bts": BtsNetworkConfig,
    "adabins": AdaBinsNetworkConfig,
    "localbins": LocalBinsNetworkConfig,
    "pixelbins": PixelBinsNetworkConfig,
    "newcrfs": NewCrfsNetworkConfig,
    "dorn": DornNetworkConfig,
}
"""Name of a baseline, in files → its config."""
