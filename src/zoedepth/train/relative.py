"""Stage 1: encoder and decoder on relative depth, with a loss that knows no scale and shift (paper section 3.1)."""

from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from zoedepth import losses
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.train.config import TrainConfig
from zoedepth.train.loop import Log, build_loader, freeze_batch_norm, launch_fabric, load_sources, stop_if_not_finite
from zoedepth.train.metric import training_size
from zoedepth.train.optim import build_optimizer, set_rates
from zoedepth.train.start import start_from
from zoedepth.train.state import TrainState, averaged, checkpoints


class RelativeModel(nn.Module):
    """The part of the model that stage 1 trains."""

    def __init__(self, model: ZoeDepth) -> None:
        super().__init__()
        self.encoder = model.encoder
        self.decoder = model.decoder

    def forward(self, pixels: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 1 height width"]:
        """Relative depth at network resolution."""
        relative = self.decoder(self.encoder(2 * pixels - 1)).relative
        return F.interpolate(relative, pixels.shape[-2:], mode="bilinear", align_corners=True)


def train_relative(
    config: TrainConfig, *, data: dict[str, Path], out: Path, start: str | None, devices: int = 1, n_nodes: int = 1
) -> Path:
    """Train, or go on with what is in ``out``; returns the last checkpoint, with which stage 2 can start.

    Args: as of :func:`zoedepth.train.metric.train_metric`; depth and disparity data are both welcome.
    """
    fabric = launch_fabric(config, devices=devices, n_nodes=n_nodes)
    fabric.seed_everything(config.seed, workers=True, verbose=False)
    training, _ = load_sources(config, data)

    model = ZoeDepth(config.model).to(memory_format=torch.channels_last)
    resume = checkpoints(out)
    started_from = "" if resume else start_from(model, start)
    relative_model = RelativeModel(model)
    optimizer = build_optimizer(relative_model, config.optim)
    state = TrainState(model, optimizer, averaged(model, config.ema_decay))
    if resume:
        state.load(resume[-1], config)
        started_from = f"{resume[-1].name} of {out}"
    fabric.print(f"stage 1 from {started_from}: steps {state.step} to {config.steps}, {training_size(training)} images")

    ddp_model, optimizer = fabric.setup(relative_model, optimizer)
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
            relative = ddp_model(batch.pixels.contiguous(memory_format=torch.channels_last))
            loss = losses.scale_and_shift_invariant(relative, batch.target, batch.mask, trim=config.trim)
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
                log.write(state.step, {"train/ssi": loss.item(), "train/gradient_norm": float(norm)})
            if (state.step % config.checkpoint_every == 0 or last) and fabric.is_global_zero:
                state.save(out, config)
    finally:
        log.close()
    fabric.barrier()
    return checkpoints(out)[-1]
