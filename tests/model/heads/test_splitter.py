from dataclasses import replace
from itertools import pairwise
from typing import Any, ClassVar

import pytest
import torch
from tests.model.heads.base import DOMAIN, HeadTester, build_head, decoder_features, scaled
from torch import Tensor
from torch.nn.functional import gelu

from zoedepth.config import INDOOR, OUTDOOR, Domain, ModelConfig, SplitterConfig
from zoedepth.model.decoder import DecoderFeatures
from zoedepth.model.heads.splitter import WINDOW_SIZES, bin_centers, draw_boxes, pool_windows, split
from zoedepth.model.zoedepth import ZoeDepth

TINY = SplitterConfig(
    n_seed_bins=2, embedding_width=8, hidden_width=8, seed_width=8, min_temperature=0.5, max_temperature=5.0
)
WINDOWS = replace(TINY, n_windows=3)
OPTIONS = {
    "softmax": TINY,
    "log-binomial": replace(TINY, probability="log-binomial"),
    "no-relative": replace(TINY, relative_input=False, bottleneck_factor=4),
    "thirds": replace(TINY, factor=3),
    "windows": WINDOWS,
}
LOG_BINOMIAL = {"probability": "log-binomial"}


class TestSplitterHead(HeadTester):
    TINY = TINY
    EXPORTED = (replace(WINDOWS, factor=3), replace(TINY, probability="log-binomial", relative_input=False))
    CHANGES: ClassVar[dict[str, tuple[Any, dict[str, Any]]]] = {
        "n_seed_bins": (3, {}),
        "factor": (3, {}),
        "embedding_width": (24, {}),
        "hidden_width": (24, {}),
        "seed_width": (24, {}),
        "relative_input": (False, {}),
        "probability": ("log-binomial", {}),
        "bottleneck_factor": (4, {}),
        "min_temperature": (1.0, LOG_BINOMIAL),
        "max_temperature": (50.0, LOG_BINOMIAL),
        "n_windows": (3, {}),
    }

    @pytest.fixture(params=list(OPTIONS))
    def config(self, request: pytest.FixtureRequest) -> SplitterConfig:
        return OPTIONS[request.param]


def flat_features(size: tuple[int, int] = (64, 96)) -> DecoderFeatures:
    """Maps that are the same everywhere."""
    features = decoder_features(size)
    flat = DecoderFeatures(*(x if isinstance(x, tuple) else x[:, :, :1, :1].expand_as(x) for x in features))
    return flat._replace(levels=tuple(x[:, :, :1, :1].expand_as(x) for x in features.levels))


# --- the bins ---------------------------------------------------------------------------------------------------------


def test_parts_of_a_bin_are_in_proportion_to_their_scores_by_hand():
    widths = torch.tensor([0.6, 0.4]).reshape(1, 2, 1, 1)
    scores = torch.tensor([2.999, 0.999, -5.0, 0.0]).reshape(1, 4, 1, 1)  # with 0.001 more: 3 to 1, and 1 to 1
    assert split(widths, scores, factor=2).flatten().tolist() == pytest.approx([0.45, 0.15, 0.2, 0.2], rel=1e-5)


@pytest.mark.parametrize("factor", [2, 3])
def test_split_bins_are_as_wide_together_as_their_parent(factor: int):
    torch.manual_seed(0)
    widths, scores = torch.rand(2, 5, 3, 4), 4 * torch.randn(2, 5 * factor, 3, 4)
    children = split(widths, scores, factor=factor)
    assert children.shape == (2, 5 * factor, 3, 4)
    assert (children > 0).all()
    for parent in range(5):
        together = sum(children[:, parent * factor + i] for i in range(factor))
        assert torch.allclose(together, widths[:, parent], atol=1e-6)


