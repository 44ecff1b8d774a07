"""Give ZoeDepth a metric head of your own, and train it for a few steps on rendered rooms."""

from dataclasses import replace

import torch
from torch import nn

from zoedepth import build_model, presets
from zoedepth.config import INDOOR, NaiveConfig
from zoedepth.data.sample import collate
from zoedepth.losses import silog
from zoedepth.model.heads import HEADS, HeadOutput, HeadParts, PassThrough
from zoedepth.opening import open_dataset


class SigmoidConfig(NaiveConfig):
    """Settings of the head: here those of the naive one."""


class SigmoidHead(nn.Module):
    def __init__(self, channels, config, domain):
        super().__init__()
        self.max_depth = domain.max_depth
        self.layers = nn.Sequential(nn.Conv2d(channels.last, config.width, 1), nn.ReLU(), nn.Conv2d(config.width, 1, 1))

    def forward(self, features):
        return HeadOutput(self.max_depth * self.layers(features.last).sigmoid())  # metres


HEADS[SigmoidConfig] = HeadParts(shared=PassThrough, domain=SigmoidHead)
model = build_model(replace(presets.MINIATURE, head=SigmoidConfig(), domains=(INDOOR,)))
rooms = open_dataset("synthetic:rooms?n=2&size=96x128")
batch = collate([rooms[i] for i in range(2)], domains=("indoor",))
optimizer = torch.optim.AdamW(model.parameters(), lr=1e-3)
for step in range(10):
    loss = silog(model(batch.pixels).depth, batch.target, batch.mask)  # the paper's loss
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    print(f"step {step + 1}: loss {loss.item():.3f}")
