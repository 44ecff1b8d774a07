"""Samples to a batch: order, domains by the model's numbering, and domains the model does not have."""

import pytest
import torch

from zoedepth.data.sample import Sample, collate
from zoedepth.errors import InputError


def sample(value: float, domain: str) -> Sample:
    target = torch.full((1, 2, 3), value)
    return Sample(torch.full((3, 2, 3), value / 10), target, target > 1.5, "depth", domain, f"{domain}-{value}")


def test_batch_holds_the_samples_in_order() -> None:
    batch = collate([sample(1, "a"), sample(2, "b"), sample(3, "a")], domains=("a", "b"))
    assert batch.pixels.shape == (3, 3, 2, 3)
    assert batch.pixels[:, 0, 0, 0].tolist() == pytest.approx([0.1, 0.2, 0.3])
    assert batch.target[:, 0, 0, 0].tolist() == [1, 2, 3]
    assert batch.mask[:, 0, 0, 0].tolist() == [False, True, True]
    assert batch.names == ["a-1", "b-2", "a-3"]


def test_domains_are_numbered_as_in_the_model() -> None:
    samples = [sample(1, "a"), sample(2, "b"), sample(3, "a")]
    assert collate(samples, domains=("a", "b")).domain.tolist() == [0, 1, 0]
    assert collate(samples, domains=("b", "c", "a")).domain.tolist() == [2, 0, 2]


def test_unknown_domain_is_an_error_that_names_it() -> None:
    with pytest.raises(InputError, match=r"'attic'.*'a', 'b'"):
        collate([sample(1, "a"), sample(2, "attic")], domains=("a", "b"))


def test_model_of_one_domain_takes_every_sample() -> None:
    assert collate([sample(1, "attic"), sample(2, "")], domains=("any",)).domain.tolist() == [0, 0]
