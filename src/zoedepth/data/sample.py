"""One training example, and many of them as a batch."""

from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from zoedepth.camera import Intrinsics
from zoedepth.errors import InputError

Target = Literal["depth", "disparity"]
"""depth: metres along the optical axis. disparity: inverse depth up to an unknown scale and shift; near is large."""


@dataclass(frozen=True)
class Sample:
    """A photo and what is known of its depth."""

    image: Float[Tensor, "3 height width"]
    """RGB in [0, 1]."""
    target: Float[Tensor, "1 height width"]
    """Depth in metres, or disparity; 0 where unknown."""
    mask: Bool[Tensor, "1 height width"]
    """True where the target is known."""
    kind: Target
    """What the target is."""
    domain: str
    """Scene type: "indoor", "outdoor" or your own."""
    name: str
    """The image's path as the data set lists it."""
    camera: Intrinsics | None = None
    """The camera of the photo at its present size, where it is known."""


@runtime_checkable
class Samples(Protocol):
    """A data set: samples by number."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Sample: ...


class Batch(NamedTuple):
    """Samples of one size, stacked."""

    pixels: Float[Tensor, "batch 3 height width"]
    target: Float[Tensor, "batch 1 height width"]
    mask: Bool[Tensor, "batch 1 height width"]
    domain: Int[Tensor, " batch"]
    """Index of each sample's domain in the model's config."""
    names: list[str]


def collate(samples: list[Sample], *, domains: tuple[str, ...]) -> Batch:
    """Stack samples of one size.

    Args:
        samples: of the same size and kind.
        domains: names of the model's domains. A model of a single domain takes every sample.

    Raises:
        InputError: a sample's domain is not one of the model's.
    """
    unknown = {sample.domain for sample in samples} - set(domains) if len(domains) > 1 else set()
    if unknown:
        raise InputError(f"the data has domains {sorted(unknown)}, the model {list(domains)}; rename one of them")
    return Batch(
        torch.stack([sample.image for sample in samples]),
        torch.stack([sample.target for sample in samples]),
        torch.stack([sample.mask for sample in samples]),
        torch.tensor([domains.index(sample.domain) if len(domains) > 1 else 0 for sample in samples]),
        [sample.name for sample in samples],
    )
