"""The interface of every model in this package: pixels in, ``DepthOutput`` out."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.config import AnyModelConfig
from zoedepth.errors import InputError
from zoedepth.model.heads.output import HeadOutput, Supervision, join
from zoedepth.model.router import Routing
from zoedepth.model.timm_encoder import TimmEncoder
from zoedepth.model.upsample import upsample
from zoedepth.provenance import Provenance

Enlarge = Callable[[Float[Tensor, "batch 1 _ _"]], Float[Tensor, "batch 1 height width"]]
"""Gives a map of metres the size of the pixels."""


class DepthOutput(NamedTuple):
    """A model's output for a batch."""

    depth: Float[Tensor, "batch 1 height width"]
    """Metres along the optical axis, at network resolution."""
    relative: Float[Tensor, "batch 1 height width"] | None
    """Relative depth: inverse depth up to an unknown scale and shift; near is large. Baselines have none."""
    domain: Int[Tensor, " batch"]
    """Index in ``config.domains`` of the head each image took."""
    domain_logits: Float[Tensor, "batch domains"] | None
    """The router's scores; None where it had nothing to decide."""
    std: Float[Tensor, "batch 1 height width"] | None
    """Metres: standard deviation of the distribution whose mean is the depth. On request, from heads that have one."""
    bin_centers: Float[Tensor, "batch bins height width"] | None
    """Metres. On request, from heads that have a distribution."""
    probability: Float[Tensor, "batch bins height width"] | None
    """Sums to 1 over the bins. On request, from heads that have a distribution."""
    supervision: Supervision = Supervision()
    """The inputs of the head's own loss beside depth."""


def depth_output(
    head: HeadOutput,
    relative: Float[Tensor, "batch 1 _ _"] | None,
    routing: Routing,
    *,
    std: bool,
    bins: bool,
) -> DepthOutput:
    """Return a head's output as that of a model, still at the head's resolution.

    Args:
        head: the output of the head.
        relative: relative depth of the same images, where the model has it.
        routing: which head each image took.
        std: True to compute the standard deviation.
        bins: True to compute the bins.
    """
    depth, spread = head.depth_and_std() if std else (head.depth, None)
    distribution = head.distribution if bins else None
    return DepthOutput(
        depth=depth,
        relative=relative,
        domain=routing.domain,
        domain_logits=routing.logits,
        std=spread,
        bin_centers=None if distribution is None else distribution.bin_centers,
        probability=None if distribution is None else distribution.probability,
        supervision=head.supervision,
    )


def at_pixels(output: DepthOutput, size: torch.Size, enlarge: Enlarge | None = None) -> DepthOutput:
    """Give an output the size of the pixels. Each of the two tensors of bins is then as large as n_bins depth maps.

    Args:
        output: the output, at the head's resolution.
        size: (height, width) of the pixels.
        enlarge: gives the depth and its standard deviation that size; None: bilinear, as everything else.
    """
    if enlarge is None:
        enlarge = partial(upsample, size=size)
    return output._replace(
        depth=enlarge(output.depth),
        relative=None if output.relative is None else upsample(output.relative, size),
        std=None if output.std is None else enlarge(output.std),
        bin_centers=None if output.bin_centers is None else upsample(output.bin_centers, size),
        probability=None if output.probability is None else upsample(output.probability, size),
    )


def in_batch_order(groups: list[DepthOutput], domain: Int[Tensor, " batch"]) -> DepthOutput:
    """Join the outputs of groups of images in the order of the batch.

    Args:
        groups: a group for each domain that the batch has, in the order of the domains.
        domain: index of the domain of each image of the batch.
    """
    order = domain.argsort(stable=True).argsort()

    def where_given(parts: Iterable[Tensor | None]) -> Tensor | None:
        given = [part for part in parts if part is not None]
        return join(given, order) if given else None

    return DepthOutput(
        depth=join((group.depth for group in groups), order),
        relative=where_given(group.relative for group in groups),
        domain=domain,
        domain_logits=where_given(group.domain_logits for group in groups),
        std=where_given(group.std for group in groups),
        bin_centers=where_given(group.bin_centers for group in groups),
        probability=where_given(group.probability for group in groups),
        supervision=Supervision.joined([group.supervision for group in groups], order),
    )


class DepthModel(nn.Module, ABC):
    """A model of metric depth: ``ZoeDepth``, or one of the baselines.

    Attributes:
        config: everything needed to build the model.
        encoder: the part that ImageNet weights are loaded into.
        provenance: licence and training data of the weights, where they are known.
    """

    config: AnyModelConfig
    encoder: TimmEncoder
    provenance: Provenance = Provenance()

    @property
    def device(self) -> torch.device:
        """The device of the weights."""
        return next(self.parameters()).device

    @property
    def dtype(self) -> torch.dtype:
        """The number type of the weights, to which pixels are converted: float32 unless the caller changed it."""
        return next((weight.dtype for weight in self.parameters()), torch.float32)

    @abstractmethod
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
            pixels: RGB in [0, 1], of any floating-point type; sides are multiples of ``config.multiple``. Normalised
                here, not by the caller.
            domain: index in ``config.domains`` of the head each image takes; None leaves it to the model.
            return_std: True to return the standard deviation of the bin distribution as well.
            return_bins: True to return the bin centers and their probabilities as well.

        Raises:
            InputError: the pixels have a wrong shape or size, or there is no such domain.
        """

    def relative(self, pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 height width"]:
        """Predict the relative depth alone.

        Raises:
            InputError: the model has none.
        """
        raise InputError(
            "this model has no relative depth: it is one of the baselines, which give metres only. Use a ZoeDepth."
        )

    def check(self, pixels: Tensor, domain: Tensor | None) -> None:
        """Check the inputs of ``forward``.

        Raises:
            InputError: the network cannot take them; see ``forward``.
        """
        if pixels.ndim != 4 or pixels.shape[1] != 3 or not pixels.is_floating_point():
            raise InputError(
                f"pixels must be float (batch, 3, height, width) in [0, 1]; got {pixels.dtype} {tuple(pixels.shape)}"
            )
        config, size = self.config, tuple(pixels.shape[-2:])
        if config.one_size and size != config.size:
            raise InputError(
                f"{config.encoder_name} takes pixels of {config.size} only; got {size}. "
                "Use zoedepth.Predictor, which resizes."
            )
        if any(side == 0 or side % config.multiple for side in size):
            raise InputError(
                f"the sides of pixels must be multiples of {config.multiple}; got {size}. "
                "Use zoedepth.Predictor, which resizes, or zoedepth.sizes.network_size"
            )
        if domain is not None:
            n_domains = len(config.domains)
            integers = domain.dtype in (torch.int64, torch.int32)
            if not integers or domain.shape != pixels.shape[:1] or not ((domain >= 0) & (domain < n_domains)).all():
                raise InputError(
                    f"domain must hold {len(pixels)} integers, one an image, from 0 to {n_domains - 1}; got {domain}"
                )
        if pixels.device != self.device:
            raise InputError(f"pixels are on {pixels.device} and the model is on {self.device}: move one to the other")
