from dataclasses import replace
from typing import Any, ClassVar

import pytest
import torch
from tests.model.heads.base import CHANNELS, DOMAIN, Head, HeadTester, build_head, decoder_features
from torch import nn
from torch.nn.functional import adaptive_avg_pool2d, conv2d, gelu, interpolate

from zoedepth.build import without_memory
from zoedepth.config import Domain, NewCrfsConfig
from zoedepth.errors import InputError
from zoedepth.model.decoder import DecoderChannels
from zoedepth.model.heads.newcrfs import (
    CrfBlock,
    CrfLevel,
    NewCrfsHead,
    PyramidPooling,
    WindowAttention,
    from_windows,
    pad_to_windows,
    relative_positions,
    same_side_of_the_wrap,
    to_windows,
    window_attention,
)

TINY = NewCrfsConfig(widths=(16, 16, 8, 8), attention_heads=(4, 2, 2, 1), window=3, seed_width=8)
OPTIONS = {
    "paper": TINY,
    "native": replace(TINY, pyramid_pooling=True, window=7),
    "one-block": replace(TINY, n_blocks=1, window=2),
}


class TestNewCrfsHead(HeadTester):
    TINY = TINY
    BOUNDED = False  # from above only
    HAS_BINS = False
    EXPORTED = (OPTIONS["native"],)
    CHANGES: ClassVar[dict[str, tuple[Any, dict[str, Any]]]] = {
        "widths": ((16, 16, 8, 16), {}),
        "attention_heads": ((4, 2, 2, 2), {}),
        "window": (4, {}),
        "n_blocks": (3, {}),
        "seed_width": (16, {}),
        "pyramid_pooling": (True, {}),
    }

    @pytest.fixture(params=list(OPTIONS))
    def config(self, request: pytest.FixtureRequest) -> NewCrfsConfig:
        return OPTIONS[request.param]

    def shorten(self, head: Head) -> None:
        """Keep the blocks of the level with the most windows, a plain and a shifted one; the others repeat them."""
        for level in head.domain.crfs.levels[:-1]:
            del level.blocks[:]


def count(config: NewCrfsConfig) -> dict[str, int]:
    """Parameters of the parts of a head on 256 channels at every level."""
    with without_memory():
        head = NewCrfsHead(DecoderChannels(256, (256, 256, 256, 256), 32), config, DOMAIN)
    parts = {"seed": head.crfs.seed, "levels": head.crfs.levels, "depth": head.depth}
    return {name: sum(p.numel() for p in part.parameters()) for name, part in parts.items()}


def test_number_of_parameters_at_the_papers_size():
    """The four levels have 40.81 M, the paper's "40 M"; pyramid pooling adds 11.15 M, one convolution 0.13 M."""
    assert count(NewCrfsConfig()) == {"seed": 131_584, "levels": 40_812_600, "depth": 1_153}
    assert count(NewCrfsConfig(pyramid_pooling=True)) == {"seed": 11_146_240, "levels": 40_812_600, "depth": 1_153}
    assert 40_812_600 + 11_146_240 == 51_958_840
    with without_memory():
        head = NewCrfsHead(DecoderChannels(256, (256, 256, 256, 256), 32), NewCrfsConfig(), DOMAIN)
    levels = [sum(p.numel() for p in level.parameters()) / 1e6 for level in head.crfs.levels]
    assert levels == pytest.approx([30.19, 8.15, 1.75, 0.73], abs=0.01)


# --- windows ----------------------------------------------------------------------------------------------------------


def test_windows_are_cut_and_joined_row_by_row():
    x = torch.arange(2 * 4 * 6).reshape(1, 8, 6, 1)[:, :4]
    windows = to_windows(x, 2)
    assert windows.shape == (1, 6, 4, 1)
    assert windows[0, 0].flatten().tolist() == [0, 1, 6, 7]
    assert windows[0, 2].flatten().tolist() == [4, 5, 10, 11]
    assert windows[0, 3].flatten().tolist() == [12, 13, 18, 19]
    assert torch.equal(from_windows(windows, (4, 6), 2), x)
    y = torch.randn(3, 14, 21, 5)
    assert torch.equal(from_windows(to_windows(y, 7), (14, 21), 7), y)


