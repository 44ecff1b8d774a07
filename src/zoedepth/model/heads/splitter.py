"""LocalBins: seed bins at the bottleneck, each split into smaller ones at every level (Bhat et al. 2022).

Written from the paper and from LocalBins ``models/localbins.py``. It is ZoeDepth's ablation "splitter" (paper Table 5)
and its modified LocalBins (Table 2). ``BinProjectors``, ``BinSplitters`` and the functions on bins and windows also
serve the native LocalBins.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.config import Domain, SplitterConfig
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads.attractor import normed_centers
from zoedepth.model.heads.output import HeadOutput, Supervision, WindowBins
from zoedepth.model.heads.probability import build_probability
from zoedepth.model.upsample import upsample

_EPS = 1e-3
"""Added to widths and to the parts of a split, so that no bin is empty (LocalBins)."""
WINDOW_SIZES = (3, 7, 15, 31, 63)
"""Sides of the windows of LocalBins' loss, pixels of the network input."""

Map = Float[Tensor, "batch _ _ _"]


class SplitterFeatures(NamedTuple):
    """The output of ``SplitterEmbedding``, and the input of every splitter head."""

    bottleneck: Float[Tensor, "batch channels _ _"]
    """Stride 32: the decoder bottleneck after one convolution; the router sees it too."""
    embeddings: tuple[Float[Tensor, "batch embedding _ _"], ...]
    """Bin embeddings at strides 32, 16, 8, 4, 2."""
    last: Float[Tensor, "batch features height width"]
    relative: Float[Tensor, "batch 1 height width"]
    boxes: Float[Tensor, "batch windows 4"]
    """Boxes of the windows, see ``WindowBins``. There are windows in training only, and only if the config asks."""
    windows: tuple[Float[Tensor, "batch _ windows 1"], ...]
    """Bottleneck and bin embeddings of the windows, a row for each window; empty if there are none."""

    def rows(self, rows: Int[Tensor, " rows"]) -> "SplitterFeatures":
        """Take some images of the batch."""
        return SplitterFeatures(
            self.bottleneck[rows],
            tuple(embedding[rows] for embedding in self.embeddings),
            self.last[rows],
            self.relative[rows],
            self.boxes[rows],
            tuple(x[rows] for x in self.windows),
        )


class BinProjectors(nn.Module):
    """Makes bin embeddings of decoder maps: a two-layer 1x1 MLP at each of strides 32, 16, 8, 4, 2.

    Args:
        channels: channels of the maps.
        embedding_width: channels of the embeddings.
        hidden_width: hidden channels of the MLPs.
    """

    def __init__(self, channels: DecoderChannels, *, embedding_width: int, hidden_width: int) -> None:
        super().__init__()
        self.seed = _mlp(channels.bottleneck, hidden_width, embedding_width)
        self.levels = nn.ModuleList(_mlp(level, hidden_width, embedding_width) for level in channels.levels)

    def forward(self, bottleneck: Map, levels: tuple[Map, ...]) -> tuple[Map, ...]:
        """Embed maps of any size, coarse to fine."""
        return (self.seed(bottleneck), *(project(x) for project, x in zip(self.levels, levels, strict=True)))


class BinSplitters(nn.Module):
    """Predicts widths of bins at strides 16, 8, 4, 2: each level has ``factor`` times the bins of the one before.

    Args:
        channels: channels of the bottleneck.
        n_seed_bins: number of bins at the bottleneck.
        factor: number of bins that each bin is split into at a level.
        embedding_width: channels of the bin embeddings.
        hidden_width: hidden channels of the splitters.
        seed_width: hidden channels of the MLP that predicts the seed bins.

    Attributes:
        n_bins: number of bins at stride 2.
    """

    def __init__(
        self,
        channels: int,
        *,
        n_seed_bins: int,
        factor: int,
        embedding_width: int,
        hidden_width: int,
        seed_width: int,
    ) -> None:
        super().__init__()
        self.factor = factor
        counts = [n_seed_bins * factor**i for i in range(5)]
        self.n_bins = counts[-1]
        self.seed = _mlp(channels, seed_width, counts[0])
        self.splitters = nn.ModuleList(_mlp(embedding_width, hidden_width, n) for n in counts[1:])

    def forward(self, bottleneck: Map, embeddings: tuple[Map, ...]) -> tuple[Map, ...]:
        """Predict the widths at the four levels, as fractions of the depth range, float32.

        Args:
            bottleneck: the map that the seed bins are predicted from.
            embeddings: bin embeddings of the bottleneck, then of the levels, coarse to fine.
        """
        seed = F.relu(self.seed(bottleneck).float()) + _EPS
        widths = seed / seed.sum(dim=1, keepdim=True)
        levels = []
        for splitter, coarser, embedding in zip(self.splitters, embeddings[:-1], embeddings[1:], strict=True):
            size = embedding.shape[-2:]
            # As in the original, the next level gets this level's embedding, not the sum.
            scores = splitter(embedding + upsample(coarser, size)).float()
            # A mean of widths that add up to 1 does so too.
            widths = split(upsample(widths, size), scores, factor=self.factor)
            levels.append(widths)
        return tuple(levels)


