"""NeWCRFs as its authors built it (Yuan et al. 2022; NeWCRFs ``NewCRFDepth.py``, ``swin_transformer.py``)."""

from typing import Any

from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.baselines.baseline import Baseline
from zoedepth.config import BaselineConfig, NewCrfsNetworkConfig
from zoedepth.model.heads.newcrfs import (
    NATIVE_BLOCKS,
    NATIVE_WINDOW,
    Crfs,
    PyramidPooling,
    SigmoidDepth,
    pad_to_windows,
)
from zoedepth.model.heads.output import HeadOutput
from zoedepth.model.timm_encoder import FeatureEncoder, specialised

_SWIN = {"strict_img_size": False, "always_partition": True, "drop_path_rate": 0.3}
"""Options that make timm's Swin the original's: it takes any size, shifts windows even where one holds the whole map,
and in training skips blocks at random, the last with a probability of 0.3."""


class NewCrfs(Baseline):
    """Swin, pyramid pooling, four levels of window attention."""

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__(config)
        network = config.network
        assert isinstance(network, NewCrfsNetworkConfig)
        self.encoder = PyramidEncoder(network.encoder)
        channels = tuple(reversed(self.encoder.channels))
        self.decoder = Crfs(
            channels,
            seed=PyramidPooling(channels[0], network.seed_width),
            seed_width=network.seed_width,
            widths=network.widths,
            attention_heads=network.attention_heads,
            window=NATIVE_WINDOW,
            n_blocks=NATIVE_BLOCKS,
        )
        self.depth = SigmoidDepth(network.widths[3], self.domain)

    def predict(self, x: Float[Tensor, "batch 3 height width"]) -> HeadOutput:
        """Predict the depth of normalised pixels, at their resolution."""
        return self.depth(self.decoder(tuple(reversed(self.encoder(x)))))


class PyramidEncoder(FeatureEncoder):
    """Maps at strides 4, 8, 16, 32. A Swin's maps are normalised here, since timm's Swin does not do it."""

    def __init__(self, name: str) -> None:
        from timm.models import is_model_in_modules

        is_swin = is_model_in_modules(name, ("swin_transformer",))
        super().__init__(name, levels=(-4, -3, -2, -1), options=_SWIN if is_swin else None)
        if is_swin:
            pad_before_shift(self.stages)
        self.norms = nn.ModuleList(nn.LayerNorm(width) if is_swin else nn.Identity() for width in self.channels)

    def forward(self, x: Float[Tensor, "batch 3 height width"]) -> list[Float[Tensor, "batch _ _ _"]]:
        """Return four maps of normalised pixels, fine to coarse."""
        maps = super().forward(x)
        return [
            norm(level.permute(0, 2, 3, 1)).permute(0, 3, 1, 2) for norm, level in zip(self.norms, maps, strict=True)
        ]


class _PadFirst(nn.Module):
    """The attention of timm's Swin block, which pads before it shifts."""

    window_size: tuple[int, int]

    def _attn(self, x: Float[Tensor, "batch rows columns channels"]) -> Tensor:
        rows, columns = x.shape[1:3]
        block: Any = super()
        return block._attn(pad_to_windows(x, self.window_size[0]))[:, :rows, :columns]


def pad_before_shift(network: nn.Module) -> None:
    """Make timm's Swin blocks pad to whole windows before they shift, as NeWCRFs' blocks do, instead of after.

    timm shifts first. Where a map is not made of whole windows, the pixels that are wrapped around then land before the
    padding, outside the mask, and opposite borders of the photo look at each other.
    """
    from timm.models.swin_transformer import SwinTransformerBlock

    for block in network.modules():
        if isinstance(block, SwinTransformerBlock):
            block.__class__ = specialised(_PadFirst, SwinTransformerBlock)
