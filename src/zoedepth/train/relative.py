"""Stage 1: encoder and decoder on relative depth, with a loss that knows no scale and shift (paper section 3.1)."""

from collections.abc import Mapping
from pathlib import Path

import torch
import torch.distributed as distributed
from jaxtyping import Bool, Float
from torch import Tensor, nn

from zoedepth import losses
from zoedepth.data.sample import Batch
from zoedepth.model.decoder import upsample
from zoedepth.model.interface import DepthModel
from zoedepth.model.zoedepth import ZoeDepth, normalize
from zoedepth.pareto import min_norm_weights, normalized
from zoedepth.train.config import TrainConfig
from zoedepth.train.loop import Run
from zoedepth.train.processes import raw_gradients, several_processes, total


class RelativeModel(nn.Module):
    """The part of the model that stage 1 trains; parameters have the names they have in the model."""

    def __init__(self, model: DepthModel) -> None:
        super().__init__()
        assert isinstance(model, ZoeDepth)  # TrainConfig refuses others
        self.encoder = model.encoder
        self.decoder = model.decoder

    def forward(self, pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 height width"]:
        """Relative depth at network resolution."""
        return upsample(self.decoder(self.encoder(normalize(pixels))).relative, pixels.shape[-2:])


def train_relative(
    config: TrainConfig,
    *,
    data: Mapping[str, str | Path],
    out: Path,
    init: str | None = None,
    devices: int | None = None,
    n_nodes: int = 1,
) -> Path:
    """Train, or go on with what is in ``out``; returns the last checkpoint, with which stage 2 can start.

    Data of depth and of disparity are both welcome. For the arguments see ``Run``.
    """
    with Run(config, part=RelativeModel, data=data, out=out, init=init, devices=devices, n_nodes=n_nodes) as run:
        state = run.state
        for batch in run.batches():
            relative = run.network(batch.pixels)
            tasks, n_images = task_losses(relative, batch, run)
            present = n_images > 0
            if config.task_weights == "images":
                weights = n_images / n_images.sum().clamp(min=1)
            elif not present.any():
                weights = torch.zeros_like(n_images)
            else:
                solved = state.task_weights
                if solved is None or run.is_turn(config.pareto_every) or not _covers(solved, present):
                    solved = state.task_weights = pareto_weights(tasks, present, config, run)
                weights = solved.nan_to_num() * present
                weights = weights / weights.sum()
            loss = (weights * tasks).sum()
            shown = (
                {source.name: i for i, source in enumerate(run.sources) if present[i]} if len(run.sources) > 1 else {}
            )
            numbers = {"ssi": float((tasks.detach() * n_images).sum() / n_images.sum().clamp(min=1))}
            numbers |= {f"ssi/{name}": tasks[i].item() for name, i in shown.items()}
            numbers |= {f"weight/{name}": weights[i].item() for name, i in shown.items()}
            run.learn(loss, batch, numbers)
        return run.last_checkpoint


def task_losses(
    relative: Float[Tensor, "batch 1 height width"], batch: Batch, run: Run
) -> tuple[Float[Tensor, " tasks"], Float[Tensor, " tasks"]]:
    """The mean loss of each data set's images, of all processes, and how many these are; 0 where there are none."""
    config = run.config
    with_term = torch.tensor([float(source.gradient_term) for source in run.sources], device=relative.device)
    images, counted = losses.scale_and_shift_invariant(
        relative,
        batch.target,
        batch.mask,
        trim=config.trim,
        gradient_weight=config.gradient_weight * with_term[batch.source],
    )
    member = (batch.source[:, None] == torch.arange(len(run.sources), device=relative.device)) & counted[:, None]
    n_images = total(member.sum(0).float())
    return total((images[:, None] * member).sum(0)) / n_images.clamp(min=1), n_images


def pareto_weights(
    tasks: Float[Tensor, " tasks"], present: Bool[Tensor, " tasks"], config: TrainConfig, run: Run
) -> Float[Tensor, " tasks"]:
    """The weights of the multi-objective step for the data sets of this batch; NaN for the others."""
    model = run.state.model
    part = model.decoder if config.pareto_parameters == "decoder" and isinstance(model, ZoeDepth) else run.network
    parameters = [parameter for parameter in part.parameters() if parameter.requires_grad]
    rows = []
    for task in tasks[present]:
        with raw_gradients():
            found = torch.autograd.grad(task, parameters, retain_graph=True, allow_unused=True)
        rows.append(torch.cat([gradient.float().flatten() for gradient in found if gradient is not None]))
    gradients = torch.stack(rows)
    if several_processes():
        distributed.all_reduce(gradients)
        gradients /= distributed.get_world_size()
    gram = normalized(gradients @ gradients.T, tasks[present].detach(), config.pareto_normalizer)
    weights = torch.full_like(tasks, torch.nan)
    weights[present] = min_norm_weights(gram).to(weights)
    return weights


def _covers(weights: Float[Tensor, " tasks"], present: Bool[Tensor, " tasks"]) -> bool:
    """Whether these weights say something of every data set of a batch, and not that all of them are worth nothing."""
    return bool(weights[present].sum() > 0)  # NaN is not
