"""What an exported model is to other programs: the names of its inputs and outputs."""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

INPUT = "pixel_values"
"""RGB in [0, 1], float32 (batch, 3, height, width); normalised inside."""
DOMAIN = "domain"
"""Second input, of models with several heads: int64 (batch,), the head each image takes; -1 leaves it to the router."""

STD = "std"
"""Name of the output that is only computed when it is wanted, where the runtime allows."""


class Exported(NamedTuple):
    """What an exported model gives; its outputs have these names. Those that a model has not are left out."""

    predicted_depth: Float[Tensor, "batch height width"]
    """Metres."""
    std: Float[Tensor, "batch height width"] | None
    """Metres: standard deviation of the distribution that depth is the mean of."""
    domain_logits: Float[Tensor, "batch domains"] | None
    """The router's scores."""
