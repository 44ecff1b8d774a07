"""Metric heads. One file a head; :data:`HEADS` is the only list of them."""

from typing import NamedTuple

from torch import nn

from zoedepth.config import AttractorConfig
from zoedepth.heads.attractor import AttractorHead, BinEmbedding, HeadOutput

__all__ = ["HEADS", "HeadOutput", "HeadParts"]


class HeadParts(NamedTuple):
    """The classes of a head. Both take (decoder channels, head config), the domain's part its domain as well."""

    shared: type[nn.Module]
    """Once a model: decoder features to what all domains' heads, and the router, look at (``.bottleneck``)."""
    domain: type[nn.Module]
    """Once a domain: the output of the shared part to a :class:`HeadOutput`."""


HEADS = {AttractorConfig: HeadParts(shared=BinEmbedding, domain=AttractorHead)}
"""The config class of a head → its parts."""
