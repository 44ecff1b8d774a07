import math
from dataclasses import replace
from typing import Any, ClassVar

import pytest
import torch
from tests.model.heads.base import CHANNELS, DOMAIN, HeadTester, build_head, decoder_features, scaled
from torch.nn.functional import conv2d, elu

from zoedepth.config import BtsConfig
from zoedepth.model.heads.bts import BtsHead, PlanarGuidance, narrowing, planar_depth, plane_coefficients

TINY = BtsConfig(widths=(16, 12, 8), width=8)


class TestBtsHead(HeadTester):
    TINY = TINY
    BOUNDED = False  # below the nearest depth: a sigmoid starts at 0
    HAS_BINS = False
    CHANGES: ClassVar[dict[str, tuple[Any, dict[str, Any]]]] = {"widths": ((16, 12, 9), {}), "width": (16, {})}


def test_depth_is_at_most_the_farthest_and_at_the_size_of_the_last_map():
    for stride in (1, 2):
        head = build_head(TINY)
        depth = head(scaled(decoder_features((64, 96), output_stride=stride), 30.0)).depth
        assert depth.shape == (2, 1, 64 // stride, 96 // stride)
        assert (depth <= DOMAIN.max_depth).all()
    far = BtsHead(CHANNELS, TINY, replace(DOMAIN, max_depth=80.0))
    far.load_state_dict(head.domain.state_dict())
    features = decoder_features((64, 96))
    assert torch.allclose(far(features).depth, 10 * head(features).depth)


@torch.no_grad()
def test_depth_by_hand():
    """Planes of three levels at the size of the photo, joined with the last map, and two convolutions without bias."""
    head, features = build_head(TINY), decoder_features((64, 96))
    bts, planes = head.domain, []
    for guide, level, x in zip(bts.guidance, bts.levels, features.levels[1:], strict=True):
        planes.append(guide(elu(conv2d(x, level[0].weight, padding=1))))
        assert planes[-1].shape == (2, 1, 64, 96)
    x = elu(conv2d(torch.cat([features.last, *planes], dim=1), bts.fuse[0].weight, padding=1))
    torch.testing.assert_close(head(features).depth, 8 * conv2d(x, bts.depth.weight, padding=1).sigmoid())


@pytest.mark.parametrize("factor", [2, 4, 8])
def test_planes_are_a_plain_loop_over_the_fine_pixels(factor: int):
    torch.manual_seed(0)
    planes = plane_coefficients(torch.randn(2, 3, 3, 4))
    depth = planar_depth(planes, factor=factor)
    assert depth.shape == (2, 1, 3 * factor, 4 * factor)
    for b, y, x in [(0, 0, 0), (1, 1, 2), (0, factor, 3 * factor + 1), (1, 3 * factor - 1, 4 * factor - 1)]:
        n1, n2, n3, distance = planes[b, :, y // factor, x // factor].tolist()
        u = (x % factor - (factor - 1) / 2) / factor
        v = (y % factor - (factor - 1) / 2) / factor
        assert depth[b, 0, y, x].item() == pytest.approx(distance / (n1 * u + n2 * v + n3), rel=1e-5)


def test_a_plane_that_faces_the_camera_is_at_one_depth():
    planes = torch.tensor([0.0, 0.0, 1.0, 0.3])[None, :, None, None].expand(1, 4, 2, 3)
    assert torch.allclose(planar_depth(planes, factor=8), torch.full((1, 1, 16, 24), 0.3))


def test_a_plane_that_leans_to_one_side_changes_along_the_columns_only():
    # (u = -1/4, 1/4): 0.5 / (0.6 u + 0.8) is 0.5 / 0.65, 0.5 / 0.95
    planes = torch.tensor([0.6, 0.0, 0.8, 0.5])[None, :, None, None]
    expected = [[0.5 / 0.65, 0.5 / 0.95]] * 2
    assert torch.allclose(planar_depth(planes, factor=2)[0, 0], torch.tensor(expected))


def test_plane_coefficients_are_a_unit_normal_and_a_fraction():
    middle = plane_coefficients(torch.zeros(1, 3, 1, 1)).flatten().tolist()
    # theta = 30 degrees, phi = 180 degrees
    assert middle == pytest.approx([-0.5, 0.0, math.sqrt(0.75), 0.5], abs=1e-6)
    n1, n2, n3, distance = plane_coefficients(20 * torch.randn(4, 3, 5, 5)).unbind(dim=1)
    assert torch.allclose(n1**2 + n2**2 + n3**2, torch.ones(4, 5, 5), atol=1e-5)
    assert (n3 >= 0.5 - 1e-6).all(), "tilted by 60 degrees at most"
    assert ((distance >= 0) & (distance <= 1)).all()


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [
        ((128, 128, 3), [(128, 128), (128, 64), (64, 32), (32, 16), (16, 8), (8, 3)]),
        ((128, 64, 3), [(128, 64), (64, 32), (32, 16), (16, 8), (8, 3)]),
        ((32, 16, 1), [(32, 16), (16, 8), (8, 1)]),
        ((24, 12, 1), [(24, 12), (12, 1)]),
    ],
)
def test_channels_are_halved_down_to_eight(sizes: tuple[int, int, int], expected: list[tuple[int, int]]):
    convolutions = [layer for layer in narrowing(*sizes) if isinstance(layer, torch.nn.Conv2d)]
    assert [(layer.in_channels, layer.out_channels) for layer in convolutions] == expected
    assert all(layer.bias is None and layer.kernel_size == (1, 1) for layer in convolutions)


def test_guidance_is_float32_under_autocast():
    guide, x = PlanarGuidance(8, 8, factor=4), torch.randn(1, 8, 3, 3)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        depth = guide(x)
    assert depth.dtype == torch.float32
    assert torch.allclose(depth, guide(x), rtol=0.05)