@pytest.mark.parametrize("factor", [2, 3])
def test_every_level_has_a_multiple_of_the_bins_before_and_fills_the_range(factor: int):
    torch.manual_seed(0)
    head = build_head(replace(TINY, factor=factor))
    features = head.shared(decoder_features((64, 96)))
    levels = head.domain.bins(features.bottleneck, features.embeddings)
    assert [x.shape[1] for x in levels] == [2 * factor, 2 * factor**2, 2 * factor**3, 2 * factor**4]
    assert [tuple(x.shape[-2:]) for x in levels] == [(4, 6), (8, 12), (16, 24), (32, 48)]
    for widths in levels:
        total = widths.sum(dim=1)
        assert (widths > 0).all()
        assert torch.allclose(total, torch.ones_like(total), atol=1e-5)


def test_where_nothing_is_upsampled_bins_stay_inside_their_parents():
    """Of flat maps: edges of a level are among those of the next."""
    head, features = build_head(TINY), flat_features()
    shared = head.shared(features)
    edges = [x[0, :, 0, 0].cumsum(dim=0) for x in head.domain.bins(shared.bottleneck, shared.embeddings)]
    for coarse, fine in pairwise(edges):
        assert torch.allclose(fine[1::2], coarse, atol=1e-5)


def test_centers_by_hand():
    widths = torch.tensor([0.5, 0.25, 0.25]).reshape(1, 3, 1, 1)
    domain = Domain("indoor", 1.0, 9.0)  # edges 1, 5, 7, 9
    assert bin_centers(widths, domain).flatten().tolist() == pytest.approx([3.0, 6.0, 8.0])
    # With the nearest depth behind the widths: edges 4, 6, 8, 9.
    assert bin_centers(widths, domain, front_padding=False).flatten().tolist() == pytest.approx([5.0, 7.0, 8.5])


def test_bins_begin_at_the_nearest_and_end_at_the_farthest_depth():
    head, features = build_head(TINY), decoder_features((64, 64))
    shared = head.shared(features)
    widths = head.domain.bins(shared.bottleneck, shared.embeddings)[-1]
    centers = bin_centers(widths, DOMAIN)
    metres = widths * (DOMAIN.max_depth - DOMAIN.min_depth)
    assert torch.allclose(centers[:, 0] - metres[:, 0] / 2, torch.tensor(DOMAIN.min_depth), atol=1e-5)
    assert torch.allclose(centers[:, -1] + metres[:, -1] / 2, torch.tensor(DOMAIN.max_depth), atol=1e-5)
    # Neighbours meet: no gap, no overlap, nothing shifted by a part of a bin.
    ends, begins = (centers + metres / 2)[:, :-1], (centers - metres / 2)[:, 1:]
    assert torch.allclose(ends, begins, atol=1e-5)


def test_single_pixel_of_a_head_by_hand():
    """All maps constant, so that upsampling does nothing: the whole head is arithmetic on one pixel."""
    head, features = build_head(TINY), flat_features()
    pixel = [x[:1, :, :1, :1] for x in (features.bottleneck, *features.levels)]
    shared, domain = head.shared, head.domain
    bottleneck = shared.bottleneck(pixel[0])
    embeddings = [shared.projectors.seed(bottleneck)]
    embeddings += [project(x) for project, x in zip(shared.projectors.levels, pixel[1:], strict=True)]
    widths = [max(score, 0) + 1e-3 for score in domain.bins.seed(bottleneck).flatten().tolist()]
    widths = [width / sum(widths) for width in widths]
    for i, splitter in enumerate(domain.bins.splitters):
        scores = splitter(embeddings[i] + embeddings[i + 1]).flatten().tolist()
        parts = [max(score, 0) + 1e-3 for score in scores]
        widths = [
            width * parts[2 * k + j] / (parts[2 * k] + parts[2 * k + 1])
            for k, width in enumerate(widths)
            for j in range(2)
        ]
    edges = [0.5 + 7.5 * sum(widths[:i]) for i in range(len(widths) + 1)]
    centers = [(edges[i] + edges[i + 1]) / 2 for i in range(len(widths))]
    inputs = torch.cat([features.last[:1, :, :1, :1], features.relative[:1, :, :1, :1], embeddings[-1]], dim=1)
    probability = domain.probability([inputs], torch.ones(1, 1, 1, 1)).probability.flatten().tolist()
    output = head(features)
    assert output.distribution.bin_centers[0, :, 5, 7].tolist() == pytest.approx(centers, abs=1e-5)
    expected = sum(p * c for p, c in zip(probability, centers, strict=True))
    assert output.depth[0, 0, 5, 7].item() == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(("n_seed_bins", "n_bins"), [(4, 64), (16, 256)])
