"""Routers: which metric head each image takes (paper section 3.3, R.1 to R.3)."""

import math
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from zoedepth.config import RouterConfig
from zoedepth.errors import InputError


class Routing(NamedTuple):
    """A router's decision, image by image."""

    domain: Int[Tensor, " batch"]
    """Index of the head each image takes."""
    logits: Float[Tensor, "batch domains"] | None
    """Scores of the domains; None where there is no classifier."""
    weight: Float[Tensor, "batch domains"] | None = None
    """Where given, each image takes all heads, and its depth is this mixture of theirs."""

    def rows(self, rows: Int[Tensor, " rows"]) -> "Routing":
        """Take some images of the batch."""
        logits, weight = (None if x is None else x[rows] for x in (self.logits, self.weight))
        return Routing(self.domain[rows], logits, weight)


class LabeledRouter(nn.Module):
    """R.1: the caller names the domain, in training and in use. With one domain the caller need not."""

    def __init__(self, n_domains: int) -> None:
        super().__init__()
        self.n_domains = n_domains

    def forward(self, bottleneck: Float[Tensor, "batch _ _ _"], domain: Int[Tensor, " batch"] | None) -> Routing:
        """Return the given domains.

        Raises:
            InputError: no domain is given and there is more than one.
        """
        if domain is None:
            if self.n_domains > 1:
                raise InputError("this model's router is labeled: pass the domain of each image (domain=...)")
            domain = torch.zeros(len(bottleneck), dtype=torch.long, device=bottleneck.device)
        return Routing(domain, None)


class TrainedRouter(nn.Module):
    """R.2: a classifier trained on the domain labels; each image takes the head of its own best score.

    A given domain overrides the classifier.

    Args:
        classifier: module from the bottleneck to scores of the domains.
        by_batch: True: all images take the head with the best sum of scores over the batch, as released
            (``zoedepth_nk_v1.py``). An image's depth then depends on its neighbours.
    """

    def __init__(self, classifier: nn.Module, *, by_batch: bool = False) -> None:
        super().__init__()
        self.classifier = classifier
        self.by_batch = by_batch

    def forward(self, bottleneck: Float[Tensor, "batch _ _ _"], domain: Int[Tensor, " batch"] | None) -> Routing:
        """Return the given domains, or else those that the classifier chooses."""
        logits = self.classifier(bottleneck).float()
        if domain is not None:
            return Routing(domain, logits)
        scores = logits.sum(dim=0, keepdim=True).expand_as(logits) if self.by_batch else logits
        return Routing(scores.argmax(dim=1), logits)


class AutoRouter(TrainedRouter):
    """R.3: the same classifier without labels, trained end to end by the depth loss alone.

    A hard choice passes no gradient to the classifier. While training, the depth is therefore the mixture of all heads'
    depths weighted by the router's probabilities; in evaluation each image takes its best head.
    """

    def forward(self, bottleneck: Float[Tensor, "batch _ _ _"], domain: Int[Tensor, " batch"] | None) -> Routing:
        """Return a mixture while training, and the best head in evaluation."""
        routing = super().forward(bottleneck, domain)
        if self.training and domain is None and routing.logits is not None:
            return routing._replace(weight=routing.logits.softmax(dim=1))
        return routing


class MlpClassifier(nn.Module):
    """An MLP on the pooled bottleneck (paper)."""

    def __init__(self, channels: int, n_domains: int, *, width: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(channels, width), nn.ReLU(), nn.Linear(width, n_domains))

    def forward(self, bottleneck: Float[Tensor, "batch channels _ _"]) -> Float[Tensor, "batch domains"]:
        """Return the scores of the domains."""
        return self.mlp(bottleneck.mean(dim=(2, 3)))


class TransformerClassifier(nn.Module):
    """A transformer over the bottleneck's pixels, then an MLP on its class token (``patch_transformer.py``)."""

    def __init__(
        self, channels: int, n_domains: int, *, width: int, attention_heads: int, feedforward_width: int
    ) -> None:
        super().__init__()
        self.project = nn.Conv2d(channels, width, kernel_size=1)
        layer = nn.TransformerEncoderLayer(width, attention_heads, feedforward_width, dropout=0.1, batch_first=True)
        self.transformer = nn.TransformerEncoder(layer, num_layers=4, enable_nested_tensor=False)
        self.mlp = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, n_domains))

    def forward(self, bottleneck: Float[Tensor, "batch channels _ _"]) -> Float[Tensor, "batch domains"]:
        """Return the scores of the domains."""
        tokens = self.project(bottleneck).flatten(2).transpose(1, 2)
        tokens = F.pad(tokens, (0, 0, 1, 0))  # a class token of zeros, which is not learned
        tokens = tokens + positional_code(tokens.shape[1], tokens.shape[2], device=tokens.device)
        tokens = tokens.to(self.project.weight.dtype)  # the sum is float32 under autocast, as the weights are
        return self.mlp(self.transformer(tokens)[:, 0])


def positional_code(length: int, width: int, *, device: torch.device | None = None) -> Float[Tensor, "length width"]:
    """Return sines, then cosines, of position * 10000 ** (-2 i / width), not interleaved, as released."""
    rates = torch.exp(torch.arange(0, width, 2, device=device) * (-math.log(10000.0) / width))
    angles = torch.arange(length, device=device)[:, None] * rates
    return torch.cat([angles.sin(), angles.cos()], dim=1)


def build_router(config: RouterConfig, channels: int, n_domains: int) -> nn.Module:
    """Build a router for ``n_domains`` heads on a bottleneck of ``channels``.

    With one domain only, it is a labeled one whatever the config says.
    """
    if n_domains == 1 or config.kind == "labeled":
        return LabeledRouter(n_domains)
    if config.classifier == "mlp":
        classifier = MlpClassifier(channels, n_domains, width=config.width)
    else:
        classifier = TransformerClassifier(
            channels,
            n_domains,
            width=config.width,
            attention_heads=config.attention_heads,
            feedforward_width=config.feedforward_width,
        )
    if config.kind == "auto":
        return AutoRouter(classifier)
    return TrainedRouter(classifier, by_batch=config.vote == "batch")
