"""Metric heads, a file for each. ``HEADS`` is the only list of them."""

from typing import NamedTuple

from torch import nn

from zoedepth.config import (
    AdaBinsConfig,
    AttractorConfig,
    BtsConfig,
    DornConfig,
    HeadConfig,
    NaiveConfig,
    NewCrfsConfig,
    PixelBinsConfig,
    SplitterConfig,
)
from zoedepth.model.heads.adabins import AdaBinsHead
from zoedepth.model.heads.attractor import AttractorHead, BinEmbedding
from zoedepth.model.heads.bts import BtsHead
from zoedepth.model.heads.dorn import DornHead
from zoedepth.model.heads.naive import NaiveHead
from zoedepth.model.heads.newcrfs import NewCrfsHead
from zoedepth.model.heads.output import HeadOutput, PassThrough
from zoedepth.model.heads.pixelbins import PixelBinsHead
from zoedepth.model.heads.splitter import SplitterEmbedding, SplitterHead

__all__ = ["HEADS", "HeadOutput", "HeadParts"]


class HeadParts(NamedTuple):
    """The two classes of a head.

    Both are built from the decoder's channels and the head's config; the domain's part gets its domain as well.
    """

    shared: type[nn.Module]
    """Once for each model: turns decoder features into ``HeadFeatures``, which all domains' heads look at."""
    domain: type[nn.Module]
    """Once for each domain: turns the output of the shared part into a ``HeadOutput``."""


HEADS: dict[type[HeadConfig], HeadParts] = {
    AttractorConfig: HeadParts(shared=BinEmbedding, domain=AttractorHead),
    SplitterConfig: HeadParts(shared=SplitterEmbedding, domain=SplitterHead),
    NewCrfsConfig: HeadParts(shared=PassThrough, domain=NewCrfsHead),
    PixelBinsConfig: HeadParts(shared=PassThrough, domain=PixelBinsHead),
    NaiveConfig: HeadParts(shared=PassThrough, domain=NaiveHead),
    AdaBinsConfig: HeadParts(shared=PassThrough, domain=AdaBinsHead),
    DornConfig: HeadParts(shared=PassThrough, domain=DornHead),
    BtsConfig: HeadParts(shared=PassThrough, domain=BtsHead),
}
"""Config class of a head → its two classes."""
