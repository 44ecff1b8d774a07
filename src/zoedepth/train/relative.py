"""Stage 1: encoder and decoder on relative depth, with a loss that knows no scale and shift (paper section 3.1)."""

from collections.abc import Mapping
from pathlib import Path

from jaxtyping import Float
from torch import Tensor, nn

from zoedepth import losses
from zoedepth.model.decoder import upsample
from zoedepth.model.zoedepth import ZoeDepth, normalize
from zoedepth.train.config import TrainConfig
from zoedepth.train.loop import Run


class RelativeModel(nn.Module):
    """The part of the model that stage 1 trains; parameters have the names they have in the model."""

    def __init__(self, model: ZoeDepth) -> None:
        super().__init__()
        self.encoder = model.encoder
        self.decoder = model.decoder

    def forward(self, pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 height width"]:
        """Relative depth at network resolution."""
        return upsample(self.decoder(self.encoder(normalize(pixels))).relative, pixels.shape[-2:])


def train_relative(
    config: TrainConfig,
    *,
    data: Mapping[str, Path],
    out: Path,
    start: str | None = None,
    devices: int = 1,
    n_nodes: int = 1,
) -> Path:
    """Train, or go on with what is in ``out``; returns the last checkpoint, with which stage 2 can start.

    Data of depth and of disparity are both welcome. For the arguments see :class:`Run`.
    """
    with Run(config, part=RelativeModel, data=data, out=out, start=start, devices=devices, n_nodes=n_nodes) as run:
        for batch in run.batches():
            relative = run.network(batch.pixels)
            loss = losses.scale_and_shift_invariant(
                relative, batch.target, batch.mask, trim=config.trim, gradient_weight=config.gradient_weight
            )
            norm = run.step(loss, batch)
            run.report({"ssi": loss.item(), "gradient_norm": norm})
        return run.last_checkpoint
