"""BTS as its authors built it: dense ASPP and local planar guidance (Lee et al. 2019, ``pytorch/bts.py``)."""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.baselines.baseline import Baseline
from zoedepth.config import BaselineConfig, BtsNetworkConfig
from zoedepth.model.heads.bts import PlanarGuidance, convolution, narrowing
from zoedepth.model.heads.output import HeadOutput
from zoedepth.model.timm_encoder import FeatureEncoder, TimmEncoder, create_network

RATES = (3, 6, 12, 18, 24)
"""Dilations of the dense ASPP."""
KITTI_FOCAL_PX = 715.0873
"""Focal length of the camera whose depth is not scaled, pixels (``bts.py``, its last lines)."""


class Bts(Baseline):
    """Predicts depth up to the farthest of the domain, times the ratio of the focal lengths."""

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__(config)
        network = config.network
        assert isinstance(network, BtsNetworkConfig)
        self.encoder = (
            DenseNetEncoder(network.encoder)
            if network.encoder.startswith("densenet")
            else FeatureEncoder(network.encoder, levels=(0, 1, 2, 3, 4))
        )
        self.decoder = BtsDecoder(self.encoder.channels, width=network.width)
        self.scale = self.domain.max_depth * network.focal_px / KITTI_FOCAL_PX

    def predict(self, x: Float[Tensor, "batch 3 height width"]) -> HeadOutput:
        """Predict the depth of normalised pixels whose sides are multiples of 32, at their resolution."""
        return HeadOutput(self.scale * self.decoder(self.encoder(x)))


class DenseNetEncoder(TimmEncoder):
    """The maps that BTS takes from a DenseNet: after its first layer, first pooling, two transitions and last norm.

    timm's own ``features_only`` gives the maps before the transitions, with twice to five times as many channels.
    """

    def __init__(self, name: str) -> None:
        super().__init__()
        self.stages: Any = create_network(name).get_submodule("features")
        part = self.stages.get_submodule
        norms = (part("norm0"), part("norm0"), part("denseblock2.denselayer1.norm1"),
                 part("denseblock3.denselayer1.norm1"), part("norm5"))  # fmt: skip
        self.channels: tuple[int, ...] = tuple(norm.num_features for norm in norms)
        self.strides = (2, 4, 8, 16, 32)

    def load_timm(self, network: nn.Module) -> None:
        """Copy the weights of timm's network of the same shape, without its classifier."""
        self.stages.load_state_dict(network.get_submodule("features").state_dict())

    def checkpoint_gradients(self) -> None:
        """Save memory from now on: the backward pass computes the insides of the layers again."""
        for layer in (module for module in self.stages.modules() if hasattr(module, "grad_checkpointing")):
            layer.grad_checkpointing = True

    def forward(self, x: Float[Tensor, "batch 3 height width"]) -> list[Float[Tensor, "batch _ _ _"]]:
        """Return five maps of normalised pixels, fine to coarse."""
        maps = []
        for name, stage in self.stages.named_children():
            x = stage(x)
            if name in ("norm0", "pool0", "transition1", "transition2", "norm5"):
                maps.append(x)
        return maps