@pytest.mark.parametrize(("side", "padded"), [(1, 7), (7, 7), (8, 14), (14, 14)])
def test_maps_are_padded_at_the_right_and_at_the_bottom(side: int, padded: int):
    x = torch.ones(1, side, 7, 2)
    y = pad_to_windows(x, 7)
    assert y.shape == (1, padded, 7, 2)
    assert torch.equal(y[:, :side], x)
    assert not y[:, side:].any()
    assert torch.equal(pad_to_windows(x.transpose(1, 2), 7), y.transpose(1, 2))


def test_relative_position_is_the_same_for_equal_offsets():
    rows = relative_positions(3)
    assert rows.shape == (9, 9)
    for i in range(9):
        for j in range(9):
            down, right = i // 3 - j // 3, i % 3 - j % 3
            assert rows[i, j] == 5 * (down + 2) + right + 2
    assert sorted(set(rows.flatten().tolist())) == list(range(25))


@pytest.mark.parametrize(("size", "window", "shift"), [((6, 9), 3, 1), ((7, 7), 7, 3), ((8, 4), 4, 2)])
def test_tokens_see_each_other_only_where_they_were_neighbours(size: tuple[int, int], window: int, shift: int):
    """Two tokens of a shifted window may look at each other if no border of the map was between them."""
    rows, columns = torch.meshgrid(*(torch.arange(side) for side in size), indexing="ij")
    place = torch.stack([rows, columns], dim=-1)[None].roll((-shift, -shift), dims=(1, 2))
    windows = to_windows(place, window)[0]
    allowed = same_side_of_the_wrap(size, window, shift)
    assert allowed.shape == (len(windows), 1, window**2, window**2)
    for places, matrix in zip(windows.tolist(), allowed[:, 0].tolist(), strict=True):
        for i, one in enumerate(places):
            for j, other in enumerate(places):
                near = all(abs(a - b) < window for a, b in zip(one, other, strict=True))
                # Where one window is the whole map, those at both ends are near, and still the wrap is between them.
                wrapped = any((a < shift) != (b < shift) and side == window
                              for a, b, side in zip(one, other, size, strict=True))  # fmt: skip
                assert matrix[i][j] == (near and not wrapped)


# --- attention --------------------------------------------------------------------------------------------------------


def test_attention_of_one_window_against_a_plain_loop():
    torch.manual_seed(0)
    q, k, v = torch.randn(3, 1, 1, 2, 4, 3, dtype=torch.float64)
    bias = torch.randn(2, 4, 4, dtype=torch.float64)
    allowed = torch.rand(1, 1, 4, 4) < 0.6
    allowed[:, :, range(4), range(4)] = True
    for mask in (None, allowed):
        output = window_attention(q, k, v, bias, mask)
        for head in range(2):
            for i in range(4):
                seen = [j for j in range(4) if mask is None or mask[0, 0, i, j]]
                weights = [
                    (sum(q[0, 0, head, i, c] * k[0, 0, head, j, c] for c in range(3)) / 3**0.5 + bias[head, i, j]).exp()
                    for j in seen
                ]
                for c in range(3):
                    values = [v[0, 0, head, j, c] for j in seen]
                    expected = sum(w * value for w, value in zip(weights, values, strict=True)) / sum(weights)
                    assert output[0, 0, head, i, c].item() == pytest.approx(expected.item(), abs=1e-6)


def test_softmax_is_in_float32():
    """Logits that bfloat16 cannot tell apart."""
    q = torch.zeros(1, 1, 1, 64, 2, dtype=torch.bfloat16)
    bias = 100 + torch.linspace(0, 1, 64).expand(1, 64, 64)
    v = torch.eye(64, dtype=torch.bfloat16)[None, None, None]
    weights = window_attention(q, q, v, bias, None)
    assert weights.dtype == torch.bfloat16
    assert torch.equal(weights, bias.softmax(dim=-1).bfloat16()[None, None])


def test_heads_are_neighbouring_channels_and_bias_is_by_relative_position():
    """A window of 2x2, two heads; queries of zero, so that the bias alone decides."""
    attention = WindowAttention(4, n_heads=2, window=2)
    with torch.no_grad():
        attention.queries_keys.weight.zero_()
        attention.queries_keys.bias.zero_()
        attention.project.weight.copy_(torch.eye(4))
        attention.project.bias.zero_()
        attention.bias_table.fill_(-1e4)
        attention.bias_table[4, 0] = 0  # head 0 looks at itself,
        attention.bias_table[3, 1] = 0  # head 1 at its right neighbour, one to the right of it
    v = torch.arange(16.0).reshape(1, 1, 4, 4)
    output = attention(torch.randn(1, 1, 4, 4), v, None)
    assert torch.equal(output[..., :2], v[..., :2])
    assert torch.equal(output[0, 0, 0, 2:], v[0, 0, 1, 2:])
    assert torch.equal(output[0, 0, 2, 2:], v[0, 0, 3, 2:])


