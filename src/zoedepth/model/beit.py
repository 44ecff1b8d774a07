"""BEiT at any input size: timm's blocks, with the relative position tables resized to the input (MiDaS v3.1)."""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from zoedepth.errors import InputError
from zoedepth.model.timm_encoder import create_network

PATCH = 16
"""Side of a patch, pixels: the stride of the tokens."""


class BeitNetwork(nn.Module):
    """timm's BEiT, which gives the outputs of four blocks as maps with their class tokens.

    timm's own position tables fit only the size that the network was built with. Here the tables are ours, and each
    block gets its bias through timm's argument for a shared one.

    Args:
        name: timm architecture.
        size: (height, width) that the position tables are made for.
        taps: indices of the four blocks whose outputs are the maps.
        width: channels of the tokens, in place of timm's.
        depth: number of blocks, in place of timm's.
        heads: attention heads of each block, in place of timm's.
        mlp_width: hidden channels of the blocks' MLPs, in place of four times the width.

    Raises:
        InputError: the network has fewer blocks than the taps need.
    """

    def __init__(
        self,
        name: str,
        *,
        size: tuple[int, int],
        taps: tuple[int, ...],
        width: int | None = None,
        depth: int | None = None,
        heads: int | None = None,
        mlp_width: int | None = None,
    ) -> None:
        super().__init__()
        overrides: dict[str, Any] = {"embed_dim": width, "depth": depth, "num_heads": heads}
        if width and mlp_width:
            # timm takes a ratio, and rounds the product down.
            overrides["mlp_ratio"] = (mlp_width + 0.5) / width
        network = create_network(
            name,
            num_classes=0,
            use_rel_pos_bias=False,
            **{option: value for option, value in overrides.items() if value is not None},
        )
        n_blocks = len(network.blocks)
        if taps[-1] >= n_blocks:
            raise InputError(
                f"encoder.taps are {taps}, but {name} has {n_blocks} blocks. Take taps from 0 to {n_blocks - 1}."
            )
        self.taps = taps
        self.native_grid = (size[0] // PATCH, size[1] // PATCH)
        self.patch_embed: nn.Module = network.patch_embed.proj
        self.cls_token: nn.Parameter = network.cls_token
        # Blocks after the last tap are never used.
        blocks = list(network.blocks)[: taps[-1] + 1]
        self.blocks = nn.ModuleList(blocks)
        rows = (2 * self.native_grid[0] - 1) * (2 * self.native_grid[1] - 1) + 3
        self.position_tables = nn.ParameterList(
            nn.Parameter(nn.init.trunc_normal_(torch.empty(rows, block.attn.num_heads), std=0.02)) for block in blocks
        )
        self.channels: tuple[int, ...] = (network.embed_dim,) * 4
        self._checkpointing = False

    def load_timm(self, network: nn.Module) -> None:
        """Copy the weights of timm's BEiT of the same shape, position tables included."""
        source: Any = network
        self.patch_embed.load_state_dict(source.patch_embed.proj.state_dict())
        with torch.no_grad():
            self.cls_token.copy_(source.cls_token)
            for block, table, given in zip(self.blocks, self.position_tables, source.blocks, strict=False):
                weights = given.state_dict()
                table.copy_(weights["attn.relative_position_bias_table"])
                block.load_state_dict({name: weights[name] for name in block.state_dict()})

    def checkpoint_gradients(self) -> None:
        """Save memory from now on: the backward pass computes the insides of the blocks again."""
        self._checkpointing = True

    def forward(
        self, pixels: Float[Tensor, "batch 3 height width"]
    ) -> tuple[list[Float[Tensor, "batch channels rows columns"]], list[Float[Tensor, "batch channels"]]]:
        """Return four maps at stride 16 and their class tokens, fine to coarse in meaning, without a final norm."""
        patches = self.patch_embed(pixels)
        grid = (patches.shape[2], patches.shape[3])
        tokens = torch.cat([self.cls_token.expand(patches.shape[0], -1, -1), patches.flatten(2).transpose(1, 2)], dim=1)
        index = relative_position_index(grid, device=tokens.device)
        # All blocks share one piece of memory for their biases: writing to new pages takes longer than the look-up.
        reused = None if torch.is_grad_enabled() or torch.compiler.is_compiling() else []
        maps, readouts = [], []
        for number, (block, table) in enumerate(zip(self.blocks, self.position_tables, strict=True)):
            bias = position_bias(resize_position_table(table, self.native_grid, grid), index, reused=reused)
            bias = bias.to(tokens.dtype)
            if self._checkpointing and torch.is_grad_enabled():
                tokens = checkpoint(block, tokens, shared_rel_pos_bias=bias, use_reentrant=False)
            else:
                tokens = block(tokens, shared_rel_pos_bias=bias)
            if number in self.taps:
                maps.append(tokens[:, 1:].transpose(1, 2).reshape(patches.shape))
                readouts.append(tokens[:, 0])
        return maps, readouts


def resize_position_table(
    table: Float[Tensor, "rows heads"], native: tuple[int, int], grid: tuple[int, int]
) -> Float[Tensor, "resized_rows heads"]:
    """Resize a relative position table from the native (height, width) grid of tokens to another one.

    The distances are a picture of (2 height - 1, 2 width - 1), which is resized bilinearly. The last three rows belong
    to the class token and stay. (MiDaS ``backbones/beit.py::_get_rel_pos_bias``.)
    """
    if grid == native:
        return table
    distances = table[:-3].T.unflatten(1, (2 * native[0] - 1, 2 * native[1] - 1))[None]
    resized = F.interpolate(distances, size=(2 * grid[0] - 1, 2 * grid[1] - 1), mode="bilinear", align_corners=False)
    return torch.cat([resized[0].flatten(1).T, table[-3:]])


def position_bias(
    table: Float[Tensor, "rows heads"], index: Int[Tensor, "tokens tokens"], *, reused: list[Tensor] | None = None
) -> Float[Tensor, "1 heads tokens tokens"]:
    """Look up the bias that is added to the attention of each pair (query, key).

    torch has a fused attention on the CPU for a mask of four axes, and none for three: hence the first one.

    Args:
        table: the position table of the grid, from ``resize_position_table``.
        index: its row for each pair, from ``relative_position_index``.
        reused: a list that keeps the memory of the last bias, which the next one overwrites. None: each has its own.
    """
    heads = table.shape[1]
    if reused is None:
        # With a gradient, index_select takes a third of the time of gather. Into given memory, gather is the faster.
        return table.T.index_select(1, index.flatten()).view(1, heads, *index.shape)
    if not reused:
        reused.append(table.new_empty(1, heads, *index.shape))
    torch.gather(table.T, 1, index.flatten().expand(heads, -1), out=reused[0].view(heads, -1))
    return reused[0]


def relative_position_index(
    grid: tuple[int, int], *, device: torch.device | None = None
) -> Int[Tensor, "tokens tokens"]:
    """Return the row of the position table for each pair (query, key) of tokens.

    The tokens are the class token and then a (height, width) grid, row by row.
    """
    height, width = grid
    rows = torch.arange(height, device=device).repeat_interleave(width)
    columns = torch.arange(width, device=device).repeat(height)
    down = rows[:, None] - rows[None, :] + height - 1
    right = columns[:, None] - columns[None, :] + width - 1
    n_distances = (2 * height - 1) * (2 * width - 1)
    index = torch.empty(height * width + 1, height * width + 1, dtype=torch.long, device=device)
    index[1:, 1:] = down * (2 * width - 1) + right
    index[0, :] = n_distances  # the class token asks
    index[:, 0] = n_distances + 1  # the class token is asked
    index[0, 0] = n_distances + 2
    return index
