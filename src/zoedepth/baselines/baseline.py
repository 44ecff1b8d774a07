"""Baselines behind the interface of ZoeDepth."""

from abc import abstractmethod

import torch
from jaxtyping import Float, Int
from torch import Tensor

from zoedepth.config import BaselineConfig, Domain
from zoedepth.model.heads.output import HeadOutput
from zoedepth.model.interface import DepthModel, DepthOutput, at_pixels, depth_output
from zoedepth.model.router import Routing

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Mean and standard deviation of ImageNet's photos, RGB in [0, 1]."""


class Baseline(DepthModel):
    """A system the paper compares with. Subclasses build ``encoder`` and all that follows, and define ``predict``.

    Attributes:
        domain: the domain that the one head is for.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__()
        self.config = config
        self.domain: Domain = config.domains[0]
        self.register_buffer("mean", torch.empty(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.empty(3, 1, 1), persistent=False)
        self.init_non_persistent_buffers()

    def init_non_persistent_buffers(self) -> None:
        """Fill the buffers that no checkpoint holds, after the module was built without memory (timm's name for it)."""
        for buffer, values in ((self.mean, IMAGENET_MEAN), (self.std, IMAGENET_STD)):
            buffer.copy_(torch.tensor(values)[:, None, None])

    @abstractmethod
    def predict(self, x: Float[Tensor, "batch 3 height width"]) -> HeadOutput:
        """Predict the depth of normalised pixels, at any resolution."""

    def forward(
        self,
        pixels: Float[Tensor, "batch 3 height width"],
        *,
        domain: Int[Tensor, " batch"] | None = None,
        return_std: bool = False,
        return_bins: bool = False,
    ) -> DepthOutput:
        """Predict the depth of a batch, as ``ZoeDepth.forward`` does; there is one head."""
        self.check(pixels, domain)
        head = self.predict(((pixels - self.mean) / self.std).to(self.dtype))
        only = torch.zeros(pixels.shape[0], dtype=torch.long, device=pixels.device)
        output = depth_output(head, None, Routing(only, None), std=return_std, bins=return_bins)
        return at_pixels(output, pixels.shape[-2:])