def seen_by(block: nn.Module, size: tuple[int, int], pixel: tuple[int, int]) -> set[tuple[int, int]]:
    """The places whose values reach a pixel of the result."""
    torch.manual_seed(0)
    x, v = torch.randn(1, *size, 4), torch.randn(1, *size, 4, requires_grad=True)
    block(x, v)[0, pixel[0], pixel[1]].square().sum().backward()
    assert v.grad is not None
    return {(i, j) for i, j in (v.grad[0].abs().sum(-1) > 0).nonzero().tolist()}


def test_a_block_sees_its_window_and_a_shifted_one_not_across_the_wrap():
    def area(rows: range, columns: range) -> set[tuple[int, int]]:
        return {(i, j) for i in rows for j in columns}

    plain = CrfBlock(4, n_heads=1, window=3, shift=0)
    shifted = CrfBlock(4, n_heads=1, window=3, shift=1)
    assert seen_by(plain, (6, 6), (0, 4)) == area(range(3), range(3, 6))
    # Windows begin at 1 and 4; what is left are the first row and column, the last two, and corners of them.
    assert seen_by(shifted, (6, 6), (1, 1)) == area(range(1, 4), range(1, 4))
    assert seen_by(shifted, (6, 6), (0, 2)) == area(range(1), range(1, 4))
    assert seen_by(shifted, (6, 6), (0, 0)) == {(0, 0)}
    assert seen_by(shifted, (6, 6), (5, 5)) == area(range(4, 6), range(4, 6))
    # Not whole windows: padding comes first, and goes.
    assert seen_by(shifted, (5, 4), (0, 0)) == {(0, 0)}
    assert seen_by(shifted, (5, 4), (4, 3)) == {(4, j) for j in (1, 2, 3)}
    # One window holds all.
    assert seen_by(shifted, (3, 3), (2, 0)) == {(1, 0), (2, 0)}


def test_both_blocks_are_given_the_same_values():
    torch.manual_seed(0)
    level = CrfLevel(8, 8, 8, n_heads=2, window=3, n_blocks=2)
    given = []
    for block in level.blocks:
        block.register_forward_pre_hook(lambda _, inputs: given.append(inputs[1]))
    v = torch.randn(1, 8, 5, 4)
    level(torch.randn(1, 8, 5, 4), v)
    assert len(given) == 2
    assert all(torch.equal(values, v.permute(0, 2, 3, 1)) for values in given)


def test_every_second_block_is_shifted_by_half_a_window():
    level = CrfLevel(8, 8, 8, n_heads=2, window=7, n_blocks=4)
    assert [block.shift for block in level.blocks] == [0, 3, 0, 3]


def test_new_biases_are_small_random_numbers():
    torch.manual_seed(0)
    assert WindowAttention(8, n_heads=4, window=7).bias_table.std().item() == pytest.approx(0.02, rel=0.2)


def test_a_level_by_hand():
    """Window of the whole map, one token: attention gives the value itself, and all is arithmetic on one pixel."""
    torch.manual_seed(0)
    level = CrfLevel(3, 2, 4, n_heads=2, window=2, n_blocks=1)
    x, v = torch.randn(1, 3, 1, 1), torch.randn(1, 2, 1, 1)
    block = level.blocks[0]
    here = level.features(x).flatten()
    # Three of the four tokens are padding: their keys are the bias of the keys, their values nothing.
    attention = block.attention
    keys = attention.queries_keys(torch.cat([block.norm1(here)[None], torch.zeros(3, 4)]))
    weight = []
    for head in range(2):
        channels = slice(2 * head, 2 * head + 2)
        q, k = keys[0, :4][channels], keys[:, 4:][:, channels]
        logits = (k @ q) / 2**0.5 + attention.bias_table[[4, 3, 1, 0], head]
        weight += 2 * [logits.softmax(0)[0]]
    here = here + attention.project(torch.stack(weight) * level.values(v).flatten())
    widen, narrow = block.mlp[0], block.mlp[-1]
    here = here + narrow(gelu(widen(block.norm2(here))))
    assert level(x, v).flatten().tolist() == pytest.approx(level.norm(here).tolist(), abs=1e-5)


# --- the head ---------------------------------------------------------------------------------------------------------


