from dataclasses import replace
from typing import Any, ClassVar

import pytest
import torch
from tests.model.heads.base import DOMAIN, HeadTester, build_head, decoder_features, scaled
from torch import nn
from torch.nn.functional import leaky_relu

from zoedepth.config import AdaBinsConfig
from zoedepth.model.heads.adabins import ImageBins, PatchTokens, enough, image_centers, stretched

TINY = AdaBinsConfig(n_bins=6, width=8, patch=4, n_layers=1, attention_heads=2, feedforward_width=16, n_queries=8)


FEW_TOKENS = replace(TINY, n_queries=200)


class TestAdaBinsHead(HeadTester):
    TINY = TINY
    EXPORTED = (TINY, FEW_TOKENS)
    CHANGES: ClassVar[dict[str, tuple[Any, dict[str, Any]]]] = {
        "n_bins": (7, {}),
        "width": (16, {}),
        "patch": (8, {}),
        "n_layers": (2, {}),
        "attention_heads": (4, {}),
        "feedforward_width": (24, {}),
        "n_queries": (9, {}),
    }

    @pytest.fixture(params=[TINY, FEW_TOKENS], ids=["enough tokens", "fewer tokens than queries"])
    def config(self, request: pytest.FixtureRequest) -> AdaBinsConfig:
        return request.param


def test_an_image_has_one_set_of_bins_which_its_loss_sees():
    output = build_head(TINY).eval()(scaled(decoder_features((64, 96)), 10.0))
    assert (output.distribution.bin_centers == output.distribution.bin_centers[:, :, :1, :1]).all()
    assert torch.equal(output.supervision.image_bins, output.distribution.bin_centers[:, :, 0, 0])
    assert not torch.equal(*output.supervision.image_bins), "another image has others"


def test_bins_fill_the_range_in_proportion_to_their_scores():
    """Scores of -5, 0.1 and 0.6: widths of 0.1, 0.2 and 0.7 of the range from 0.5 to 8 m."""
    centers = image_centers(torch.tensor([[-5.0, 0.1, 0.6]]), DOMAIN)
    assert centers[0].tolist() == pytest.approx([0.5 + 7.5 * x for x in (0.05, 0.2, 0.65)])


def test_first_token_is_for_the_bins_and_the_next_are_kernels():
    head = build_head(TINY).eval()
    bins, features = head.domain.bins, decoder_features((64, 96), batch=1)
    x = head.domain.project(features.levels[-1])
    tokens = bins.tokens(x)
    centers = image_centers(bins.widths(tokens[:, 0]), DOMAIN)[0]
    pixel = bins.features(x)[0, :, 5, 7]
    answers = torch.stack([tokens[0, 1 + i] @ pixel for i in range(8)])
    scores = bins.probability.weight[:, :, 0, 0] @ answers + bins.probability.bias
    assert head(features).depth[0, 0, 5, 7].item() == pytest.approx((scores.softmax(0) @ centers).item(), rel=1e-4)


def test_widths_come_from_three_layers_with_leaky_relus_between():
    widths, x = build_head(TINY).domain.bins.widths, torch.randn(3, 8)
    first, second, third = (layer for layer in widths if isinstance(layer, nn.Linear))
    expected = third(leaky_relu(second(leaky_relu(first(x), 0.01)), 0.01))
    torch.testing.assert_close(widths(x), expected)


@pytest.mark.parametrize(("grid", "n_tokens"), [((3, 3), 9), ((2, 4), 15)])
def test_there_is_a_token_for_the_bins_and_for_each_query(grid: tuple[int, int], n_tokens: int):
    """Eight queries need nine tokens: a grid of that many patches stays, one of eight is made finer."""
    bins = ImageBins(
        3, DOMAIN, n_bins=6, width=8, patch=4, n_layers=1, attention_heads=2, feedforward_width=16, n_queries=8
    )
    x = torch.randn(1, 3, 4 * grid[0], 4 * grid[1])
    assert bins.tokens(x).shape == (1, n_tokens, 8)
    assert bins(x).depth.shape[-2:] == x.shape[-2:]


def test_tokens_are_the_patches_row_by_row_with_their_positions():
    torch.manual_seed(0)
    tokens = PatchTokens(3, width=8, patch=4, n_layers=1, attention_heads=2, feedforward_width=16, min_tokens=5).eval()
    tokens.transformer = nn.Identity()
    x = torch.randn(2, 3, 8, 12)  # 2 x 3 patches of 4 x 4
    found = tokens(x)
    assert found.shape == (2, 6, 8)
    for i, (row, column) in enumerate([(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)]):
        patch = x[:, :, 4 * row : 4 * row + 4, 4 * column : 4 * column + 4]
        expected = torch.einsum("bcij,ocij->bo", patch, tokens.embed.weight) + tokens.embed.bias + tokens.positions[i]
        assert torch.allclose(found[:, i], expected, atol=1e-5)


@pytest.mark.parametrize(
    ("grid", "n", "wanted"), [((12, 16), 129, (12, 16)), ((3, 4), 48, (6, 8)), ((1, 1), 129, (12, 12))]
)
def test_grid_has_enough_tokens(grid: tuple[int, int], n: int, wanted: tuple[int, int]):
    assert enough(*grid, n) == wanted


def test_positions_are_the_first_rows_or_stretched():
    table = torch.tensor([[0.0], [2.0], [4.0]])
    assert stretched(table, 2).flatten().tolist() == [0, 2]
    assert stretched(table, 5).flatten().tolist() == pytest.approx([0, 1, 2, 3, 4])
