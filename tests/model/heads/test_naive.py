from dataclasses import replace
from typing import Any, ClassVar

import pytest
import torch
from tests.model.heads.base import HeadTester, build_head, decoder_features

from zoedepth.config import NaiveConfig

TINY = NaiveConfig(width=6)


class TestNaiveHead(HeadTester):
    TINY = TINY
    BOUNDED = False
    HAS_BINS = False
    CHANGES: ClassVar[dict[str, tuple[Any, dict[str, Any]]]] = {
        "width": (7, {}),
        "relative_input": (False, {}),
        "initial_depth": (3.0, {}),
    }


@pytest.mark.parametrize("metres", [0.5, 2.0, 30.0])
def test_new_head_says_its_initial_depth(metres: float):
    depth = build_head(replace(TINY, initial_depth=metres))(decoder_features((64, 64))).depth
    assert torch.allclose(depth, torch.tensor(metres), rtol=0.05)


def test_relative_depth_matters_only_where_it_is_an_input():
    features = decoder_features((32, 32))
    nearer = features._replace(relative=features.relative + 1)
    for relative_input in (True, False):
        head = build_head(replace(TINY, relative_input=relative_input))
        assert torch.equal(head(features).depth, head(nearer).depth) != relative_input


def test_pixel_by_hand():
    """Softplus of the 1x1 convolution of the ReLU of the 3x3 convolution of the joined maps."""
    head, features = build_head(TINY), decoder_features((32, 32), batch=1)
    x = torch.cat([features.last, features.relative], dim=1)[0, :, 4:7, 8:11]
    hidden = (torch.einsum("ocij,cij->o", head.domain.conv1.weight, x) + head.domain.conv1.bias).relu()
    score = (head.domain.conv2.weight[0, :, 0, 0] @ hidden + head.domain.conv2.bias).item()
    assert head(features).depth[0, 0, 5, 9].item() == pytest.approx(torch.tensor(score).exp().log1p().item(), rel=1e-5)
