"""The naive head: depth straight from the decoder features, without bins (paper Table 5)."""

import math
from typing import Any

import torch
import torch.nn.functional as F
from torch import nn

from zoedepth.config import Domain, NaiveConfig
from zoedepth.model.decoder import DecoderChannels, DecoderFeatures
from zoedepth.model.heads.output import HeadOutput

_INITIAL_STD = 1e-3
"""Standard deviation of the last weights. It is small because relative depth may be in the thousands, and a new head
should predict its initial depth all the same."""


class NaiveHead(nn.Module):
    """Metric depth of one domain: 3x3 convolution, ReLU, 1x1 convolution, softplus. It ignores the domain's range."""

    def __init__(self, channels: DecoderChannels, config: NaiveConfig, domain: Domain) -> None:
        super().__init__()
        self.relative_input = config.relative_input
        self.conv1 = nn.Conv2d(channels.last + int(config.relative_input), config.width, kernel_size=3, padding=1)
        self.conv2 = nn.Conv2d(config.width, 1, kernel_size=1)
        nn.init.normal_(self.conv2.weight, std=_INITIAL_STD)
        # The inverse of softplus.
        initial = config.initial_depth + math.log(-math.expm1(-config.initial_depth))
        bias: Any = self.conv2.bias
        nn.init.constant_(bias, initial)

    def forward(self, features: DecoderFeatures) -> HeadOutput:
        """Predict depth in metres, without an upper bound, at the size of ``features.last``."""
        x = torch.cat([features.last, features.relative], dim=1) if self.relative_input else features.last
        return HeadOutput(F.softplus(self.conv2(F.relu(self.conv1(x))).float()))
