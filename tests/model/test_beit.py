from typing import Any

import pytest
import timm
import torch

from zoedepth.errors import InputError
from zoedepth.model.beit import BeitNetwork, position_bias, relative_position_index, resize_position_table


def build(**changes: Any) -> BeitNetwork:
    """A random network of four blocks, every width as small as it goes."""
    torch.manual_seed(0)
    options = {"size": (64, 64), "taps": (0, 1, 2, 3), "width": 32, "depth": 4, "heads": 4, **changes}
    return BeitNetwork("beit_base_patch16_384", **options).eval()


@pytest.fixture(scope="module")
def network() -> BeitNetwork:
    network = build()
    with torch.no_grad():  # far from the small numbers it starts with, so that every part of a block shows
        for name, weight in network.named_parameters():
            if name.startswith("position_tables") or "gamma" in name or "bias" in name:
                weight.normal_()
            elif "attn" in name:
                weight.mul_(10)
    return network


def reference_tokens(network: BeitNetwork, pixels: torch.Tensor, block: int) -> torch.Tensor:
    """The tokens after ``block``, at the native size, by the formulas of BEiT over the network's weights."""
    x = torch.nn.functional.conv2d(pixels, network.patch_embed.weight, network.patch_embed.bias, stride=16)
    height, width = x.shape[-2:]
    x = torch.cat([network.cls_token, x.flatten(2).transpose(1, 2)], dim=1)[0]
    places = [(y, x) for y in range(height) for x in range(width)]
    n = (2 * height - 1) * (2 * width - 1)
    for layer, table in list(zip(network.blocks, network.position_tables, strict=True))[: block + 1]:
        attention = layer.attn
        n_heads, width_of_head = attention.num_heads, x.shape[1] // attention.num_heads
        normed = layer.norm1(x)
        q, k, v = (normed @ attention.qkv.weight.T).chunk(3, dim=1)
        q, v = q + attention.q_bias, v + attention.v_bias  # keys have no bias
        joined = []
        for head in range(n_heads):
            part = slice(head * width_of_head, (head + 1) * width_of_head)
            logits = q[:, part] @ k[:, part].T / width_of_head**0.5
            bias = torch.empty_like(logits)
            bias[0, :], bias[:, 0], bias[0, 0] = table[n, head], table[n + 1, head], table[n + 2, head]
            for i, (y, x_) in enumerate(places, start=1):
                for j, (key_y, key_x) in enumerate(places, start=1):
                    row = (y - key_y + height - 1) * (2 * width - 1) + (x_ - key_x + width - 1)
                    bias[i, j] = table[row, head]
            joined.append((logits + bias).softmax(dim=1) @ v[:, part])
        x = x + layer.gamma_1 * attention.proj(torch.cat(joined, dim=1))
        hidden = torch.nn.functional.gelu(layer.mlp.fc1(layer.norm2(x)))
        x = x + layer.gamma_2 * layer.mlp.fc2(hidden)
    return x


@torch.no_grad()
def test_maps_and_class_tokens_are_the_raw_outputs_of_the_blocks(network: BeitNetwork):
    pixels = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    maps, readouts = network(pixels)
    assert len(maps) == len(readouts) == 4
    for number, (x, readout) in enumerate(zip(maps, readouts, strict=True)):
        expected = reference_tokens(network, pixels, number)
        assert torch.allclose(readout[0], expected[0], atol=1e-4)
        assert torch.allclose(x[0], expected[1:].T.unflatten(1, (4, 4)), atol=1e-4)


