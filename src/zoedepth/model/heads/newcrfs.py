"""NeWCRFs: fully-connected conditional random fields inside windows, as attention (Yuan et al. 2022).

At every level, features say how much each pixel agrees with each other pixel of its window. These weights average the
values, which are what the coarser level says of the pixels. The result, with pixels shuffled out of its channels, is
the value of the next level. (NeWCRFs ``newcrf_layers.py``, ``uper_crf_head.py``, ``NewCRFDepth.py``.)
"""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from zoedepth.config import Domain, NewCrfsConfig
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads.output import HeadOutput

NATIVE_WINDOW, NATIVE_BLOCKS = 7, 2
"""NeWCRFs' own side of the windows, and number of blocks in a level."""


def pad_to_windows(x: Float[Tensor, "batch rows columns channels"], window: int) -> Float[Tensor, "batch _ _ channels"]:
    """Pad with zeros at the right and at the bottom, up to whole windows. Attention looks at them like at any token."""
    return F.pad(x, (0, 0, 0, -x.shape[2] % window, 0, -x.shape[1] % window))


def to_windows(
    x: Float[Tensor, "batch rows columns channels"], window: int
) -> Float[Tensor, "batch windows tokens channels"]:
    """Cut a map into whole windows. The windows, and the tokens in them, are in order row by row."""
    batch, rows, columns, channels = x.shape
    x = x.reshape(batch, rows // window, window, columns // window, window, channels)
    return x.transpose(2, 3).reshape(batch, -1, window * window, channels)


def from_windows(
    x: Float[Tensor, "batch windows tokens channels"], size: tuple[int, int], window: int
) -> Float[Tensor, "batch rows columns channels"]:
    """Join the windows of ``to_windows`` to a map of (rows, columns)."""
    (rows, columns), (batch, _, _, channels) = size, x.shape
    x = x.reshape(batch, rows // window, columns // window, window, window, channels)
    return x.transpose(2, 3).reshape(batch, rows, columns, channels)


def same_side_of_the_wrap(
    size: tuple[int, int], window: int, shift: int, device: torch.device | None = None
) -> Bool[Tensor, "windows 1 tokens tokens"]:
    """Mark the pairs of tokens of a window that were on one side of the map before it was rolled by ``-shift``.

    The last ``shift`` rows and columns of the rolled map came from its other end.

    Returns:
        True where both tokens of a pair come from the same side.
    """
    rows, columns = (torch.arange(side, device=device) >= side - shift for side in size)
    region = to_windows((2 * rows[:, None] + columns)[None, :, :, None], window)[0]
    return (region == region.transpose(1, 2))[:, None]


def relative_positions(window: int, device: torch.device | None = None) -> Int[Tensor, "tokens tokens"]:
    """Return the row of the bias table for each pair of tokens of a window, which depends on their offset."""
    place = torch.arange(window, device=device)
    offset = place[:, None] - place + window - 1
    rows, columns = offset[:, None, :, None], offset[None, :, None, :]
    return (rows * (2 * window - 1) + columns).flatten(2).flatten(0, 1)


def window_attention(
    q: Float[Tensor, "batch windows heads tokens channels"],
    k: Float[Tensor, "batch windows heads tokens channels"],
    v: Float[Tensor, "batch windows heads tokens channels"],
    bias: Float[Tensor, "heads tokens tokens"],
    allowed: Bool[Tensor, "windows 1 tokens tokens"] | None,
) -> Float[Tensor, "batch windows heads tokens channels"]:
    """Compute softmax_j(q_i k_j / sqrt(channels) + bias_ij) v_j, over the tokens j that i may look at.

    The softmax is computed in float32.
    """
    logits = (q * q.shape[-1] ** -0.5 @ k.transpose(-2, -1)).float() + bias
    if allowed is not None:
        logits = logits.masked_fill(~allowed, -torch.inf)
    return logits.softmax(dim=-1).to(v.dtype) @ v


class WindowAttention(nn.Module):
    """Attention inside windows: queries and keys of the features, given values, a bias for each relative position."""

    def __init__(self, width: int, *, n_heads: int, window: int) -> None:
        super().__init__()
        self.n_heads = n_heads
        self.window = window
        self.queries_keys = nn.Linear(width, 2 * width)
        self.bias_table = nn.Parameter(nn.init.trunc_normal_(torch.empty((2 * window - 1) ** 2, n_heads), std=0.02))
        self.project = nn.Linear(width, width)

    def forward(
        self,
        x: Float[Tensor, "batch windows tokens width"],
        v: Float[Tensor, "batch windows tokens width"],
        allowed: Bool[Tensor, "windows 1 tokens tokens"] | None,
    ) -> Float[Tensor, "batch windows tokens width"]:
        """Gather, for each token, values from its window."""
        q, k = self.queries_keys(x).chunk(2, dim=-1)
        q, k, v = (part.unflatten(-1, (self.n_heads, -1)).transpose(2, 3) for part in (q, k, v))
        bias = self.bias_table[relative_positions(self.window, x.device)].permute(2, 0, 1)
        return self.project(window_attention(q, k, v, bias, allowed).transpose(2, 3).flatten(3))


class CrfBlock(nn.Module):
    """One round of messages: window attention, then an MLP at every pixel, both added to the features."""

    def __init__(self, width: int, *, n_heads: int, window: int, shift: int) -> None:
        super().__init__()
        self.window = window
        self.shift = shift
        self.norm1 = nn.LayerNorm(width)
        self.attention = WindowAttention(width, n_heads=n_heads, window=window)
        self.norm2 = nn.LayerNorm(width)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(
        self, x: Float[Tensor, "batch rows columns width"], v: Float[Tensor, "batch rows columns width"]
    ) -> Float[Tensor, "batch rows columns width"]:
        """Return new features; the values stay those of the coarser level."""
        x = x + self._gather(self.norm1(x), v)
        return x + self.mlp(self.norm2(x))

    def _gather(self, x: Tensor, v: Tensor) -> Tensor:
        rows, columns = x.shape[1:3]
        x, v = (pad_to_windows(y, self.window) for y in (x, v))
        size, allowed = (x.shape[1], x.shape[2]), None
        if self.shift:
            x, v = (y.roll((-self.shift, -self.shift), dims=(1, 2)) for y in (x, v))
            allowed = same_side_of_the_wrap(size, self.window, self.shift, x.device)
        x = self.attention(to_windows(x, self.window), to_windows(v, self.window), allowed)
        x = from_windows(x, size, self.window)
        if self.shift:
            x = x.roll((self.shift, self.shift), dims=(1, 2))
        return x[:, :rows, :columns]


class CrfLevel(nn.Module):
    """All rounds of one level. Convolutions bring features and values to its width where they have another."""

    def __init__(
        self, channels: int, value_channels: int, width: int, *, n_heads: int, window: int, n_blocks: int
    ) -> None:
        super().__init__()
        self.features = _to_width(channels, width)
        self.values = _to_width(value_channels, width)
        self.blocks = nn.ModuleList(
            CrfBlock(width, n_heads=n_heads, window=window, shift=i % 2 * (window // 2)) for i in range(n_blocks)
        )
        self.norm = nn.LayerNorm(width)

    def forward(
        self, x: Float[Tensor, "batch channels rows columns"], v: Float[Tensor, "batch value_channels rows columns"]
    ) -> Float[Tensor, "batch width rows columns"]:
        """Compute the level's result from its features and the values of the level before it."""
        x, v = self.features(x).permute(0, 2, 3, 1), self.values(v).permute(0, 2, 3, 1)
        for block in self.blocks:
            x = block(x, v)
        return self.norm(x).permute(0, 3, 1, 2)


def _to_width(channels: int, width: int) -> nn.Module:
    return nn.Identity() if channels == width else nn.Conv2d(channels, width, kernel_size=3, padding=1)


class PyramidPooling(nn.Module):
    """Makes the first value, with the whole image in view: averages over 1, 2x2, 3x3 and 6x6 regions and the features.

    All four branches are normalised in groups of two channels. The original means to do so only for the single region,
    where batch normalisation is impossible, but its code does it for the following ones too.
    """

    def __init__(self, channels: int, width: int) -> None:
        super().__init__()
        self.regions = nn.ModuleList(
            nn.Sequential(
                nn.AdaptiveAvgPool2d(side),
                nn.Conv2d(channels, width, kernel_size=1, bias=False),
                nn.GroupNorm(width // 2, width),
                nn.ReLU(),
            )
            for side in (1, 2, 3, 6)
        )
        self.join = nn.Sequential(
            nn.Conv2d(channels + 4 * width, width, kernel_size=3, padding=1, bias=False),
            nn.BatchNorm2d(width),
            nn.ReLU(),
        )

    def forward(self, x: Float[Tensor, "batch channels rows columns"]) -> Float[Tensor, "batch width rows columns"]:
        """Compute the value; its size is that of the input."""
        pooled = [F.interpolate(region(x), size=x.shape[-2:], mode="bilinear") for region in self.regions]
        return self.join(torch.cat([x, *pooled], dim=1))


class Crfs(nn.Module):
    """Four levels, coarse to fine.

    Args:
        channels: channels of the features at strides 32, 16, 8, 4.
        seed: module that makes the first value from the coarsest features.
        seed_width: channels of the first value.
        widths, attention_heads: channels and attention heads of the levels.
        window: side of the windows.
        n_blocks: number of blocks of each level; every second one is shifted by half a window.
    """

    def __init__(
        self,
        channels: tuple[int, ...],
        *,
        seed: nn.Module,
        seed_width: int,
        widths: tuple[int, ...],
        attention_heads: tuple[int, ...],
        window: int,
        n_blocks: int,
    ) -> None:
        super().__init__()
        value_channels = (seed_width, *(width // 4 for width in widths[:-1]))
        self.seed = seed
        self.levels = nn.ModuleList(
            CrfLevel(*sizes, n_heads=n_heads, window=window, n_blocks=n_blocks)
            for *sizes, n_heads in zip(channels, value_channels, widths, attention_heads, strict=True)
        )

    def forward(self, maps: tuple[Float[Tensor, "batch _ _ _"], ...]) -> Float[Tensor, "batch _ rows columns"]:
        """Compute the finest level's result from the features of all levels, coarse to fine, each twice as large."""
        x = self.levels[0](maps[0], self.seed(maps[0]))
        for level, features in zip(self.levels[1:], maps[1:], strict=True):
            x = level(features, F.pixel_shuffle(x, 2))
        return x


class SigmoidDepth(nn.Module):
    """Predicts depth between 0 and the farthest of its domain, at four times the size of its input."""

    def __init__(self, channels: int, domain: Domain) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, 1, kernel_size=3, padding=1)
        self.max_depth = domain.max_depth

    def forward(self, x: Float[Tensor, "batch channels rows columns"]) -> HeadOutput:
        """Predict depth in metres."""
        share = self.conv(x).float().sigmoid()
        # Unlike everywhere else in this package, corners are not aligned: the original's weights expect it.
        return HeadOutput(self.max_depth * F.interpolate(share, scale_factor=4, mode="bilinear"))


class NewCrfsHead(nn.Module):
    """Metric depth of one domain: NeWCRFs' levels on the decoder's levels (the paper's modification, its Table 2).

    The decoder's level at stride 2 stays unused: NeWCRFs ends at stride 4 too.
    """

    def __init__(self, channels: DecoderChannels, config: NewCrfsConfig, domain: Domain) -> None:
        super().__init__()
        seed = (
            PyramidPooling(channels.bottleneck, config.seed_width)
            if config.pyramid_pooling
            else nn.Conv2d(channels.bottleneck, config.seed_width, kernel_size=1)
        )
        self.crfs = Crfs(
            (channels.bottleneck, *channels.levels[:3]),
            seed=seed,
            seed_width=config.seed_width,
            widths=config.widths,
            attention_heads=config.attention_heads,
            window=config.window,
            n_blocks=config.n_blocks,
        )
        self.depth = SigmoidDepth(config.widths[3], domain)

    def forward(self, features: DecoderFeatures) -> HeadOutput:
        """Predict depth in metres at the size of the photo."""
        return self.depth(self.crfs((features.bottleneck, *features.levels[:3])))
