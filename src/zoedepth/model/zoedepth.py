"""ZoeDepth: metric depth from one image (paper Fig. 2)."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.decoder import Decoder, DecoderFeatures, upsample
from zoedepth.model.encoder import Encoder
from zoedepth.model.heads import HEADS
from zoedepth.model.heads.output import Answer, mixed
from zoedepth.model.interface import DepthModel, DepthOutput, depth_output
from zoedepth.model.router import Routing, build_router


class ZoeDepth(DepthModel):
    """One encoder and decoder, one metric head a domain, and a router that gives each image its head.

    Without any domain in its config it has encoder and decoder only, and gives relative depth.
    """

    from_pretrained: ClassVar[Callable[[str | Path], "ZoeDepth"]]
    """Load a ZoeDepth by name, file, folder or Hugging Face id. ``weights/load.py``, which is above, puts it here."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = encoder = Encoder(config.encoder)
        self.decoder = Decoder(
            encoder.channels,
            encoder.strides,
            has_readout=encoder.has_readout,
            reassembled_channels=encoder.reassembled_channels,
            widths=config.decoder.widths,
            features=config.decoder.features,
            output_stride=config.decoder.output_stride,
        )
        if not config.domains:
            return
        head = HEADS[type(config.head)]
        self.shared = head.shared(self.decoder.channels, config.head)
        self.router = build_router(config.router, self.decoder.channels.bottleneck, len(config.domains))
        self.heads = nn.ModuleList(head.domain(self.decoder.channels, config.head, d) for d in config.domains)

    def forward(
        self,
        pixels: Float[Tensor, "batch 3 height width"],
        *,
        domain: Int[Tensor, " batch"] | None = None,
        return_std: bool = False,
        return_bins: bool = False,
    ) -> DepthOutput:
        """Depth of a batch; an image's result does not depend on the others in its batch.

        Args:
            pixels: RGB in [0, 1]; sides are multiples of ``config.multiple``. Normalised here, not by the caller.
            domain: index in ``config.domains`` of the head each image takes; None leaves it to the router.
            return_std: also return the standard deviation of the bin distribution.
            return_bins: also return the bin centers and their probabilities.

        Raises:
            InputError: wrong shape or size, a labeled router without labels, or a model without metric heads.
        """
        if not self.config.domains:
            raise InputError(
                "this model has no metric head, it gives relative depth only: use model.relative(pixels) or "
                "Predictor.relative(photo), or train metric heads on it (zoedepth train --init)"
            )
        self.check(pixels, domain)
        size = pixels.shape[-2:]
        features = self.shared(self.relative_features(pixels))
        routing = self.router(features.bottleneck, domain)
        answer = self._apply_heads(features, routing, std=return_std, bins=return_bins)
        return depth_output(answer, size, routing, upsample(features.relative, size))

    def relative(self, pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 height width"]:
        """Relative depth alone, as MiDaS: inverse depth up to an unknown scale and shift, >= 0, near is large.

        Stage 1 trains it; the loss of stage 2 does not keep it right.

        Args:
            pixels: as in ``forward``.

        Raises:
            InputError: wrong shape or size.
        """
        self.check(pixels, None)
        return upsample(self.relative_features(pixels).relative, pixels.shape[-2:])

    def relative_features(self, pixels: Float[Tensor, "batch 3 height width"]) -> DecoderFeatures:
        """Stage 1's part of the model: encoder and decoder, with the relative depth, at the decoder's resolution."""
        return self.decoder(self.encoder(normalize(pixels)))

    def _apply_heads(self, features: Any, routing: Routing, *, std: bool, bins: bool) -> Answer:
        """What the heads say, each of its own images, in the order of the batch."""
        if routing.weight is not None:
            return mixed([head(features) for head in self.heads], routing.weight).answer(std=std, bins=bins)
        groups = [(routing.domain == index).nonzero().flatten() for index in range(len(self.heads))]
        said = [
            head(_take(features, rows)).answer(std=std, bins=bins)
            for head, rows in zip(self.heads, groups, strict=True)
            if len(rows)
        ]
        return said[0] if len(said) == 1 else _stitch(said, torch.cat(groups).argsort())


def normalize(pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 3 height width"]:
    """[0, 1] to [-1, 1]: mean and standard deviation 0.5, for every encoder (MiDaS v3.1; not ImageNet's)."""
    return 2 * pixels - 1


def _take(features: Any, rows: Int[Tensor, " rows"]) -> Any:
    """The given images of every map of a NamedTuple."""
    if all(len(rows) == len(x) for x in features if isinstance(x, Tensor)):
        return features  # all of them, in order: nothing to copy
    return type(features)(*(
        x[rows] if isinstance(x, Tensor) else tuple(level[rows] for level in x) for x in features
    ))  # fmt: skip


def _stitch(parts: list[Any], order: Int[Tensor, " batch"]) -> Any:
    """What was said of groups of images, tensors in tuples of tuples, back in the order of the batch."""
    first = parts[0]
    if isinstance(first, Tensor):
        return torch.cat(parts)[order]
    if not isinstance(first, tuple):
        return first  # nothing: None
    fields = [_stitch(list(field), order) for field in zip(*parts, strict=True)]
    return type(first)(*fields) if hasattr(first, "_fields") else type(first)(fields)