def split(widths: Map, scores: Map, *, factor: int) -> Map:
    """Split every bin into ``factor`` neighbours whose widths add up to its own.

    Args:
        widths: widths of the bins (batch, bins, rows, columns), in any unit.
        scores: scores of their parts (batch, bins * factor, rows, columns), the parts of a bin side by side; negative
            ones count as 0.
        factor: number of parts of a bin.
    """
    parts = (F.relu(scores) + _EPS).unflatten(1, (-1, factor))
    return (widths[:, :, None] * (parts / parts.sum(dim=2, keepdim=True))).flatten(1, 2)


def bin_centers(widths: Map, domain: Domain, *, front_padding: bool = True) -> Map:
    """Compute the middles of bins, metres.

    Args:
        widths: widths of consecutive bins, as fractions of the depth range of the domain; they add up to 1.
        domain: the domain that the bins belong to.
        front_padding: True: the first bin begins at the nearest depth, the last ends at the farthest. False: as in the
            public code of LocalBins, which puts the nearest depth behind the widths instead of before them. Each center
            is then the next one's less the nearest depth, and the last bin is as wide as the nearest depth.
    """
    low, high = domain.min_depth, domain.max_depth
    if front_padding:
        return low + (high - low) * normed_centers(widths)
    edges = ((high - low) * widths).cumsum(dim=1)
    following = torch.cat([edges[:, 1:], edges[:, -1:] + low], dim=1)
    return (edges + following) / 2


def draw_boxes(features: Map, *, stride: int, n_windows: int) -> Float[Tensor, "batch windows 4"]:
    """Draw random windows of each of ``WINDOW_SIZES``, anywhere inside the photo, as ``WindowBins`` has them.

    Args:
        features: a map of the photo.
        stride: stride of the map, pixels of the network input.
        n_windows: number of windows of each size.
    """
    height, width = stride * features.shape[-2], stride * features.shape[-1]
    size = torch.tensor([width, height], device=features.device)
    # A photo may be smaller than the largest windows.
    sides = torch.tensor(WINDOW_SIZES, device=features.device)[:, None].clamp(max=size)
    sides = sides.repeat_interleave(n_windows, dim=0)
    chance = torch.rand(features.shape[0], *sides.shape, device=features.device)
    start = (chance * (size - sides + 1)).floor()
    return torch.cat([start / size, (start + sides) / size], dim=2)


def pool_windows(x: Map, boxes: Float[Tensor, "batch windows 4"]) -> Float[Tensor, "batch channels windows 1"]:
    """Average a map inside each window (RoI-align); return a map with one pixel for each window.

    Args:
        x: a map of the whole photo, at any resolution.
        boxes: left, top, right, bottom, as fractions of the photo.
    """
    from torchvision.ops import roi_align  # takes half a second

    height, width = x.shape[-2:]
    places = boxes * boxes.new_tensor([width, height, width, height])
    image = torch.arange(boxes.shape[0], device=boxes.device)[:, None, None].expand(-1, boxes.shape[1], 1)
    rois = torch.cat([image.to(places.dtype), places], dim=2).flatten(0, 1)
    pooled = roi_align(x.float(), rois, output_size=1, aligned=True)
    return pooled.flatten(1).unflatten(0, boxes.shape[:2]).transpose(1, 2)[..., None].to(x.dtype)


