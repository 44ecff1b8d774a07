"""What all models of this package have in common: pixels in, ``DepthOutput`` out."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.config import AnyModelConfig
from zoedepth.errors import InputError
from zoedepth.model.decoder import upsample
from zoedepth.model.encoder import TimmEncoder
from zoedepth.model.heads.output import Answer, Supervision
from zoedepth.model.router import Routing


class DepthOutput(NamedTuple):
    """What a model says of a batch."""

    depth: Float[Tensor, "batch 1 height width"]
    """Metres along the optical axis, at network resolution."""
    relative: Float[Tensor, "batch 1 height width"] | None
    """Relative depth: inverse depth up to an unknown scale and shift; near is large. None of a baseline."""
    domain: Int[Tensor, " batch"]
    """Index in ``config.domains`` of the head each image took."""
    domain_logits: Float[Tensor, "batch domains"] | None
    """The router's scores; None where nothing was to be decided."""
    std: Float[Tensor, "batch 1 height width"] | None
    """Metres: standard deviation of the bin distribution, of which depth is the mean; on request, of heads with one."""
    bin_centers: Float[Tensor, "batch bins height width"] | None
    """Metres; on request, of heads with a distribution."""
    probability: Float[Tensor, "batch bins height width"] | None
    """Sums to 1 over the bins; on request, of heads with a distribution."""
    supervision: Supervision = Supervision()
    """What the head's own loss needs beside depth."""


def depth_output(
    answer: Answer, size: torch.Size, routing: Routing, relative: Float[Tensor, "batch 1 height width"] | None
) -> DepthOutput:
    """What a head says, at the size of the pixels."""
    std, centers, probability = (None if x is None else upsample(x, size) for x in answer[1:4])
    depth = upsample(answer.depth, size)
    return DepthOutput(depth, relative, routing.domain, routing.logits, std, centers, probability, answer.supervision)


class DepthModel(nn.Module, ABC):
    """A model of metric depth: ``ZoeDepth``, or one of the baselines.

    Attributes:
        config: all there is to know to build it.
        encoder: what its ImageNet weights go to.
    """

    config: AnyModelConfig
    encoder: TimmEncoder

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return next(self.parameters()).device

    @abstractmethod
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
            domain: index in ``config.domains`` of the head each image takes; None leaves it to the model.
            return_std: also return the standard deviation of the bin distribution.
            return_bins: also return the bin centers and their probabilities.

        Raises:
            InputError: wrong shape or size, or a domain there is not.
        """

    def relative(self, pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 height width"]:
        """Relative depth alone, of models that have it.

        Raises:
            InputError: this one has not.
        """
        raise InputError("this model has no relative depth: it is one of the baselines, which give metres only")

    def check(self, pixels: Tensor, domain: Tensor | None) -> None:
        """Refuse what the network cannot take.

        Raises:
            InputError: see ``forward``.
        """
        if pixels.ndim != 4 or pixels.shape[1] != 3 or not pixels.is_floating_point():
            raise InputError(
                f"pixels must be float (batch, 3, height, width) in [0, 1]; got {pixels.dtype} {tuple(pixels.shape)}"
            )
        config, size = self.config, tuple(pixels.shape[-2:])
        if config.one_size and size != config.size:
            raise InputError(f"{config.encoder_name} takes pixels of {config.size} only; got {size}")
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
