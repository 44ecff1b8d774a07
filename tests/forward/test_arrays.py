"""Exported models without torch: the same as with it."""

from dataclasses import replace

import numpy as np
import pytest

from zoedepth.config import ModelConfig
from zoedepth.errors import InputError
from zoedepth.forward.answer import Answer
from zoedepth.forward.arrays import ArrayForward
from zoedepth.forward.tensors import TensorForward
from zoedepth.weights.exported import ExportedModel

PHOTOS = [
    (np.random.default_rng(0).integers(0, most, (*size, 3), np.uint8), (64, width))
    for most, size, width in ((256, (50, 90), 96), (100, (90, 50), 64), (256, (70, 97), 96))
]
"""Photos with their network sizes; two share one."""


class Brightness(ExportedModel):
    """Depth is 1 m + the red channel in metres, ten times that outdoors: where it is bright, above all at the left.

    A photo and its mirror image may be taken for different scenes.
    """

    def __init__(self, config: ModelConfig) -> None:
        self.config = config

    def run(self, inputs: dict[str, np.ndarray], *, std: bool) -> dict[str, np.ndarray]:
        pixels = inputs["pixel_values"]
        depth, several = 1 + pixels[:, 0], {}
        if len(self.config.domains) > 1:
            edges = pixels[..., 0].mean(axis=(1, 2)) - pixels[..., -1].mean(axis=(1, 2))
            logits = np.stack([np.zeros_like(edges), 10 * edges + pixels.mean(axis=(1, 2, 3)) - 0.4], axis=1)
            asked = inputs["domain"]
            chosen = np.where(asked < 0, logits.argmax(axis=1), asked)
            depth, several = depth * np.where(chosen == 1, 10, 1)[:, None, None], {"domain_logits": logits}
        return {"predicted_depth": depth, **({"std": 0.1 * depth} if std else {}), **several}


def both(config: ModelConfig, head: int | None, *, pad: bool, flip: bool) -> tuple[list[Answer], list[Answer]]:
    """What is said without torch, and with it."""
    model = Brightness(config)
    arrays = ArrayForward(model, pad, flip, "bicubic").predict(PHOTOS, head, batch_size=2)
    return arrays, TensorForward(model, pad, flip, "bicubic", "float32").predict(PHOTOS, head, batch_size=2)


@pytest.mark.parametrize("antialias", [True, False])
@pytest.mark.parametrize(("pad", "flip", "head"), [(False, False, None), (True, True, None), (False, True, 1)])
def test_depth_is_that_of_torch(
    tiny_config: ModelConfig, antialias: bool, pad: bool, flip: bool, head: int | None
) -> None:
    found, expected = both(replace(tiny_config, antialias=antialias), head, pad=pad, flip=flip)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.depth, other.depth, atol=1e-4)  # rounding, of up to 20 m
        np.testing.assert_allclose(one.std, other.std, atol=1e-4)
        assert (one.domain, one.depth.dtype) == (other.domain, np.float32)
        assert one.probability == pytest.approx(other.probability, abs=1e-5)
    assert {answer.domain for answer in found} == ({0, 1} if head is None else {1})


def test_model_of_one_domain_has_nothing_to_decide(tiny_config: ModelConfig) -> None:
    found, expected = both(replace(tiny_config, domains=tiny_config.domains[:1]), None, pad=True, flip=True)
    assert [(answer.domain, answer.probability) for answer in found] == [(0, None)] * 3
    np.testing.assert_allclose(found[0].depth, expected[0].depth, atol=1e-4)


def test_there_is_no_relative_depth(tiny_config: ModelConfig) -> None:
    with pytest.raises(InputError, match="no relative depth"):
        ArrayForward(Brightness(tiny_config), False, True, "bicubic").relative(*PHOTOS[0])