def test_default_head_has_the_64_bins_of_zoedepth_and_the_native_one_256(n_seed_bins: int, n_bins: int):
    assert SplitterConfig().n_seed_bins == 4
    head = build_head(replace(TINY, n_seed_bins=n_seed_bins))
    assert head.domain.bins.n_bins == n_bins
    assert head(decoder_features((32, 32))).distribution.bin_centers.shape[1] == n_bins


def test_mlps_are_two_convolutions_with_a_gelu_between():
    head = build_head(TINY)
    for mlp in (head.shared.projectors.seed, *head.shared.projectors.levels, *head.domain.bins.splitters):
        first, last = mlp[0], mlp[-1]
        x = 3 * torch.randn(2, first.in_channels, 2, 3)
        torch.testing.assert_close(mlp(x), last(gelu(first(x))))


# --- windows ----------------------------------------------------------------------------------------------------------


def test_boxes_are_whole_pixels_inside_the_photo_smallest_first():
    torch.manual_seed(0)
    boxes = draw_boxes(torch.zeros(3, 1, 48, 64), stride=2, n_windows=40)
    assert boxes.shape == (3, 200, 4)
    pixels = boxes.double() * torch.tensor([128.0, 96.0, 128.0, 96.0])
    assert torch.allclose(pixels, pixels.round(), atol=1e-4)
    left, top, right, bottom = pixels.round().long().unbind(dim=2)
    sides = torch.tensor(WINDOW_SIZES).repeat_interleave(40).expand(3, -1)
    assert torch.equal(right - left, sides)
    assert torch.equal(bottom - top, sides)
    assert min(left.min(), top.min()) >= 0
    assert right.max() <= 128
    assert bottom.max() <= 96
    assert not torch.equal(boxes[0], boxes[1])


def test_boxes_are_anywhere_up_to_the_borders():
    torch.manual_seed(0)
    boxes = draw_boxes(torch.zeros(1, 1, 16, 16), stride=2, n_windows=2000)[0, :2000]
    starts = (boxes[:, :2] * 32).round().long()
    for places in starts.unbind(dim=1):
        counts = places.bincount(minlength=30)
        assert len(counts) == 30, "from 0 to 29: a window of 3 in 32"
        assert counts.min() > 30, "alike: 67 on average"


def test_windows_are_no_larger_than_the_photo():
    boxes = draw_boxes(torch.zeros(2, 1, 16, 64), stride=2, n_windows=4)
    assert boxes.min() >= 0
    assert boxes.max() <= 1
    assert torch.allclose(boxes[:, -4:, 1], torch.zeros(2, 4))  # all of its 32 rows
    assert torch.allclose(boxes[:, -4:, 3], torch.ones(2, 4))


def test_pooled_window_is_the_mean_inside_it():
    """Of maps that rise evenly to the right or down, it is the value at the window's middle."""
    columns = ((torch.arange(32) + 0.5) / 32).expand(1, 1, 24, 32)
    rows = ((torch.arange(24) + 0.5) / 24)[:, None].expand(1, 1, 24, 32)
    maps = torch.cat([columns, rows], dim=1)
    boxes = torch.tensor([[[0.1, 0.2, 0.4, 0.3], [0.5, 0.5, 0.9, 0.9]]])
    pooled = pool_windows(torch.cat([maps, 10 + maps]), boxes.expand(2, 2, 4))
    assert pooled.shape == (2, 2, 2, 1)
    middles = torch.tensor([[0.25, 0.7], [0.25, 0.7]])  # of the columns of both windows, then of the rows
    assert torch.allclose(pooled[0, :, :, 0], middles, atol=1e-5)
    assert torch.allclose(pooled[1, :, :, 0], 10 + middles, atol=1e-4)
    assert pool_windows(maps.bfloat16(), boxes).dtype == torch.bfloat16


