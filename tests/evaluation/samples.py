"""Samples whose depth is known, and a source that predicts as it is told; shared by the tests of this folder."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.evaluation.predictions import Prediction
from zoedepth.evaluation.protocols import Protocol

EVERYWHERE = Protocol("everywhere", max_depth=10.0)
"""Scores every known pixel below 10 m."""


def sample_of(truth: object, *, domain: str = "indoor", name: str = "photo.jpg") -> Sample:
    """Make a grey photo with this depth, metres; 0 is unknown."""
    target = torch.tensor(np.asarray(truth), dtype=torch.float32)[None]
    return Sample(torch.full((3, *target.shape[1:]), 0.5), target, target > 0, "depth", domain, name)


def photo(size: tuple[int, int], *, seed: int = 0, domain: str = "indoor", name: str = "photo.jpg") -> Sample:
    """Make a photo of 8 bits and a depth of 1 to 9 m, both at random."""
    rng = np.random.default_rng(seed)
    sample = sample_of(rng.uniform(1, 9, size=size), domain=domain, name=name)
    values = rng.integers(0, 256, size=(3, *size))
    return replace(sample, image=torch.tensor(values / 255, dtype=torch.float32))


def prediction_of(depth: object, *, std: object = None, relative: bool = False) -> Prediction:
    """Make a prediction of these values."""
    return Prediction(
        np.asarray(depth, dtype=np.float32),
        None if std is None else np.asarray(std, dtype=np.float32),
        relative=relative,
    )


@dataclass
class FactorSource:
    """Predict the truth times a factor, which no real source could. It lists the photos it was asked for."""

    factors: dict[str, float] = field(default_factory=dict)
    """Photo's name → factor; 1 for others."""
    broken: Sequence[str] = ()
    """Names of photos that it fails on."""
    domain: str | None = None
    asked: list[str] = field(default_factory=list)

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        self.asked.append(sample.name)
        if sample.name in self.broken:
            raise InputError(f"{sample.name} is broken")
        depth = (sample.target[0] * self.factors.get(sample.name, 1.0)).numpy()
        return Prediction(depth, 0.5 * depth + 0.25, self.domain)
