"""One training example, and many of them as a batch."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int, Int64
from torch import Tensor

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Intrinsics

Target = Literal["depth", "disparity"]
"""depth: metres along the optical axis. disparity: inverse depth up to an unknown scale and shift; near is large."""


@dataclass(frozen=True)
class Sample:
    """A photo and what is known of its depth."""

    image: Float[Tensor, "3 height width"]
    """RGB in [0, 1]."""
    target: Float[Tensor, "1 rows columns"]
    """Depth in metres, or disparity; 0 where unknown. It has the size of the photo, except in a training whose photo is
    resized and whose loss is taken at the size of the truth."""
    mask: Bool[Tensor, "1 rows columns"]
    """True where the target is known."""
    kind: Target
    """The kind of the target: depth or disparity."""
    domain: str
    """Scene type: "indoor", "outdoor" or your own."""
    name: str
    """The image's path as the data set lists it."""
    camera: Intrinsics | None = None
    """The camera of the photo at its present size, where it is known."""
    source: int = 0
    """Index of its data set in a mixture."""


@runtime_checkable
class Samples(Protocol):
    """A data set: samples by number."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Sample: ...


class DepthDataset(Samples, Protocol):
    """A data set that says what occurs in it, without reading its samples."""

    @property
    def domains(self) -> Sequence[str]:
        """The scene types that occur."""
        ...

    @property
    def kinds(self) -> Sequence[Target]:
        """The kinds of target that occur."""
        ...


@runtime_checkable
class Ordered(Samples, Protocol):
    """A data set that is slow to read in an arbitrary order, and knows shuffled orders that are fast."""

    def order(self, rng: np.random.Generator) -> Int64[np.ndarray, " samples"]:
        """Return the numbers of all samples, each once, shuffled."""
        ...


@runtime_checkable
class Hashed(Samples, Protocol):
    """A data set in few large files, whose hashes were written down with them."""

    def altered(self) -> dict[int, str]:
        """Return the numbers of the samples in files that are not as they were written → which file, and what to do."""
        ...


class Batch(NamedTuple):
    """Samples whose photos have one size, stacked."""

    pixels: Float[Tensor, "batch 3 height width"]
    target: Float[Tensor, "batch 1 rows columns"]
    """Depth or disparity, at the size of the pixels or at that of the truth."""
    mask: Bool[Tensor, "batch 1 rows columns"]
    domain: Int[Tensor, " batch"]
    """Index of each sample's domain in the config of the model."""
    source: Int[Tensor, " batch"]
    """Index of each sample's data set in the mixture."""
    names: list[str]
    kind: Target
    sizes: Int[Tensor, "batch 2"] | None = None
    """(height, width) of each sample's target where they differ; a smaller one has unknown depth on its right and
    below. None: all are of one size."""

    def truth(self, i: int) -> tuple[Tensor, Tensor]:
        """Return target and mask of a sample, on the CPU, without what was added to them."""
        height, width = self.target.shape[-2:] if self.sizes is None else self.sizes[i].tolist()
        return self.target[i, :, :height, :width].cpu(), self.mask[i, :, :height, :width].cpu()

    def samples(self, domains: Sequence[str]) -> list[Sample]:
        """Take the batch apart into samples, as far as it knows them; ``domains`` are the model's, by name."""
        return [
            Sample(self.pixels[i].cpu(), *self.truth(i), self.kind,
                   domains[int(self.domain[i])] if domains else "", self.names[i])
            for i in range(len(self.names))
        ]  # fmt: skip


def collate(samples: list[Sample], *, domains: tuple[str, ...]) -> Batch:
    """Stack samples whose photos have one size.

    Args:
        samples: samples of the same size of the photo, and of the same kind. Their targets may differ in size.
        domains: names of the model's domains. A model of a single domain takes every sample.

    Raises:
        InputError: a sample's domain is not one of the model's.
    """
    unknown = {sample.domain for sample in samples} - set(domains) if len(domains) > 1 else set()
    if unknown:
        raise InputError(
            f"the data has domains {sorted(unknown)}, the model has {list(domains)}. Rename a domain of the data, or "
            "choose another model"
        )
    sizes = [(sample.target.shape[1], sample.target.shape[2]) for sample in samples]
    largest = max(height for height, _ in sizes), max(width for _, width in sizes)
    return Batch(
        torch.stack([sample.image for sample in samples]),
        torch.stack([_padded(sample.target, largest) for sample in samples]),
        torch.stack([_padded(sample.mask, largest) for sample in samples]),
        torch.tensor([domains.index(sample.domain) if len(domains) > 1 else 0 for sample in samples]),
        torch.tensor([sample.source for sample in samples]),
        [sample.name for sample in samples],
        samples[0].kind,
        torch.tensor(sizes) if len(set(sizes)) > 1 else None,
    )


def _padded(x: Tensor, size: tuple[int, int]) -> Tensor:
    """Add zeros on the right and below, up to this size."""
    return F.pad(x, (0, size[1] - x.shape[2], 0, size[0] - x.shape[1]))
