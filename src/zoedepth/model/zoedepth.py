"""ZoeDepth: metric depth from one image (paper Fig. 2)."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import ClassVar

from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.model.decoder import Decoder, DecoderFeatures
from zoedepth.model.encoder import Encoder
from zoedepth.model.heads import HEADS
from zoedepth.model.heads.output import HeadFeatures, HeadOutput, mixed
from zoedepth.model.interface import DepthModel, DepthOutput, Enlarge, at_pixels, depth_output, in_batch_order
from zoedepth.model.router import Routing, build_router
from zoedepth.model.upsample import ConvexWeights, convex_upsample, upsample


class ZoeDepth(DepthModel):
    """One encoder and decoder, one metric head for each domain, and a router that gives each image its head.

    A config without domains makes a model of encoder and decoder only, which gives relative depth.
    """

    from_pretrained: ClassVar[Callable[[str | Path], "ZoeDepth"]]
    """Load a ZoeDepth by name, file, folder or Hugging Face id. ``weights/pretrained.py``, above, puts it here."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = encoder = Encoder(config.encoder)
        self.decoder = Decoder(
            encoder.channels,
            encoder.strides,
            config.decoder,
            has_readout=encoder.has_readout,
            reassembled_channels=encoder.reassembled_channels,
        )
        if not config.domains:
            return
        head = HEADS[type(config.head)]
        self.shared = head.shared(self.decoder.channels, config.head)
        self.router = build_router(config.router, self.decoder.channels.bottleneck, len(config.domains))
        self.heads = nn.ModuleList(head.domain(self.decoder.channels, config.head, d) for d in config.domains)
        self.convex = ConvexWeights(self.decoder.channels.last) if config.decoder.upsampling == "convex" else None

    def forward(
        self,
        pixels: Float[Tensor, "batch 3 height width"],
        *,
        domain: Int[Tensor, " batch"] | None = None,
        return_std: bool = False,
        return_bins: bool = False,
    ) -> DepthOutput:
        """Predict the depth of a batch; an image's result does not depend on the others in its batch.

        Args:
            pixels: RGB in [0, 1]; sides are multiples of ``config.multiple``. Normalised here, not by the caller.
            domain: index in ``config.domains`` of the head each image takes; None leaves it to the router.
            return_std: True to return the standard deviation of the bin distribution as well.
            return_bins: True to return the bin centers and their probabilities as well.

        Raises:
            InputError: wrong shape or size, a labeled router without labels, or a model without metric heads.
        """
        if not self.config.domains:
            raise InputError(
                "this model has no metric head, it gives relative depth only: use model.relative(pixels) or "
                "Predictor.relative(photo), or train metric heads on it (zoedepth train --init)"
            )
        self.check(pixels, domain)
        decoded = self.relative_features(pixels)
        features = self.shared(decoded)
        routing = self.router(features.bottleneck, domain)
        groups = [
            depth_output(head, relative, routed, std=return_std, bins=return_bins)
            for head, relative, routed in self._apply_heads(features, routing)
        ]
        output = groups[0] if len(groups) == 1 else in_batch_order(groups, routing.domain)
        return at_pixels(output, pixels.shape[-2:], self.enlarge(decoded.last, pixels))

    def relative(self, pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 height width"]:
        """Predict the relative depth alone, as MiDaS: inverse depth up to scale and shift, >= 0, near is large.

        Stage 1 trains it; the loss of stage 2 does not keep it right.

        Args:
            pixels: see ``forward``.

        Raises:
            InputError: wrong shape or size.
        """
        self.check(pixels, None)
        return upsample(self.relative_features(pixels).relative, pixels.shape[-2:])

    def relative_features(self, pixels: Float[Tensor, "batch 3 height width"]) -> DecoderFeatures:
        """Encode and decode: the part that stage 1 trains. The maps have the decoder's resolution."""
        return self.decoder(self.encoder(normalize(pixels).to(self.dtype)))

    def enlarge(
        self, last: Float[Tensor, "batch features _ _"], pixels: Float[Tensor, "batch 3 height width"]
    ) -> Enlarge:
        """Return the function that gives maps of metres the size of the pixels, as the config says.

        Args:
            last: the last decoder map.
            pixels: see ``forward``.
        """
        if self.convex is None:
            return partial(upsample, size=pixels.shape[-2:])
        return partial(convex_upsample, weights=self.convex(last, normalize(pixels)))

    def _apply_heads(self, features: HeadFeatures, routing: Routing) -> Iterator[tuple[HeadOutput, Tensor, Routing]]:
        """Apply each head to its own images, or, where the router asks for a mixture, all heads to all images.

        Yields:
            For each group of images: the head's output, their relative depth, and their routing.
        """
        if routing.weight is not None:
            yield mixed([head(features) for head in self.heads], routing.weight), features.relative, routing
            return
        for index, head in enumerate(self.heads):
            rows = (routing.domain == index).nonzero().flatten()
            if len(rows) == len(routing.domain):  # all images take this head: nothing to copy
                yield head(features), features.relative, routing
            elif len(rows):
                own = features.rows(rows)
                yield head(own), own.relative, routing.rows(rows)


def normalize(pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 3 height width"]:
    """Map [0, 1] to [-1, 1], for every encoder: mean and standard deviation 0.5, as MiDaS v3.1 (not ImageNet's)."""
    return 2 * pixels - 1