def test_windows_of_a_flat_photo_have_the_bins_of_its_pixels_at_every_level():
    head, features = build_head(WINDOWS), flat_features()
    bins = head(features).supervision.window_bins
    assert bins.boxes.shape == (2, 15, 4)
    left, top, right, bottom = (bins.boxes * torch.tensor([96.0, 64.0, 96.0, 64.0])).unbind(dim=2)
    sides = torch.tensor(WINDOW_SIZES).repeat_interleave(3).expand(2, -1).float()
    assert torch.allclose(right - left, sides, atol=1e-4), "pixels of the photo"
    assert torch.allclose(bottom - top, sides, atol=1e-4)
    shared = head.shared(features)
    levels = head.domain.bins(shared.bottleneck, shared.embeddings)
    assert [x.shape for x in bins.centers] == [(2, 15, n) for n in (4, 8, 16, 32)]
    for found, widths in zip(bins.centers, levels, strict=True):
        expected = bin_centers(widths, DOMAIN)[:, None, :, 0, 0].expand_as(found)
        assert torch.allclose(found, expected, atol=1e-4)


def test_window_sees_its_own_place():
    """Maps of which each half is flat: windows inside of a half have its bins."""
    torch.manual_seed(0)
    head, left = build_head(replace(WINDOWS, n_windows=30)), flat_features((64, 256))
    right = scaled(left, -1.0)

    def halves(one: Tensor, other: Tensor) -> Tensor:
        return torch.where(torch.arange(one.shape[-1]) < one.shape[-1] // 2, one, other)

    both = left._replace(
        bottleneck=halves(left.bottleneck, right.bottleneck),
        levels=tuple(map(halves, left.levels, right.levels)),
    )
    boxes, centers = head(both).supervision.window_bins
    for features, inside in ((left, boxes[..., 2] < 0.4), (right, boxes[..., 0] > 0.6)):
        assert inside.sum() > 50
        shared = head.shared(features)
        expected = bin_centers(head.domain.bins(shared.bottleneck, shared.embeddings)[-1], DOMAIN)[..., 0, 0]
        for image in range(2):
            found = centers[-1][image][inside[image]]
            assert torch.allclose(found, expected[image].expand_as(found), atol=1e-4)


def test_windows_are_drawn_in_training_only_and_only_where_asked_for():
    head, features = build_head(WINDOWS), decoder_features((64, 64))
    assert head(features).supervision.window_bins is not None
    assert head.eval()(features).supervision.window_bins is None
    assert build_head(TINY)(features).supervision.window_bins is None


def test_windows_leave_the_depth_as_it_is():
    features = decoder_features((64, 64))
    assert torch.equal(build_head(WINDOWS)(features).depth, build_head(TINY)(features).depth)


def test_windows_of_half_precision_maps_are_close():
    head, features = build_head(WINDOWS), decoder_features((64, 64))
    torch.manual_seed(0)
    exact = head(features).supervision.window_bins
    torch.manual_seed(0)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        rough = head(features).supervision.window_bins
    assert torch.equal(exact.boxes, rough.boxes)
    for x, y in zip(exact.centers, rough.centers, strict=True):
        assert y.dtype == torch.float32
        assert (x - y).abs().mean() < 0.05


def test_windows_go_with_their_images_to_the_heads_of_their_domains_and_back(tiny_config: ModelConfig):
    torch.manual_seed(0)
    model = ZoeDepth(replace(tiny_config, head=WINDOWS, domains=(INDOOR, OUTDOOR)))
    output = model(torch.rand(3, 3, 64, 96), domain=torch.tensor([1, 0, 1]))
    boxes, centers = output.supervision.window_bins
    assert boxes.shape == (3, 15, 4)
    assert [x.shape for x in centers] == [(3, 15, n) for n in (4, 8, 16, 32)]
    reach = centers[-1][:, :, -1].mean(dim=1)
    assert (reach[[0, 2]] > 40).all(), "the last bin of a range of 80 m"
    assert reach[1] < 10
