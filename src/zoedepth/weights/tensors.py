"""Names of the inputs and outputs of an exported model."""

from typing import Any, NamedTuple

from jaxtyping import Float

INPUT = "pixel_values"
"""RGB in [0, 1], float32 (batch, 3, height, width); normalised inside."""
DOMAIN = "domain"
"""Second input of models with several heads: int64 (batch,), the head of each image; -1 leaves it to the router."""

STD = "std"
"""Output that is computed only when it is wanted, where the runtime allows it."""


class Exported(NamedTuple):
    """Outputs of an exported model, under these names: tensors or arrays. A model leaves out those it does not have."""

    predicted_depth: Float[Any, "batch height width"]
    """Metres."""
    std: Float[Any, "batch height width"] | None
    """Metres: standard deviation of the distribution whose mean is the depth."""
    domain_logits: Float[Any, "batch domains"] | None
    """The router's scores."""
