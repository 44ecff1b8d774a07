"""Small models to export. Exporting takes seconds, most of them for the encoder: tests of heads take a flat one."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
import torch.nn.functional as F
from tests.model.heads import test_bts, test_dorn, test_splitter
from torch import Tensor, nn

import zoedepth.export.write
from zoedepth.build import build_model
from zoedepth.config import Domain, ModelConfig
from zoedepth.export.wrapper import ExportModel
from zoedepth.model.encoder import EncoderFeatures
from zoedepth.model.zoedepth import ZoeDepth

DOMAINS = (Domain("indoor", 1e-3, 10.0, focal_px=40.0), Domain("outdoor", 1e-3, 80.0, focal_px=90.0))
PAIR = torch.stack([torch.zeros(3, 64, 64), torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0))])
"""Two images that ``balanced`` models send to different heads."""

HEADS = {
    "attractors": lambda config: config,
    "normed": lambda config: replace(config, head=replace(config.head, centers="normed")),
    "softmax": lambda config: replace(config, head=replace(config.head, probability="softmax")),
    "splitter": lambda config: replace(config, head=test_splitter.TINY),
    "dorn": lambda config: replace(config, head=test_dorn.TINY),
    "bts": lambda config: replace(config, head=test_bts.TINY),
}
"""Kind of head → the config with it."""


def beit(tiny_config: ModelConfig, n_domains: int, classifier: str = "transformer") -> ZoeDepth:
    """A random model of BEiT in evaluation mode."""
    torch.manual_seed(0)
    router = replace(tiny_config.router, kind="trained", classifier=classifier)
    model = build_model(replace(tiny_config, domains=DOMAINS[:n_domains], router=router)).eval()
    assert isinstance(model, ZoeDepth)
    with torch.no_grad():  # random tables are nearly zero: a mistake in them would not show
        for name, table in model.named_parameters():
            if "position_tables" in name:
                table.normal_()
    return model


class FlatEncoder(nn.Module):
    """As much of an encoder as a decoder needs: mean colours of patches, mixed."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.width = config.encoder.width
        self.mix = nn.ModuleList(nn.Conv2d(3, self.width, 1) for _ in range(4))

    def forward(self, pixels: Tensor) -> EncoderFeatures:
        """Four maps of stride 16 and their readouts, as BEiT's."""
        patches = F.avg_pool2d(pixels, 16)
        maps = tuple(mix(patches) for mix in self.mix)
        return EncoderFeatures(maps, tuple(x.mean(dim=(2, 3)) for x in maps))


def flat(config: ModelConfig, n_domains: int) -> ZoeDepth:
    """A random model with a ``FlatEncoder``. (Its weights are in no file, its config says BEiT.)"""
    model: Any = beit(config, n_domains, "mlp")
    torch.manual_seed(1)
    model.encoder = FlatEncoder(config)
    return model.eval()


@torch.no_grad()
def balanced(model: ZoeDepth) -> ZoeDepth:
    """Change the router's last layer: it sends each image of ``PAIR`` to another head, and rounding decides nothing."""
    last = model.router.classifier.mlp[-1]

    def gaps() -> Tensor:
        logits = model(PAIR).domain_logits
        assert logits is not None
        return logits[:, 0] - logits[:, 1]

    first, second = gaps()
    last.weight *= 2 / (first - second).abs()
    last.bias[0] -= gaps().mean()
    return model


@contextmanager
def traced_once(graph: Path) -> Iterator[None]:
    """Keep the ONNX graph that an export traces, or take it from there: every format that needs one has the same."""
    trace = zoedepth.export.write.write_onnx

    def kept(wrapped: ExportModel, path: Path) -> None:
        if not graph.exists():
            trace(wrapped, graph)
        shutil.copy(graph, path)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zoedepth.export.write, "write_onnx", kept)
        yield
