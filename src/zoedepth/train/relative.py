"""Stage 1: train encoder and decoder on relative depth, by a loss that ignores scale and shift (paper section 3.1)."""

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
from zoedepth.train.processes import launch_fabric, raw_gradients, several_processes, total
from zoedepth.train.report import report
from zoedepth.train.run import Run, last_checkpoint, set_up
from zoedepth.train.step import backward, begin_step, means, take_step


class RelativeModel(nn.Module):
    """The part of the model that stage 1 trains. Its parameters have the names that they have in the model."""

    def __init__(self, model: DepthModel) -> None:
        super().__init__()
        assert isinstance(model, ZoeDepth)  # TrainConfig refuses baselines in stage 1
        self.encoder = model.encoder
        self.decoder = model.decoder

    def forward(self, pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 height width"]:
        """Return relative depth at the resolution of the pixels."""
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
    """Train encoder and decoder on depth and disparity, or go on with the run that is in ``out``.

    Args:
        config: the configuration, most often a recipe's; its stage is "relative".
        data: name of a source of the configuration → where its data is (``zoedepth.opening.open_dataset``).
        out: folder of the run: checkpoints, log, pictures.
        init: starting weights, see ``zoedepth.train.start.start_from``; not read when resuming.
        devices: processes on each machine, see ``zoedepth.train.processes.launch_fabric``.
        n_nodes: machines.

    Returns:
        The folder of the last checkpoint, with which stage 2 can start.

    Raises:
        InputError, TrainingError, KeyboardInterrupt: see ``zoedepth.train.metric.train_metric``.
    """
    fabric = launch_fabric(config, devices=devices, n_nodes=n_nodes)
    with set_up(config, fabric, part=RelativeModel, data=data, out=out, init=init) as run:
        while run.state.step < config.steps:
            begin_step(run)
            numbers_of: list[Mapping[str, float]] = []
            batches: list[Batch] = []
            for i in range(config.accumulate):
                batch = next(run.batches)
                # Forward.
                relative = run.network(batch.pixels)
                # Loss.
                tasks, n_images = task_losses(relative, batch, run)
                weights = task_weights(tasks, n_images, run)
                loss = (weights * tasks).sum()
                # Backward.
                backward(run, loss, batch, complete=i == config.accumulate - 1)
                numbers_of.append(_numbers(tasks, n_images, weights, run))
                batches.append(batch)
            # Step.
            numbers = {**means(numbers_of), "gradient_norm": take_step(run, batches)}
            # Report.
            report(run, numbers, batches[-1])
        return last_checkpoint(run)


def task_losses(
    relative: Float[Tensor, "batch 1 height width"], batch: Batch, run: Run
) -> tuple[Float[Tensor, " tasks"], Float[Tensor, " tasks"]]:
    """Return the mean loss over each data set's images, and the number of these images, of all processes.

    Images without known depth do not count. A data set without images has the loss 0 and the number 0.
    """
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


def task_weights(
    tasks: Float[Tensor, " tasks"], n_images: Float[Tensor, " tasks"], run: Run
) -> Float[Tensor, " tasks"]:
    """Return the weight of each data set's loss; they add up to 1 unless no image of the batch counts.

    With ``task_weights="pareto"`` the multi-objective step solves for them every ``pareto_every`` steps, and in between
    if the last solution does not cover the data sets of this batch. ``run.state`` keeps the last solution.
    """
    config, state, present = run.config, run.state, n_images > 0
    if config.task_weights == "images":
        return n_images / n_images.sum().clamp(min=1)
    if not present.any():
        return torch.zeros_like(n_images)
    solved = state.task_weights
    if solved is None or state.step % config.pareto_every == 0 or not _covers(solved, present):
        solved = state.task_weights = pareto_weights(tasks, present, run)
    weights = solved.nan_to_num() * present
    return weights / weights.sum()


def pareto_weights(
    tasks: Float[Tensor, " tasks"], present: Bool[Tensor, " tasks"], run: Run
) -> Float[Tensor, " tasks"]:
    """Solve the multi-objective step for the data sets that are present in this batch; the others get NaN."""
    config, model = run.config, run.state.model
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
    """Return True if there is a weight for every data set present, and not all of these weights are 0."""
    return bool(weights[present].sum() > 0)  # a sum with a NaN in it is not


def _numbers(
    tasks: Float[Tensor, " tasks"], n_images: Float[Tensor, " tasks"], weights: Float[Tensor, " tasks"], run: Run
) -> dict[str, float]:
    """Return what the log says of a batch: the mean loss of its images; with several data sets also each one's."""
    numbers = {"ssi": float((tasks.detach() * n_images).sum() / n_images.sum().clamp(min=1))}
    if len(run.sources) > 1:
        shown = {source.name: i for i, source in enumerate(run.sources) if n_images[i] > 0}
        numbers |= {f"ssi/{name}": tasks[i].item() for name, i in shown.items()}
        numbers |= {f"weight/{name}": weights[i].item() for name, i in shown.items()}
    return numbers