@pytest.mark.parametrize("size", [(64, 64), (32, 32), (32, 96), (160, 64)])
def test_any_size_native_or_not_square_or_not(network: BeitNetwork, size: tuple[int, int]):
    maps, readouts = network(torch.rand(2, 3, *size))
    assert [tuple(x.shape) for x in maps] == [(2, 32, size[0] // 16, size[1] // 16)] * 4
    assert [tuple(x.shape) for x in readouts] == [(2, 32)] * 4
    assert all(x.isfinite().all() for x in maps)


@torch.no_grad()
def test_a_network_of_another_native_size_with_the_resized_tables_is_the_same_network():
    """At 64x96 the first network resizes its tables; the second has that size natively."""
    first, second = build(), build(size=(64, 96))
    state = first.state_dict()
    for name in [name for name in state if name.startswith("position_tables")]:
        state[name] = resize_position_table(10 * state[name], (4, 4), (4, 6))
    second.load_state_dict(state)
    for table in first.position_tables:
        table.mul_(10)
    pixels = torch.rand(1, 3, 64, 96)
    for x, y in zip(first(pixels)[0], second(pixels)[0], strict=True):
        assert torch.allclose(x, y, atol=1e-5)


@torch.no_grad()
def test_positions_matter(network: BeitNetwork):
    """Without position tables, a transformer that is given a mirrored image gives a mirrored map."""
    pixels = torch.rand(1, 3, 64, 64).unflatten(3, (4, 16))
    mirrored = pixels.flip(3).flatten(3)  # whole patches, each as it was
    straight, turned = network(pixels.flatten(3))[0][-1], network(mirrored)[0][-1]
    assert (straight.flip(3) - turned).abs().max() > 0.1


@pytest.mark.parametrize("reused", [None, []])
@torch.no_grad()
def test_bias_is_the_table_looked_up_with_an_axis_for_the_batch(reused: list[torch.Tensor] | None):
    """The first axis is what gives torch's attention a fast path on the CPU."""
    index = relative_position_index((2, 3))
    for table in (torch.randn(18, 5), torch.randn(18, 5)):
        found = position_bias(table, index, reused=reused)
        assert found.shape == (1, 5, 7, 7)
        assert torch.equal(found[0], table[index].permute(2, 0, 1))


@pytest.mark.parametrize(("gradients", "n_pieces"), [(False, 1), (True, 4)])
def test_blocks_share_the_memory_of_their_biases_unless_gradients_need_them(gradients: bool, n_pieces: int):
    network, biases = build(), []
    for block in network.blocks:
        block.register_forward_pre_hook(
            lambda _, inputs, options: biases.append(options["shared_rel_pos_bias"]), with_kwargs=True
        )
    with torch.set_grad_enabled(gradients):
        network(torch.rand(1, 3, 32, 32))
    assert len(biases) == 4
    assert len({bias.data_ptr() for bias in biases}) == n_pieces


def test_new_position_tables_are_small_random_numbers():
    numbers = torch.cat([table.flatten() for table in build().position_tables])
    assert numbers.mean().item() == pytest.approx(0, abs=0.005)
    assert numbers.std().item() == pytest.approx(0.02, rel=0.2)


@torch.no_grad()
def test_taps_choose_the_blocks_and_later_blocks_are_dropped():
    network = build(depth=8, taps=(0, 2, 3, 5))
    assert len(network.blocks) == len(network.position_tables) == 6
    pixels = torch.rand(1, 3, 64, 64)
    maps, _ = network(pixels)
    assert len(maps) == 4
    for x, block in zip(maps, (0, 2, 3, 5), strict=True):
        expected = reference_tokens(network, pixels, block)
        assert torch.allclose(x[0], expected[1:].T.unflatten(1, (4, 4)), atol=1e-4)


def test_dropped_blocks_of_timms_network_are_not_copied():
    network = build(taps=(0, 1, 1, 2))
    theirs = timm.create_model("beit_base_patch16_384", pretrained=False, embed_dim=32, depth=4, num_heads=4)
    for block in theirs.blocks:
        block.attn.relative_position_bias_table = torch.nn.Parameter(torch.randn(7 * 7 + 3, 4))  # of 4 x 4 patches
    network.load_timm(theirs)
    for i, (block, table) in enumerate(zip(network.blocks, network.position_tables, strict=True)):
        assert torch.equal(block.mlp.fc1.weight, theirs.blocks[i].mlp.fc1.weight)
        assert torch.equal(table, theirs.blocks[i].attn.relative_position_bias_table)


def test_width_of_the_mlps_is_exact():
    """timm takes a ratio to the width, which rounding must not change."""
    for mlp_width in (1, 63, 97, 128):
        assert build(mlp_width=mlp_width).blocks[0].mlp.fc1.out_features == mlp_width


def test_every_weight_is_used(network: BeitNetwork):
    maps, readouts = network(torch.rand(2, 3, 64, 64))
    (sum(x.square().sum() for x in maps) + sum(x.square().sum() for x in readouts)).backward()
    assert [name for name, p in network.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_tap_beyond_the_last_block_is_an_error():
    with pytest.raises(InputError, match=r"encoder\.taps are \(0, 1, 2, 4\).* has 4 blocks\. Take taps from 0 to 3"):
        build(taps=(0, 1, 2, 4))


@pytest.mark.parametrize(
    ("name", "side", "rows", "heads", "blocks"),
    [("beit_large_patch16_384", 384, 2212, 16, 24), ("beit_base_patch16_384", 384, 2212, 12, 12)],
)
def test_position_tables_have_the_published_shape(name: str, side: int, rows: int, heads: int, blocks: int):
    with torch.device("meta"):
        network = BeitNetwork(name, size=(side, side), taps=(0, 1, 2, blocks - 1))
    assert [tuple(table.shape) for table in network.position_tables] == [(rows, heads)] * blocks
