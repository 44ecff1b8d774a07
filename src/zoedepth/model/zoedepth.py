"""ZoeDepth: metric depth from one image (paper Fig. 2)."""

from pathlib import Path
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.heads import HEADS, HeadOutput
from zoedepth.heads.probability import expected_depth
from zoedepth.model.decoder import Decoder, DecoderFeatures, upsample
from zoedepth.model.encoder import Encoder
from zoedepth.model.router import Routing, build_router


class DepthOutput(NamedTuple):
    """What the model says of a batch."""

    depth: Float[Tensor, "batch 1 height width"]
    """Metres along the optical axis, at network resolution."""
    relative: Float[Tensor, "batch 1 height width"]
    """Relative depth: inverse depth up to an unknown scale and shift; near is large."""
    domain: Int[Tensor, " batch"]
    """Index in ``config.domains`` of the head each image took."""
    domain_logits: Float[Tensor, "batch domains"] | None
    """The router's scores; None where nothing was to be decided."""
    std: Float[Tensor, "batch 1 height width"] | None
    """Metres: standard deviation of the bin distribution, of which depth is the mean; on request."""
    bin_centers: Float[Tensor, "batch bins height width"] | None
    """Metres; on request."""
    probability: Float[Tensor, "batch bins height width"] | None
    """Sums to 1 over the bins; on request."""


class ZoeDepth(nn.Module):
    """One encoder and decoder, one metric head a domain, and a router that gives each image its head.

    Without any domain in its config it has encoder and decoder only, and gives relative depth.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = Encoder(config.encoder)
        self.decoder = Decoder(
            self.encoder.channels,
            self.encoder.strides,
            has_readout=self.encoder.has_readout,
            reassembled_channels=self.encoder.reassembled_channels,
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

    @classmethod
    def from_pretrained(cls, name_or_path: str | Path) -> "ZoeDepth":
        """The same as ``zoedepth.load_model``: a name, a file, a folder or a Hugging Face id."""
        from zoedepth.pretrained import load_model  # which builds on this module

        return load_model(name_or_path)

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return next(self.parameters()).device

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
        self._check(pixels, domain)
        size = pixels.shape[-2:]
        features = self.shared(self.relative_features(pixels))
        routing = self.router(features.bottleneck, domain)
        outputs, order = self._apply_heads(features, routing)
        return DepthOutput(
            upsample(_stitch([output.depth for output in outputs], order), size),
            upsample(features.relative, size),
            routing.domain,
            routing.logits,
            upsample(_stitch([output.std() for output in outputs], order), size) if return_std else None,
            # As large as n_bins depth maps each.
            upsample(_stitch([output.bin_centers for output in outputs], order), size) if return_bins else None,
            upsample(_stitch([output.probability for output in outputs], order), size) if return_bins else None,
        )

    def relative(self, pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 height width"]:
        """Relative depth alone, as MiDaS: inverse depth up to an unknown scale and shift, >= 0, near is large.

        Stage 1 trains it; the loss of stage 2 does not keep it right.

        Args:
            pixels: as in ``forward``.

        Raises:
            InputError: wrong shape or size.
        """
        self._check(pixels, None)
        return upsample(self.relative_features(pixels).relative, pixels.shape[-2:])

    def relative_features(self, pixels: Float[Tensor, "batch 3 height width"]) -> DecoderFeatures:
        """Stage 1's part of the model: encoder and decoder, with the relative depth, at the decoder's resolution."""
        return self.decoder(self.encoder(normalize(pixels)))

    def _apply_heads(self, features: Any, routing: Routing) -> tuple[list[HeadOutput], Int[Tensor, " batch"]]:
        """The heads' outputs, each for its own images, and the place of each image of the batch in their sequence."""
        if routing.weight is not None:
            return [_mix([head(features) for head in self.heads], routing.weight)], torch.arange(len(routing.domain))
        groups = [(routing.domain == index).nonzero().flatten() for index in range(len(self.heads))]
        outputs = [head(_take(features, rows)) for head, rows in zip(self.heads, groups, strict=True) if len(rows)]
        return outputs, torch.cat(groups).argsort()

    def _check(self, pixels: Tensor, domain: Tensor | None) -> None:
        if pixels.ndim != 4 or pixels.shape[1] != 3 or not pixels.is_floating_point():
            raise InputError(
                f"pixels must be float (batch, 3, height, width) in [0, 1]; got {pixels.dtype} {tuple(pixels.shape)}"
            )
        config, size = self.config, tuple(pixels.shape[-2:])
        if config.encoder.family == "swin" and size != config.size:
            raise InputError(f"{config.encoder.name} takes pixels of {config.size} only; got {size}")
        if any(side == 0 or side % config.multiple for side in size):
            raise InputError(
                f"the sides of pixels must be multiples of {config.multiple}; got {size}. "
                "Use zoedepth.Predictor, which resizes, or zoedepth.sizes.network_size"
            )
        if domain is None:
            return
        n_domains = len(config.domains)
        integers = domain.dtype in (torch.int64, torch.int32)
        if not integers or domain.shape != pixels.shape[:1] or not ((domain >= 0) & (domain < n_domains)).all():
            raise InputError(
                f"domain must hold {len(pixels)} integers, one an image, from 0 to {n_domains - 1}; got {domain}"
            )


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


def _stitch(parts: list[Tensor], order: Int[Tensor, " batch"]) -> Tensor:
    """Maps of groups of images, back in the order of the batch."""
    return parts[0] if len(parts) == 1 else torch.cat(parts)[order]


def _mix(outputs: list[HeadOutput], weight: Float[Tensor, "batch domains"]) -> HeadOutput:
    """One distribution over the bins of all heads; its mean is the weighted mean of their depths."""
    weights = weight[:, :, None, None, None].unbind(dim=1)
    centers = torch.cat([output.bin_centers for output in outputs], dim=1)
    probability = torch.cat([w * output.probability for w, output in zip(weights, outputs, strict=True)], dim=1)
    return HeadOutput(expected_depth(probability, centers), centers, probability)
