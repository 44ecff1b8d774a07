"""The model as other programs get it: one tensor in, named tensors out, and every image its own head in the graph."""

import copy
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.errors import InputError
from zoedepth.model.decoder import upsample
from zoedepth.model.interface import DepthModel
from zoedepth.model.router import TrainedRouter
from zoedepth.model.zoedepth import ZoeDepth

INPUT = "pixel_values"
"""RGB in [0, 1], float32 (batch, 3, height, width); normalised inside."""


class Exported(NamedTuple):
    """What an exported model gives; its outputs have these names. Those that a model has not are left out."""

    predicted_depth: Float[Tensor, "batch height width"]
    """Metres, of the head that the router chose, image by image."""
    std: Float[Tensor, "batch domains height width"] | None
    """Metres: standard deviation of each head's distribution."""
    domain_depth: Float[Tensor, "batch domains height width"] | None
    """Metres, of every head."""
    domain_logits: Float[Tensor, "batch domains"] | None
    """The router's scores."""


class ExportModel(nn.Module):
    """A model without decisions that depend on values, which no exporter can follow.

    All heads see all images, and each image's own answer is picked: they are a small part of the work.

    Raises:
        InputError: a model without metric heads, or one whose router must be told the domain or votes over the batch.
    """

    def __init__(self, model: DepthModel) -> None:
        super().__init__()
        config = model.config
        if not config.domains:
            raise InputError("a model without metric heads cannot be exported: its relative depth has no unit")
        if isinstance(model, ZoeDepth) and len(config.domains) > 1:
            if not isinstance(model.router, TrainedRouter):
                raise InputError("a model with a labeled router cannot be exported: nothing in it chooses the head")
            if model.router.by_batch:
                raise InputError("a router that votes over the batch cannot be exported: load without batch-vote")
        # A copy that shares the weights: the caller's model stays as it is.
        self.model = copy.deepcopy(model, {id(p): p for p in model.parameters()})
        for module in list(self.model.modules()):
            for name, child in module.named_children():
                if isinstance(child, nn.TransformerEncoder):
                    setattr(module, name, PlainTransformer(child))

    def forward(self, pixel_values: Float[Tensor, "batch 3 height width"]) -> tuple[Tensor, ...]:
        """The fields of :class:`Exported` that there are, in order."""
        return tuple(x for x in self.outputs(pixel_values) if x is not None)

    def outputs(self, pixel_values: Float[Tensor, "batch 3 height width"]) -> Exported:
        """By name."""
        model = self.model
        if not isinstance(model, ZoeDepth):
            output = model(pixel_values, return_std=True)
            return Exported(output.depth[:, 0], output.std, None, None)
        size = pixel_values.shape[-2:]
        features = model.shared(model.relative_features(pixel_values))
        answers = [head(features).answer(std=True, bins=False) for head in model.heads]
        depth = torch.cat([upsample(answer.depth, size) for answer in answers], dim=1)
        stds = [upsample(answer.std, size) for answer in answers if answer.std is not None]
        std = torch.cat(stds, dim=1) if stds else None
        if len(answers) == 1:
            return Exported(depth[:, 0], std, None, None)
        logits = model.router(features.bottleneck, None).logits
        return Exported(chosen(depth, logits.argmax(dim=1)), std, depth, logits)


class PlainTransformer(nn.Module):
    """torch's transformer in evaluation, whose own code fixes the number of tokens when it is traced."""

    def __init__(self, transformer: nn.TransformerEncoder) -> None:
        super().__init__()
        self.layers = transformer.layers

    def forward(self, x: Float[Tensor, "batch tokens channels"]) -> Float[Tensor, "batch tokens channels"]:
        """Layers with their norms behind and ReLU, batch first, as all in this package are."""
        for module in self.layers:
            layer: Any = module
            attention = layer.self_attn
            batch, tokens, channels = x.shape
            projected = F.linear(x, attention.in_proj_weight, attention.in_proj_bias)
            heads = projected.reshape(batch, tokens, 3, attention.num_heads, channels // attention.num_heads)
            q, k, v = heads.permute(2, 0, 3, 1, 4).unbind(0)
            seen = F.scaled_dot_product_attention(q, k, v).transpose(1, 2).reshape(batch, tokens, channels)
            x = layer.norm1(x + attention.out_proj(seen))
            x = layer.norm2(x + layer.linear2(F.relu(layer.linear1(x))))
        return x


def chosen(
    x: Float[Tensor, "batch domains height width"], domain: Int[Tensor, " batch"]
) -> Float[Tensor, "batch height width"]:
    """Each image's map of its own domain."""
    return x.gather(1, domain[:, None, None, None].expand(-1, 1, *x.shape[2:]))[:, 0]