class BtsDecoder(nn.Module):
    """Decodes maps at strides 2, 4, 8, 16, 32 to depth as a fraction of the farthest.

    Args:
        channels: channels of the maps, fine to coarse.
        width: channels at stride 16; half as many at 8, a quarter at 8 after the ASPP and at 4, and so on.
    """

    def __init__(self, channels: tuple[int, ...], *, width: int) -> None:
        super().__init__()
        self.up16 = Up(channels[4], width)
        self.fuse16 = convolution(width + channels[3], width)
        self.up8 = Up(width, width // 2)
        self.fuse8 = nn.Sequential(*convolution(width // 2 + channels[2], width // 2), _norm(width // 2))
        self.context = DenseAspp(width // 2, channels[2], width // 4)
        self.guide8 = PlanarGuidance(width // 4, width // 4, factor=8)
        self.up4 = Up(width // 4, width // 4)
        self.fuse4 = convolution(width // 4 + channels[1] + 1, width // 4)
        self.guide4 = PlanarGuidance(width // 4, width // 8, factor=4)
        self.up2 = Up(width // 4, width // 8)
        self.fuse2 = convolution(width // 8 + channels[0] + 1, width // 8)
        self.guide2 = PlanarGuidance(width // 8, width // 16, factor=2)
        self.up1 = Up(width // 8, width // 16, norm=False)
        self.guess = narrowing(width // 16, width // 32, 1)
        self.fuse1 = convolution(width // 16 + 4, width // 16)
        self.depth = nn.Conv2d(width // 16, 1, 3, padding=1, bias=False)
        for conv in (module for module in self.modules() if isinstance(module, nn.Conv2d)):
            nn.init.xavier_uniform_(conv.weight)

    def forward(self, maps: list[Float[Tensor, "batch _ _ _"]]) -> Float[Tensor, "batch 1 height width"]:
        """Predict depth, float32, at stride 1."""
        x2, x4, x8, x16, x32 = maps
        x = self.fuse16(torch.cat([self.up16(F.relu(x32)), x16], dim=1))
        joined = torch.cat([self.up8(x), x8], dim=1)
        x = self.context(self.fuse8(joined), joined)
        depth8 = self.guide8(x)
        x = self.fuse4(torch.cat([self.up4(x), x4, _every(depth8, 4)], dim=1).to(x.dtype))
        depth4 = self.guide4(x)
        x = self.fuse2(torch.cat([self.up2(x), x2, _every(depth4, 2)], dim=1).to(x.dtype))
        depth2 = self.guide2(x)
        x = self.up1(x)
        depth1 = self.guess(x).float().sigmoid()
        joined = torch.cat([x, depth1, depth2, depth4, depth8], dim=1).to(x.dtype)
        return self.depth(self.fuse1(joined)).float().sigmoid()


class Up(nn.Module):
    """Upsamples to twice the size (nearest); 3x3 convolution, ELU, and batch norm (``bts.py::upconv``)."""

    def __init__(self, channels: int, output_channels: int, *, norm: bool = True) -> None:
        super().__init__()
        self.conv = convolution(channels, output_channels)
        self.norm = _norm(output_channels) if norm else nn.Identity()

    def forward(self, x: Float[Tensor, "batch channels _ _"]) -> Float[Tensor, "batch output_channels _ _"]:
        """Return a map twice as high and wide."""
        return self.norm(self.conv(F.interpolate(x, scale_factor=2.0, mode="nearest")))


class DenseAspp(nn.Module):
    """Dilated convolutions, each of which sees the results of those before it (BTS section 3.2)."""

    def __init__(self, channels: int, skip_channels: int, width: int) -> None:
        super().__init__()
        joined = channels + skip_channels
        # As in the released code, the first branch has no norm of its own: its input is normalised already.
        self.branches = nn.ModuleList(
            _atrous(joined + i * width if i else channels, width, rate, norm_first=i > 0)
            for i, rate in enumerate(RATES)
        )
        self.mix = convolution(channels + len(RATES) * width, width)

    def forward(
        self, x: Float[Tensor, "batch channels rows columns"], joined: Float[Tensor, "batch _ rows columns"]
    ) -> Float[Tensor, "batch width rows columns"]:
        """Compute the context of ``x``. All branches but the first see, in its place, the maps it was fused from."""
        first, *others = self.branches
        found = [first(x)]
        for branch in others:
            found.append(branch(torch.cat([joined, *found], dim=1)))
        return self.mix(torch.cat([x, *found], dim=1))


def _atrous(channels: int, width: int, rate: int, *, norm_first: bool) -> nn.Sequential:
    return nn.Sequential(
        _norm(channels) if norm_first else nn.Identity(),
        nn.ReLU(),
        nn.Conv2d(channels, 2 * width, 1, bias=False),
        nn.BatchNorm2d(2 * width, momentum=0.01),
        nn.ReLU(),
        nn.Conv2d(2 * width, width, 3, padding=rate, dilation=rate, bias=False),
    )


def _norm(channels: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(channels, momentum=0.01, eps=1.1e-5)


def _every(x: Float[Tensor, "batch 1 height width"], step: int) -> Float[Tensor, "batch 1 _ _"]:
    """Take one pixel of every ``step``: ``interpolate`` with the mode "nearest", to a smaller size."""
    return x[:, :, ::step, ::step]
