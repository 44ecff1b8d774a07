"""Stage 2: train the whole model on depth in metres (paper section 3.3)."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from zoedepth import losses
from zoedepth.data.sample import Batch
from zoedepth.model.upsample import upsample
from zoedepth.model.zoedepth import DepthOutput
from zoedepth.train.config import SourceConfig, TrainConfig
from zoedepth.train.processes import launch_fabric, total
from zoedepth.train.report import report
from zoedepth.train.run import Run, last_checkpoint, set_up
from zoedepth.train.step import backward, begin_step, means, take_step


def train_metric(
    config: TrainConfig,
    *,
    data: Mapping[str, str | Path],
    out: Path,
    init: str | None = None,
    devices: int | None = None,
    n_nodes: int = 1,
) -> Path:
    """Train the whole model, or go on with the run that is in ``out``.

    Args:
        config: the configuration, most often a recipe's; its stage is "metric".
        data: name of a source of the configuration → where its data is (``zoedepth.opening.open_dataset``).
        out: folder of the run: checkpoints, log, pictures.
        init: starting weights, see ``zoedepth.train.start.start_from``; not read when resuming.
        devices: processes on each machine, see ``zoedepth.train.processes.launch_fabric``.
        n_nodes: machines.

    Returns:
        The folder of the last checkpoint, which ``zoedepth.load_model`` takes.

    Raises:
        InputError: data, starting weights or checkpoint do not suit the configuration.
        TrainingError: loss or gradients are not finite; the error names the images.
        KeyboardInterrupt: Ctrl-C came, or SIGTERM (``Terminated``); the step was finished and is saved.
    """
    fabric = launch_fabric(config, devices=devices, n_nodes=n_nodes)
    with set_up(config, fabric, part=lambda model: model, data=data, out=out, init=init) as run:
        while run.state.step < config.steps:
            begin_step(run)
            numbers_of: list[Mapping[str, float]] = []
            batches: list[Batch] = []
            for i in range(config.accumulate):
                batch = next(run.batches)
                # Forward.
                domain = batch.domain if config.route_by_label else None
                output = run.network(batch.pixels, domain=domain, return_std=config.spread_weight > 0)
                # Loss.
                terms = metric_losses(output, batch, config, run.sources)
                loss = torch.stack(list(terms.values())).sum()
                # Backward.
                backward(run, loss, batch, complete=i == config.accumulate - 1)
                numbers_of.append(_numbers(terms, batch, run))
                batches.append(batch)
            # Step.
            numbers = {**means(numbers_of), "gradient_norm": take_step(run, batches)}
            # Report.
            report(run, numbers, batches[-1])
        return last_checkpoint(run)


def _numbers(terms: Mapping[str, Tensor], batch: Batch, run: Run) -> dict[str, float]:
    """Return what the log says of a batch: its terms.

    They have the name of the batch's data set where each has batches of its own, and they say nothing of the others.
    """
    of = "" if run.turns == 1 else f"/{run.sources[int(batch.source[0])].name}"
    return {f"{name}{of}": value.item() for name, value in terms.items()}


def metric_losses(
    output: DepthOutput, batch: Batch, config: TrainConfig, sources: Sequence[SourceConfig]
) -> dict[str, Tensor]:
    """Return the terms of the loss by name, weighted, each computed over the batch of all processes.

    These are: SILog of the depth, or the ordinal loss where the head gives ordinal logits; the chamfer distance to the
    true depths where the head gives bins to compare; the errors of the edges and of the standard deviation where the
    configuration weighs them; cross-entropy against the domain labels where the router has scores.

    Args:
        output: output of the model for the batch, with ``std`` where the configuration weighs its error.
        batch: the samples.
        config: the weights of the terms.
        sources: the data sets of the training, in the order that ``batch.source`` counts.
    """
    supervision = output.supervision
    depth, std = at_truth(output.depth, batch), None if output.std is None else at_truth(output.std, batch)
    if supervision.ordinal is not None:
        terms = {"ordinal": losses.ordinal(*supervision.ordinal, *filling(batch), total=total)}
    else:
        terms = {"silog": losses.silog(depth, batch.target, batch.mask, total=total)}
    if supervision.image_bins is not None and config.chamfer_weight > 0:
        chamfer = losses.bins_chamfer(supervision.image_bins, batch.target, batch.mask, total=total)
        terms["chamfer"] = config.chamfer_weight * chamfer
    if supervision.window_bins is not None and config.window_chamfer_weight > 0:
        chamfer = losses.window_bins_chamfer(*supervision.window_bins, *filling(batch), total=total)
        terms["window_chamfer"] = config.window_chamfer_weight * chamfer
    if config.log_gradient_weight > 0:
        smooth = torch.tensor([source.gradient_term for source in sources], device=batch.mask.device)
        mask = batch.mask & smooth[batch.source][:, None, None, None]
        terms["log_gradient"] = config.log_gradient_weight * losses.log_gradient(depth, batch.target, mask, total=total)
    if config.spread_weight > 0 and std is not None:
        spread = losses.spread(depth, std, batch.target, batch.mask, total=total)
        terms["spread"] = config.spread_weight * spread
    if output.domain_logits is not None and config.domain_weight > 0:
        entropy, n = losses.domain_cross_entropy(output.domain_logits, batch.domain), batch.domain.new_ones(())
        terms["domain"] = config.domain_weight * total(entropy) / total(n)
    return terms


def filling(
    batch: Batch,
) -> tuple[Float[Tensor, "batch 1 rows columns"], Bool[Tensor, "batch 1 rows columns"]]:
    """Return true depth and mask that fill their maps, for losses that look at places of the photo.

    Where the sizes differ within a batch, a smaller target is enlarged to the nearest pixels.
    """
    if batch.sizes is None:
        return batch.target, batch.mask
    target, mask = torch.empty_like(batch.target), torch.empty_like(batch.mask)
    for i, (height, width) in enumerate(batch.sizes.tolist()):
        for whole, part in ((target, batch.target), (mask, batch.mask)):
            own = part[i : i + 1, :, :height, :width].float()
            whole[i] = F.interpolate(own, whole.shape[-2:], mode="nearest")[0].to(whole.dtype)
    return target, mask


def at_truth(prediction: Float[Tensor, "batch 1 height width"], batch: Batch) -> Float[Tensor, "batch 1 rows columns"]:
    """Bring a prediction to the size of each sample's true depth, as an evaluation does.

    It is bilinear, with aligned corners (released ``trainers/loss.py``). Where the sizes differ within a batch, what
    was added to a smaller target gets the prediction 1, which no loss looks at.
    """
    if batch.sizes is None:
        return upsample(prediction, batch.target.shape[-2:])
    found = prediction.new_ones(batch.target.shape)
    for i, (height, width) in enumerate(batch.sizes.tolist()):
        found[i, :, :height, :width] = upsample(prediction[i : i + 1], torch.Size([height, width]))[0]
    return found
