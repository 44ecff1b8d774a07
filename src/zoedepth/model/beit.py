"""BEiT at any input size: timm's blocks, with the relative position tables resized to the input (MiDaS v3.1)."""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from zoedepth.config import EncoderConfig
from zoedepth.errors import InputError
from zoedepth.model.linear import replace_linear

PATCH = 16
"""Side of a patch, pixels: the stride of the tokens."""


class BeitNetwork(nn.Module):
    """timm's BEiT, giving the outputs of four blocks as maps with their class tokens.

    timm's own position tables fit the size the network was built with only. Here the tables are ours, and each block is
    given its bias through timm's argument for a shared one.
    """

    def __init__(self, config: EncoderConfig) -> None:
        import timm

        super().__init__()
        overrides: dict[str, Any] = {"embed_dim": config.width, "depth": config.depth and config.depth[0],
                     "num_heads": config.heads and config.heads[0]}  # fmt: skip
        if config.width and config.mlp_width:
            # timm takes a ratio, and rounds the product down.
            overrides["mlp_ratio"] = (config.mlp_width + 0.5) / config.width
        network: Any = timm.create_model(
            config.name,
            pretrained=False,
            num_classes=0,
            img_size=config.size,
            use_rel_pos_bias=False,
            **{name: value for name, value in overrides.items() if value is not None},
        )
        if config.taps[-1] >= len(network.blocks):
            raise InputError(f"tap {config.taps[-1]} of {config.name}, which has {len(network.blocks)} blocks")
        self.taps = config.taps
        self.native_grid = (config.size[0] // PATCH, config.size[1] // PATCH)
        self.patch_embed: nn.Module = network.patch_embed.proj
        self.cls_token: nn.Parameter = network.cls_token
        # Blocks after the last tap are never used.
        blocks = list(network.blocks)[: config.taps[-1] + 1]
        self.blocks = nn.ModuleList(blocks)
        replace_linear(self.blocks)
        rows = (2 * self.native_grid[0] - 1) * (2 * self.native_grid[1] - 1) + 3
        self.position_tables = nn.ParameterList(
            nn.Parameter(nn.init.trunc_normal_(torch.empty(rows, block.attn.num_heads), std=0.02)) for block in blocks
        )
        self.channels: tuple[int, ...] = (network.embed_dim,) * 4
        self._checkpointing = False

    def load_timm(self, network: nn.Module) -> None:
        """Take the weights of timm's BEiT of the same shape, position tables and all."""
        source: Any = network
        self.patch_embed.load_state_dict(source.patch_embed.proj.state_dict())
        with torch.no_grad():
            self.cls_token.copy_(source.cls_token)
            for block, table, given in zip(self.blocks, self.position_tables, source.blocks, strict=False):
                weights = given.state_dict()
                table.copy_(weights["attn.relative_position_bias_table"])
                block.load_state_dict({name: weights[name] for name in block.state_dict()})

    def checkpoint_gradients(self) -> None:
        """From now on the backward pass computes what is inside the blocks again, instead of keeping it."""
        self._checkpointing = True

    def forward(
        self, pixels: Float[Tensor, "batch 3 height width"]
    ) -> tuple[list[Float[Tensor, "batch channels rows columns"]], list[Float[Tensor, "batch channels"]]]:
        """Four maps at stride 16 and their class tokens, fine to coarse in meaning. No final norm is applied."""
        patches = self.patch_embed(pixels)
        grid = (patches.shape[2], patches.shape[3])
        tokens = torch.cat([self.cls_token.expand(patches.shape[0], -1, -1), patches.flatten(2).transpose(1, 2)], dim=1)
        index = relative_position_index(grid, device=tokens.device)
        # One piece of memory for the biases of all blocks: writing into fresh pages takes longer than looking up.
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
    """The relative position table of a (height, width) grid of tokens other than the native one.

    The distances are a picture of (2 height - 1, 2 width - 1), resized bilinearly; the last three rows, for the class
    token, stay. (MiDaS ``backbones/beit.py::_get_rel_pos_bias``.)
    """
    if grid == native:
        return table
    distances = table[:-3].T.unflatten(1, (2 * native[0] - 1, 2 * native[1] - 1))[None]
    resized = F.interpolate(distances, size=(2 * grid[0] - 1, 2 * grid[1] - 1), mode="bilinear", align_corners=False)
    return torch.cat([resized[0].flatten(1).T, table[-3:]])


def position_bias(
    table: Float[Tensor, "rows heads"], index: Int[Tensor, "tokens tokens"], *, reused: list[Tensor] | None = None
) -> Float[Tensor, "1 heads tokens tokens"]:
    """What is added to the attention of each pair (query, key).

    The first axis makes it a mask for which torch has a fused attention on the CPU; with three axes it has none.

    Args:
        table: of the grid, see ``resize_position_table``.
        index: see ``relative_position_index``.
        reused: keeps the memory of the last bias, which the next one overwrites; None: each has its own.
    """
    heads = table.shape[1]
    if reused is None:
        # A third of the time of a gather and its gradient; writing into given memory, gather is the faster one.
        return table.T.index_select(1, index.flatten()).view(1, heads, *index.shape)
    if not reused:
        reused.append(table.new_empty(1, heads, *index.shape))
    torch.gather(table.T, 1, index.flatten().expand(heads, -1), out=reused[0].view(heads, -1))
    return reused[0]


def relative_position_index(
    grid: tuple[int, int], *, device: torch.device | None = None
) -> Int[Tensor, "tokens tokens"]:
    """Row of the position table for each pair (query, key) of the class token and a (height, width) grid of tokens."""
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
