"""Stage 2: the whole model on depth in metres (paper section 3.3)."""

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from zoedepth import losses
from zoedepth.data.sample import Batch
from zoedepth.model.zoedepth import DepthOutput
from zoedepth.train.config import TrainConfig
from zoedepth.train.loop import Run
from zoedepth.train.processes import total


def train_metric(
    config: TrainConfig,
    *,
    data: Mapping[str, str | Path],
    out: Path,
    init: str | None = None,
    devices: int | None = None,
    n_nodes: int = 1,
) -> Path:
    """Train, or go on with what is in ``out``; returns the last checkpoint. For the arguments see ``Run``."""
    with Run(config, part=lambda model: model, data=data, out=out, init=init, devices=devices, n_nodes=n_nodes) as run:
        for batch in run.batches():
            output = run.network(batch.pixels, domain=batch.domain if config.route_by_label else None)
            terms = metric_losses(output, batch, config)
            run.learn(
                torch.stack(list(terms.values())).sum(), batch, {name: term.item() for name, term in terms.items()}
            )
        return run.last_checkpoint


def metric_losses(output: DepthOutput, batch: Batch, config: TrainConfig) -> dict[str, Tensor]:
    """The terms of the loss, all of them those of the batch of all processes.

    SILog of the depth, or the ordinal loss where the head gives ordinal logits; the chamfer distance to the true depths
    where the head gives bins to compare; cross-entropy against the domain labels where the router has scores.
    """
    supervision = output.supervision
    if supervision.ordinal is not None:
        terms = {"ordinal": losses.ordinal(*supervision.ordinal, batch.target, batch.mask, total=total)}
    else:
        terms = {"silog": losses.silog(output.depth, batch.target, batch.mask, total=total)}
    if supervision.image_bins is not None and config.chamfer_weight > 0:
        chamfer = losses.bins_chamfer(supervision.image_bins, batch.target, batch.mask, total=total)
        terms["chamfer"] = config.chamfer_weight * chamfer
    if supervision.window_bins is not None and config.window_chamfer_weight > 0:
        chamfer = losses.window_bins_chamfer(*supervision.window_bins, batch.target, batch.mask, total=total)
        terms["window_chamfer"] = config.window_chamfer_weight * chamfer
    if output.domain_logits is not None and config.domain_weight > 0:
        entropy, n = losses.domain_cross_entropy(output.domain_logits, batch.domain), batch.domain.new_ones(())
        terms["domain"] = config.domain_weight * total(entropy) / total(n)
    return terms
