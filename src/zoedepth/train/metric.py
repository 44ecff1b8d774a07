"""Stage 2: the whole model on depth in metres (paper section 3.3)."""

from pathlib import Path

import torch

from zoedepth import losses
from zoedepth.data.sample import Batch
from zoedepth.model.zoedepth import DepthOutput, ZoeDepth
from zoedepth.train.config import TrainConfig
from zoedepth.train.loop import Log, build_loader, freeze_batch_norm, launch_fabric, load_sources, stop_if_not_finite
from zoedepth.train.optim import build_optimizer, set_rates
from zoedepth.train.start import start_from
from zoedepth.train.state import TrainState, averaged, checkpoints
from zoedepth.train.validate import validate


def train_metric(
    config: TrainConfig, *, data: dict[str, Path], out: Path, start: str | None, devices: int = 1, n_nodes: int = 1
) -> Path:
    """Train, or go on with what is in ``out``; returns the last checkpoint.

    Args:
        config: a recipe of stage "metric".
        data: NAME of a source of the recipe → CSV file or folder.
        out: the run's folder.
        start: starting weights, see :func:`zoedepth.train.start.start_from`; not read when resuming.
        devices, n_nodes: processes on each machine, machines.
    """
    fabric = launch_fabric(config, devices=devices, n_nodes=n_nodes)
    fabric.seed_everything(config.seed, workers=True, verbose=False)
    training, validation = load_sources(config, data)

    model = ZoeDepth(config.model).to(memory_format=torch.channels_last)
    resume = checkpoints(out)
    started_from = "" if resume else start_from(model, start)
    optimizer = build_optimizer(model, config.optim)
    state = TrainState(model, optimizer, averaged(model, config.ema_decay))
    if resume:
        state.load(resume[-1], config)
        started_from = f"{resume[-1].name} of {out}"
    fabric.print(f"stage 2 from {started_from}: steps {state.step} to {config.steps}, {training_size(training)} images")

    ddp_model, optimizer = fabric.setup(model, optimizer)
    loader = fabric.setup_dataloaders(
        build_loader(config, training, first_step=state.step, fabric=fabric), use_distributed_sampler=False
    )
    log = Log(out, config, first_step=state.step, active=fabric.is_global_zero)
    try:
        for batch in loader:
            model.train()
            if config.freeze_batch_norm:
                freeze_batch_norm(model.encoder)
            set_rates(optimizer, state.step, config.steps, config.optim)

            # ------------------------------------------------------------ one step
            pixels = batch.pixels.contiguous(memory_format=torch.channels_last)
            output = ddp_model(pixels, domain=batch.domain if config.route_by_label else None)
            terms = metric_losses(output, batch, domain_weight=config.domain_weight)
            loss = sum(terms.values())
            stop_if_not_finite(loss, state.step, batch.names)
            fabric.backward(loss)
            norm = fabric.clip_gradients(ddp_model, optimizer, max_norm=config.optim.clip, error_if_nonfinite=False)
            optimizer.step()
            optimizer.zero_grad()
            if state.ema is not None:
                state.ema.update_parameters(model)
            state.step += 1
            # --------------------------------------------------------------------

            last = state.step == config.steps
            if state.step % config.log_every == 0 or last:
                numbers = {f"train/{name}": term.item() for name, term in terms.items()}
                log.write(state.step, {**numbers, "train/gradient_norm": float(norm), "train/rate": optimizer.param_groups[-1]["lr"]})
            if validation and (state.step % config.validate_every == 0 or last) and fabric.is_global_zero:
                log.write(state.step, validate(state.result, validation))
            if (state.step % config.checkpoint_every == 0 or last) and fabric.is_global_zero:
                state.save(out, config)
    finally:
        log.close()
    fabric.barrier()
    return checkpoints(out)[-1]


def metric_losses(output: DepthOutput, batch: Batch, *, domain_weight: float) -> dict[str, torch.Tensor]:
    """SILog of the depth and, where the router has scores, cross-entropy against the domain labels."""
    terms = {"silog": losses.silog(output.depth, batch.target, batch.mask)}
    if output.domain_logits is not None and domain_weight > 0:
        terms["domain"] = domain_weight * losses.domain_cross_entropy(output.domain_logits, batch.domain)
    return terms


def training_size(training: list) -> int:
    """Number of images to train on."""
    return sum(len(subset) for _, subset in training)
