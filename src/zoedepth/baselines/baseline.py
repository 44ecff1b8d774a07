"""A baseline behind the interface of ZoeDepth."""

from abc import abstractmethod

import torch
from jaxtyping import Float, Int
from torch import Tensor

from zoedepth.config import BaselineConfig, Domain
from zoedepth.model.heads.output import HeadOutput
from zoedepth.model.interface import DepthModel, DepthOutput, depth_output
from zoedepth.model.router import Routing

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of RGB in [0, 1]."""


class Baseline(DepthModel):
    """A system the paper compares with. Subclasses build ``encoder`` and whatever follows, and give ``predict``.

    Attributes:
        mean, std: what the encoder was trained to see subtracted from, and divided out of, RGB in [0, 1].
        domain: its depth range.
    """

    mean: tuple[float, float, float] = IMAGENET_MEAN
    std: tuple[float, float, float] = IMAGENET_STD

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__()
        self.config = config
        self.domain: Domain = config.domains[0]

    @abstractmethod
    def predict(self, x: Float[Tensor, "batch 3 height width"]) -> HeadOutput:
        """Depth of normalised pixels, at any resolution."""

    def forward(
        self,
        pixels: Float[Tensor, "batch 3 height width"],
        *,
        domain: Int[Tensor, " batch"] | None = None,
        return_std: bool = False,
        return_bins: bool = False,
    ) -> DepthOutput:
        """Depth of a batch, as ``ZoeDepth.forward`` gives it; there is one head."""
        self.check(pixels, domain)
        size = pixels.shape[-2:]
        mean, std = (pixels.new_tensor(values)[:, None, None] for values in (self.mean, self.std))
        answer = self.predict((pixels - mean) / std).answer(std=return_std, bins=return_bins)
        only = torch.zeros(pixels.shape[0], dtype=torch.long, device=pixels.device)
        return depth_output(answer, size, Routing(only, None), None)