def window_bins(
    splitters: BinSplitters,
    boxes: Float[Tensor, "batch windows 4"],
    windows: tuple[Float[Tensor, "batch _ windows 1"], ...],
    domain: Domain,
    *,
    front_padding: bool = True,
) -> WindowBins | None:
    """Predict the bins of windows; return None if there are none.

    Args:
        splitters: the splitters of the head.
        boxes: boxes of the windows.
        windows: bottleneck and bin embeddings of the windows, a row for each window.
        domain, front_padding: see ``bin_centers``.
    """
    if not windows:
        return None
    bottleneck, *embeddings = windows
    levels = splitters(bottleneck, tuple(embeddings))
    centers = (bin_centers(widths, domain, front_padding=front_padding) for widths in levels)
    return WindowBins(boxes, tuple(x.squeeze(3).transpose(1, 2) for x in centers))


class SplitterEmbedding(nn.Module):
    """Makes bin embeddings of the photo and, in training, of windows; all domains share it."""

    def __init__(self, channels: DecoderChannels, config: SplitterConfig) -> None:
        super().__init__()
        self.bottleneck = nn.Conv2d(channels.bottleneck, channels.bottleneck, kernel_size=1)
        self.projectors = BinProjectors(
            channels, embedding_width=config.embedding_width, hidden_width=config.hidden_width
        )
        self.n_windows = config.n_windows

    def forward(self, features: DecoderFeatures) -> SplitterFeatures:
        """Embed every level; pass the last map and the relative depth through."""
        bottleneck, levels = self.bottleneck(features.bottleneck), features.levels
        boxes, windows = draw_boxes(levels[-1], stride=2, n_windows=self.n_windows if self.training else 0), ()
        if boxes.shape[1]:
            windows = embed_windows(self.projectors, bottleneck, levels, boxes)
        embeddings = self.projectors(bottleneck, levels)
        return SplitterFeatures(bottleneck, embeddings, features.last, features.relative, boxes, windows)


def embed_windows(
    projectors: BinProjectors, bottleneck: Map, levels: tuple[Map, ...], boxes: Float[Tensor, "batch windows 4"]
) -> tuple[Float[Tensor, "batch _ windows 1"], ...]:
    """Compute bottleneck and bin embeddings of windows, a row for each, from the decoder maps of the photo."""
    pooled = pool_windows(bottleneck, boxes)
    return (pooled, *projectors(pooled, tuple(pool_windows(level, boxes) for level in levels)))


class SplitterHead(nn.Module):
    """Metric depth of one domain: seed bins, four splits, probabilities at the resolution of the last map."""

    def __init__(self, channels: DecoderChannels, config: SplitterConfig, domain: Domain) -> None:
        super().__init__()
        self.domain = domain
        self.relative_input = config.relative_input
        self.bins = BinSplitters(
            channels.bottleneck,
            n_seed_bins=config.n_seed_bins,
            factor=config.factor,
            embedding_width=config.embedding_width,
            hidden_width=config.hidden_width,
            seed_width=config.seed_width,
        )
        self.probability = build_probability(
            config.probability,
            channels.last + int(config.relative_input) + config.embedding_width,
            self.bins.n_bins,
            bottleneck_factor=config.bottleneck_factor,
            min_temperature=config.min_temperature,
            max_temperature=config.max_temperature,
        )

    def forward(self, features: SplitterFeatures) -> HeadOutput:
        """Predict depth in metres at the size of ``features.last``."""
        centers = bin_centers(self.bins(features.bottleneck, features.embeddings)[-1], self.domain)
        inputs = [features.last, features.relative] if self.relative_input else [features.last]
        distribution = self.probability([*inputs, features.embeddings[-1]], centers)
        windows = window_bins(self.bins, features.boxes, features.windows, self.domain)
        return HeadOutput(distribution, Supervision(window_bins=windows))


def _mlp(channels: int, hidden: int, output_channels: int) -> nn.Sequential:
    """Build an MLP for every pixel: two 1x1 convolutions with a GELU between them."""
    return nn.Sequential(nn.Conv2d(channels, hidden, 1), nn.GELU(), nn.Conv2d(hidden, output_channels, 1))
