"""What the two stages share: data, steps, checkpoints, logs. The losses are in relative.py and metric.py."""

import math
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, Subset

from zoedepth.build import build_model
from zoedepth.data.mix import Mixture, Positions, Source
from zoedepth.data.sample import Batch, Sample, collate
from zoedepth.errors import TrainingError
from zoedepth.model.interface import DepthModel
from zoedepth.train.config import SourceConfig, TrainConfig
from zoedepth.train.log import Log
from zoedepth.train.optim import build_optimizer, set_rates
from zoedepth.train.pictures import predictions_sheet
from zoedepth.train.processes import launch_fabric, resolve, several_processes, total
from zoedepth.train.sources import augmentations, load_sources
from zoedepth.train.start import start_from
from zoedepth.train.state import TrainState, averaged, checkpoints
from zoedepth.train.validate import validate


class Run:
    """One run of one stage, from its first step or from the last checkpoint in its folder. Use it as a context.

    Args:
        config: the recipe.
        part: the part of the model that is trained; the network of the run.
        data: NAME of a source of the recipe → where its data is.
        out: the run's folder.
        init: starting weights, see ``zoedepth.train.start.start_from``; not read when resuming.
        devices, n_nodes: processes on each machine, machines; see ``zoedepth.train.processes.launch_fabric``.
    """

    def __init__(
        self,
        config: TrainConfig,
        *,
        part: Callable[[DepthModel], nn.Module],
        data: Mapping[str, str | Path],
        out: Path,
        init: str | None,
        devices: int | None,
        n_nodes: int,
    ) -> None:
        self.config = config
        self.out = out
        self.fabric = launch_fabric(config, devices=devices, n_nodes=n_nodes)
        self.fabric.seed_everything(config.seed, workers=True, verbose=False)
        training, self.validation = load_sources(config, data)
        self.sources = [source for source, _ in training]

        model = build_model(config.model)
        finished = checkpoints(out)
        started_from = f"{finished[-1].name} of {out}" if finished else start_from(model, init)
        if config.gradient_checkpointing:
            model.encoder.checkpoint_gradients()
        network = part(model)
        optimizer = build_optimizer(network, config.optim)
        self.state = TrainState(model, optimizer, averaged(model, config.ema_decay))
        self.identity = {"data": {name: str(path) for name, path in sorted(data.items())}}
        if finished:
            self.state.load(finished[-1], config, self.identity)
        n_images = sum(len(subset) for _, subset in training)
        self.fabric.print(
            f"{config.stage} from {started_from}: steps {self.state.step} to {config.steps}, {n_images} images"
        )
        self.network, self.optimizer = self.fabric.setup(network, optimizer)
        self._loader = self._build_loader(training)
        self._log = Log(out, config, first_step=self.state.step, active=self.fabric.is_global_zero)
        self._part_of_step = 0
        self._sums: dict[str, float] = {}
        self._waited = 0.0
        self._signal: int | None = None

    def __enter__(self) -> "Run":
        self._handlers = {}
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._handlers[number] = signal.signal(number, self._note_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self._log.close()

    @property
    def last_checkpoint(self) -> Path:
        """The newest checkpoint in the folder."""
        self.fabric.barrier()
        return checkpoints(self.out)[-1]

    def batches(self) -> Iterator[Batch]:
        """This process's share of every step that is left, with model and rates ready for it.

        With gradient accumulation a step has several batches.
        """
        model, config = self.state.model, self.config
        loader = iter(self._loader)
        while True:
            asked = time.monotonic()
            try:
                batch = next(loader)
            except StopIteration:
                return
            self._waited += time.monotonic() - asked
            model.train()
            if config.freeze_batch_norm:
                freeze_batch_norm(model.encoder)
            set_rates(self.optimizer, self.state.step, config.steps, config.optim)
            yield batch._replace(pixels=batch.pixels.contiguous(memory_format=torch.channels_last))

    def learn(self, loss: Tensor, batch: Batch, numbers: Mapping[str, float]) -> None:
        """Backward; after the last batch of a step: clip, optimizer step, moving average, log, validate, checkpoint.

        Args:
            loss: the same on all processes, see ``zoedepth.train.processes.total``.
            batch: what it was made of.
            numbers: what to log of it.

        Raises:
            TrainingError: loss or gradients are not finite; the images are named, the last checkpoint is intact.
            KeyboardInterrupt: the run was asked to end, and a checkpoint of this step is written.
        """
        config, state = self.config, self.state
        if not math.isfinite(loss.item()):
            raise TrainingError(self._explain("loss", loss.item(), batch))
        self._part_of_step += 1
        complete = self._part_of_step == config.accumulate
        with self.fabric.no_backward_sync(self.network, enabled=not complete):
            self.fabric.backward(loss / config.accumulate)
        for name, value in numbers.items():
            self._sums[name] = self._sums.get(name, 0.0) + value / config.accumulate
        if not complete:
            return
        norm = self._clip(batch)
        self.optimizer.step()
        self.optimizer.zero_grad()
        if state.ema is not None:
            state.ema.update_parameters(state.model)
        state.step += 1
        self._report({**self._sums, "gradient_norm": norm}, batch)
        self._part_of_step, self._sums = 0, {}

    def is_turn(self, every: int) -> bool:
        """Whether what happens every so many steps happens at this one, the first included."""
        return self.state.step % every == 0

    def _clip(self, batch: Batch) -> float:
        """Clip the gradients; their norm before."""
        clipped = self.fabric.clip_gradients(
            self.network, self.optimizer, max_norm=self.config.optim.clip, error_if_nonfinite=False
        )
        norm = cast(Tensor, clipped).item()
        # Half precision's loss scaling meets infinite gradients and skips the step; elsewhere they would end the run.
        if resolve(self.config.precision) != "16-mixed" and not math.isfinite(norm):
            raise TrainingError(self._explain("norm of the gradients", norm, batch))
        return norm

    def _report(self, numbers: Mapping[str, float], batch: Batch) -> None:
        """Log, validate, draw and write a checkpoint, each when its step has come."""
        config, step = self.config, self.state.step
        last = step == config.steps
        interrupted = self._asked_to_end()
        if self.fabric.is_global_zero:
            if step % config.log_every == 0 or last:
                rates = {f"rate/{group['name']}": group["lr"] for group in self.optimizer.param_groups}
                train = {f"train/{name}": float(value) for name, value in numbers.items()}
                self._log.write(step, {**train, **rates}, waited=self._waited)
                self._waited = 0.0
            with self._log.paused():
                if step % config.validate_every == 0 or last:
                    self._look(step, batch)
                if step % config.checkpoint_every == 0 or last or interrupted:
                    self.state.save(self.out, config, self.identity)
        if interrupted and not last:
            self.fabric.barrier()
            raise KeyboardInterrupt(f"step {step} is saved; the same command goes on from there")

    def _look(self, step: int, batch: Batch) -> None:
        """Validate and draw."""
        if self.validation:
            self._log.write(step, validate(self.state.result, self.validation, stage=self.config.stage))
        if self.config.pictures:
            sheet = predictions_sheet(self.state.result, self._shown(batch), stage=self.config.stage)
            self._log.picture(step, sheet)

    def _shown(self, batch: Batch) -> list[Sample]:
        """The samples of the pictures: held-out ones of every set, or else those of the batch."""
        n = self.config.pictures
        held_out = [subset[i] for subset in self.validation.values() for i in range(min(len(subset), n))]
        return (
            held_out[:: max(1, len(held_out) // n)][:n]
            if held_out
            else batch.samples([domain.name for domain in self.config.model.domains])[:n]
        )

    def _note_signal(self, number: int, _: object) -> None:
        """The step is finished first; a second signal ends the process at once."""
        self._signal = number
        signal.signal(number, self._handlers[number])

    def _asked_to_end(self) -> bool:
        """Whether any process has got a signal: all have to stop after the same step."""
        mine = float(self._signal is not None)
        return bool(total(torch.tensor(mine, device=self.fabric.device)) > 0) if several_processes() else mine > 0

    def _explain(self, what: str, value: float, batch: Batch) -> str:
        return (
            f"the {what} is {value} at step {self.state.step + 1}; the images were "
            f"{batch.names}. Check their depth, or lower optim.learning_rate. The last checkpoint is intact"
        )

    def _build_loader(self, training: list[tuple[SourceConfig, "Subset[Sample]"]]) -> Iterable[Batch]:
        config, fabric = self.config, self.fabric
        size = config.batch_size // config.accumulate
        mixture = Mixture(
            [Source(subset, augmentations(source, config), source.weight) for source, subset in training],
            seed=config.seed,
            turn=config.batch_size if config.mix_by == "batch" else 1,
        )
        positions = Positions(
            self.state.step * config.accumulate,
            config.steps * config.accumulate,
            batch_size=size,
            rank=fabric.global_rank,
            n_processes=fabric.world_size,
        )
        # Stage 1 knows no domains: to it they are all the first.
        domains = tuple(domain.name for domain in config.model.domains)[: 1 if config.stage == "relative" else None]
        loader = DataLoader(
            mixture,
            batch_sampler=positions,
            num_workers=config.n_workers,
            collate_fn=partial(collate, domains=domains),
            # Its own: what a loader draws from the global generator would differ after a resume.
            generator=torch.Generator(),
            prefetch_factor=4 if config.n_workers else None,
        )
        return cast(Iterable[Batch], fabric.setup_dataloaders(loader, use_distributed_sampler=False))


def freeze_batch_norm(model: nn.Module) -> None:
    """Put all batch norms into evaluation mode: their statistics stay, their weights still learn."""
    for module in model.modules():
        if isinstance(module, nn.modules.batchnorm._BatchNorm):
            module.eval()
