"""The model as other programs get it: named tensors in and out, and every image its own head in the graph."""

import copy
from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.errors import InputError
from zoedepth.model.heads.attractor import AttractorHead
from zoedepth.model.heads.output import HeadOutput
from zoedepth.model.heads.probability import BinDistribution
from zoedepth.model.interface import DepthModel
from zoedepth.model.router import TrainedRouter
from zoedepth.model.upsample import upsample
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.weights.tensors import Exported


class ExportModel(nn.Module):
    """A model without decisions that depend on values, which no exporter can follow.

    All heads see all images; of what their weights say, each image's own is picked before more is computed of it.

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

    def forward(
        self, pixel_values: Float[Tensor, "batch 3 height width"], domain: Int[Tensor, " _"] | None = None
    ) -> tuple[Tensor, ...]:
        """The fields of ``Exported`` that there are, in order."""
        return tuple(x for x in self.outputs(pixel_values, domain) if x is not None)

    def outputs(
        self, pixel_values: Float[Tensor, "batch 3 height width"], domain: Int[Tensor, " _"] | None = None
    ) -> Exported:
        """By name."""
        model, size = self.model, pixel_values.shape[-2:]
        if not isinstance(model, ZoeDepth):
            found = model(pixel_values, return_std=True)
            return Exported(found.depth[:, 0], None if found.std is None else found.std[:, 0], None)
        features = model.shared(model.relative_features(pixel_values))
        if domain is None:
            output, logits = model.heads[0](features), None
        else:
            logits = model.router(features.bottleneck, None).logits
            output = routed(list(model.heads), features, torch.where(domain < 0, logits.argmax(dim=1), domain))
        depth, spread = output.depth_and_std()
        std = None if spread is None else upsample(spread, size)[:, 0]
        return Exported(upsample(depth, size)[:, 0], std, logits)


def routed(heads: list[nn.Module], features: Any, domain: Int[Tensor, " batch"]) -> HeadOutput:
    """What each image's own head says, where all heads see all images."""
    first: Any = heads[0]
    if isinstance(first, AttractorHead):
        attractors: list[Any] = heads
        points = [_picked(said, domain) for said in zip(*(head.points(features) for head in attractors), strict=True)]
        ranges = torch.tensor([(head.domain.min_depth, head.domain.max_depth) for head in attractors])[domain]
        centers = first.centers(points, *ranges[:, :, None, None, None].unbind(dim=1))
        outputs = [head.output(features, centers) for head in attractors]
    else:
        outputs = [head(features) for head in heads]
    distributions: list[Any] = [output.distribution for output in outputs]
    if None in distributions:
        return HeadOutput(_picked([output.depth for output in outputs], domain))
    fields: list[Any] = [
        None if field[0] is None else _picked(field, domain) for field in zip(*distributions, strict=True)
    ]
    return HeadOutput(BinDistribution(*fields))


def _picked(of_heads: Sequence[Tensor], domain: Int[Tensor, " batch"]) -> Tensor:
    """Each image's own, of tensors whose first axis is the images' or 1."""
    picked = first = of_heads[0]
    if all(other is first for other in of_heads):
        return first
    for index, other in enumerate(of_heads[1:], start=1):
        own = (domain == index).view(-1, *(1,) * (first.ndim - 1))
        picked = torch.where(own, other, picked)
    return picked


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
