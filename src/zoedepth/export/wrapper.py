"""The model in the form that is exported: named tensors in and out, and a head for each image inside the graph."""

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
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.weights.tensors import Exported


class ExportModel(nn.Module):
    """Model without decisions that depend on values, because no exporter can follow them.

    The weights of all heads are applied to all images. Then each image keeps the outputs of its own head, before
    anything else is computed from them.

    Raises:
        InputError: the model has no metric heads, or its router must be told the domain or votes over the batch.
    """

    def __init__(self, model: DepthModel) -> None:
        super().__init__()
        config = model.config
        if not config.domains:
            raise InputError(
                "a model without metric heads cannot be exported: its relative depth has no unit. Train heads on it"
            )
        if isinstance(model, ZoeDepth) and len(config.domains) > 1:
            if not isinstance(model.router, TrainedRouter):
                raise InputError(
                    "a model with a labeled router cannot be exported: it cannot choose the head. Train a router"
                )
            if model.router.by_batch:
                raise InputError(
                    "a router that votes over the batch cannot be exported: load the model without compat batch-vote"
                )
        # The copy shares the weights. The caller's model stays as it is.
        self.model = copy.deepcopy(model, {id(p): p for p in model.parameters()})
        for module in list(self.model.modules()):
            for name, child in module.named_children():
                if isinstance(child, nn.TransformerEncoder):
                    setattr(module, name, PlainTransformer(child))

    def forward(
        self, pixel_values: Float[Tensor, "batch 3 height width"], domain: Int[Tensor, " _"] | None = None
    ) -> tuple[Tensor, ...]:
        """Compute the fields of ``Exported`` in order, without those that the model does not have."""
        return tuple(x for x in self.outputs(pixel_values, domain) if x is not None)

    def outputs(
        self, pixel_values: Float[Tensor, "batch 3 height width"], domain: Int[Tensor, " _"] | None = None
    ) -> Exported:
        """Compute the outputs by name."""
        model = self.model
        if not isinstance(model, ZoeDepth):
            found = model(pixel_values, return_std=True)
            return Exported(found.depth[:, 0], None if found.std is None else found.std[:, 0], None)
        decoded = model.relative_features(pixel_values)
        features = model.shared(decoded)
        if domain is None:
            output, logits = model.heads[0](features), None
        else:
            logits = model.router(features.bottleneck, None).logits
            output = routed(list(model.heads), features, torch.where(domain < 0, logits.argmax(dim=1), domain))
        depth, spread = output.depth_and_std()
        enlarge = model.enlarge(decoded.last, pixel_values)
        return Exported(enlarge(depth)[:, 0], None if spread is None else enlarge(spread)[:, 0], logits)


def routed(heads: list[nn.Module], features: Any, domain: Int[Tensor, " batch"]) -> HeadOutput:
    """Apply all heads to all images, and return for each image the output of its own head."""
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
    """Pick for each image the tensor of its own head. The first axis of all tensors is the batch, or 1."""
    picked = first = of_heads[0]
    if all(other is first for other in of_heads):
        return first
    for index, other in enumerate(of_heads[1:], start=1):
        own = (domain == index).view(-1, *(1,) * (first.ndim - 1))
        picked = torch.where(own, other, picked)
    return picked


class PlainTransformer(nn.Module):
    """torch's transformer in evaluation mode. torch's own code would fix the number of tokens when it is traced."""

    def __init__(self, transformer: nn.TransformerEncoder) -> None:
        super().__init__()
        self.layers = transformer.layers

    def forward(self, x: Float[Tensor, "batch tokens channels"]) -> Float[Tensor, "batch tokens channels"]:
        """Apply layers that normalise last, use ReLU and take the batch first, as all in this package do."""
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