def test_pixels_are_shuffled_between_levels():
    """Each level is given a quarter of the channels of the one before, at twice its size."""
    head = build_head(TINY)
    shapes = []
    for level in head.domain.crfs.levels:
        level.register_forward_pre_hook(lambda _, inputs: shapes.append([tuple(x.shape) for x in inputs]))
    head(decoder_features((64, 96)))
    assert shapes == [
        [(2, 10, 2, 3), (2, 8, 2, 3)],
        [(2, 8, 4, 6), (2, 4, 4, 6)],
        [(2, 6, 8, 12), (2, 4, 8, 12)],
        [(2, 5, 16, 24), (2, 2, 16, 24)],
    ]


def test_features_of_equal_width_are_taken_as_they_are():
    assert isinstance(CrfLevel(8, 2, 8, n_heads=1, window=2, n_blocks=1).features, nn.Identity)
    assert isinstance(CrfLevel(2, 8, 8, n_heads=1, window=2, n_blocks=1).values, nn.Identity)
    assert CrfLevel(2, 4, 8, n_heads=1, window=2, n_blocks=1).features.kernel_size == (3, 3)


@torch.no_grad()
def test_pyramid_pooling_on_a_constant_map_is_constant_inside():
    torch.manual_seed(0)
    pooling = PyramidPooling(6, 8).eval()
    assert [region[0].output_size for region in pooling.regions] == [1, 2, 3, 6]
    assert all(region[2].num_groups == 4 for region in pooling.regions)
    y = pooling(torch.randn(1, 6, 1, 1).expand(1, 6, 7, 9))[:, :, 1:-1, 1:-1]
    assert torch.allclose(y, y[:, :, :1, :1].expand_as(y), atol=1e-5)


@torch.no_grad()
def test_pyramid_pooling_by_hand():
    torch.manual_seed(0)
    pooling, x = PyramidPooling(6, 8).eval(), torch.randn(2, 6, 7, 9)
    maps = [x]
    for side, (_, conv, norm, *_) in zip((1, 2, 3, 6), pooling.regions, strict=True):
        pooled = norm(conv2d(adaptive_avg_pool2d(x, side), conv.weight)).relu()
        maps.append(interpolate(pooled, size=(7, 9), mode="bilinear", align_corners=False))
    conv, norm, *_ = pooling.join
    expected = norm(conv2d(torch.cat(maps, dim=1), conv.weight, padding=1)).relu()
    torch.testing.assert_close(pooling(x), expected)


@torch.no_grad()
def test_depth_is_a_share_of_the_farthest():
    head, features = build_head(TINY), decoder_features((64, 64))
    depth = head(features).depth
    assert depth.shape == (2, 1, 64, 64)
    assert ((depth > 0) & (depth < 8)).all()
    far = NewCrfsHead(CHANNELS, TINY, Domain("outdoor", 1e-3, 80.0))
    far.load_state_dict(head.domain.state_dict())
    assert torch.allclose(far(features).depth, 10 * depth, rtol=1e-5)
    head.domain.depth.conv.weight.zero_()
    head.domain.depth.conv.bias.zero_()
    assert torch.allclose(head(features).depth, torch.full((2, 1, 64, 64), 4.0))


@torch.no_grad()
def test_depth_is_interpolated_between_pixel_centers():
    """Logits of one bright column: the border repeats, as without alignment of corners."""
    head = build_head(TINY).domain.depth
    head.conv.weight.zero_()
    head.conv.bias.zero_()
    head.conv.weight[0, 0, 1, 1] = 1
    x = torch.zeros(1, 8, 1, 2)
    x[:, 0, :, 1] = 100
    assert head(x).depth[0, 0, 0].tolist() == pytest.approx([4, 4, 4.5, 5.5, 6.5, 7.5, 8, 8])


def test_config_refuses_what_makes_no_level():
    with pytest.raises(InputError, match=r"head\.widths must be multiples of 4"):
        NewCrfsConfig(widths=(1024, 512, 256, 126))
    with pytest.raises(InputError, match=r"head\.attention_heads must be divisors"):
        NewCrfsConfig(attention_heads=(32, 16, 8, 3))
    with pytest.raises(InputError, match=r"head\.seed_width must be a multiple of 2"):
        NewCrfsConfig(seed_width=511)
    with pytest.raises(InputError, match=r"head\.window must be at least 2"):
        NewCrfsConfig(window=1)
    with pytest.raises(InputError, match=r"head\.n_blocks must be at least 1"):
        NewCrfsConfig(n_blocks=0)
