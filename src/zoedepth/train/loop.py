"""What the two stages share: data, processes, checkpoints, logs. The losses are in relative.py and metric.py."""

import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from torch import nn
from torch.utils.data import DataLoader, Subset

from zoedepth.data import augment
from zoedepth.data.mix import Mixture, Positions, Source
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Batch, Sample, collate
from zoedepth.errors import InputError, MissingExtraError, TrainingError
from zoedepth.images import atomic_path
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.train.config import SourceConfig, TrainConfig
from zoedepth.train.optim import build_optimizer, set_rates
from zoedepth.train.start import start_from
from zoedepth.train.state import TrainState, averaged, checkpoints
from zoedepth.train.validate import validate

if TYPE_CHECKING:
    from lightning_fabric import Fabric

console = Console(stderr=True)


class Run:
    """One run of one stage, from its first step or from the last checkpoint in its folder. Use it as a context.

    Args:
        config: the recipe.
        part: the part of the model that is trained; the network of the run.
        data: NAME of a source of the recipe → CSV file or folder.
        out: the run's folder.
        start: starting weights, see :func:`zoedepth.train.start.start_from`; not read when resuming.
        devices, n_nodes: processes on each machine, machines.
    """

    def __init__(
        self,
        config: TrainConfig,
        *,
        part: Callable[[ZoeDepth], nn.Module],
        data: Mapping[str, Path],
        out: Path,
        start: str | None,
        devices: int,
        n_nodes: int,
    ) -> None:
        self.config = config
        self.out = out
        self.fabric = launch_fabric(config, devices=devices, n_nodes=n_nodes)
        self.fabric.seed_everything(config.seed, workers=True, verbose=False)
        training, self.validation = load_sources(config, data)

        model = ZoeDepth(config.model).to(memory_format=torch.channels_last)
        finished = checkpoints(out)
        started_from = f"{finished[-1].name} of {out}" if finished else start_from(model, start)
        network = part(model)
        optimizer = build_optimizer(network, config.optim)
        self.state = TrainState(model, optimizer, averaged(model, config.ema_decay))
        if finished:
            self.state.load(finished[-1], config)
        n_images = sum(len(subset) for _, subset in training)
        self.fabric.print(
            f"{config.stage} from {started_from}: steps {self.state.step} to {config.steps}, {n_images} images"
        )
        self.network, self.optimizer = self.fabric.setup(network, optimizer)
        self._loader = self._build_loader(training)
        self._log = Log(out, config, first_step=self.state.step, active=self.fabric.is_global_zero)

    def __enter__(self) -> "Run":
        return self

    def __exit__(self, *_: object) -> None:
        self._log.close()

    @property
    def last_checkpoint(self) -> Path:
        """The newest checkpoint in the folder."""
        self.fabric.barrier()
        return checkpoints(self.out)[-1]

    def batches(self) -> Iterator[Batch]:
        """This process's share of every step that is left, with model and rates ready for it."""
        model, config = self.state.model, self.config
        for batch in self._loader:
            model.train()
            if config.freeze_batch_norm:
                freeze_batch_norm(model.encoder)
            set_rates(self.optimizer, self.state.step, config.steps, config.optim)
            yield batch._replace(pixels=batch.pixels.contiguous(memory_format=torch.channels_last))

    def step(self, loss: torch.Tensor, batch: Batch) -> float:
        """Backward, clip, optimizer step, moving average; returns the norm of the gradients before clipping.

        Raises:
            TrainingError: loss or gradients are not finite; the images are named, the last checkpoint is intact.
        """
        if not math.isfinite(loss.item()):
            raise TrainingError(self._explain("loss", loss.item(), batch))
        self.fabric.backward(loss)
        clipped = self.fabric.clip_gradients(
            self.network, self.optimizer, max_norm=self.config.optim.clip, error_if_nonfinite=False
        )
        norm = cast(torch.Tensor, clipped).item()
        # Half precision's loss scaling meets infinite gradients and skips the step; elsewhere they would end the run.
        if self.config.precision != "16-mixed" and not math.isfinite(norm):
            raise TrainingError(self._explain("norm of the gradients", norm, batch))
        self.optimizer.step()
        self.optimizer.zero_grad()
        if self.state.ema is not None:
            self.state.ema.update_parameters(self.state.model)
        self.state.step += 1
        return norm

    def report(self, numbers: Mapping[str, float]) -> None:
        """Log, validate and write a checkpoint, each when its step has come."""
        config, step = self.config, self.state.step
        last = step == config.steps
        if step % config.log_every == 0 or last:
            self._log.write(step, {f"train/{name}": float(value) for name, value in numbers.items()})
        if not self.fabric.is_global_zero:
            return
        if self.validation and (step % config.validate_every == 0 or last):
            self._log.write(step, validate(self.state.result, self.validation))
        if step % config.checkpoint_every == 0 or last:
            self.state.save(self.out, config)

    def _explain(self, what: str, value: float, batch: Batch) -> str:
        return (
            f"the {what} is {value} at step {self.state.step + 1}; the images were "
            f"{batch.names}. Check their depth, or lower optim.learning_rate. The last checkpoint is intact"
        )

    def _build_loader(self, training: list[tuple[SourceConfig, "Subset[Sample]"]]) -> Iterable[Batch]:
        config, fabric = self.config, self.fabric
        mixture = Mixture(
            [Source(subset, augmentations(source, config), source.weight) for source, subset in training],
            seed=config.seed,
            turn=config.batch_size if config.mix_by == "batch" else 1,
        )
        positions = Positions(
            self.state.step,
            config.steps,
            batch_size=config.batch_size,
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


def load_sources(
    config: TrainConfig, data: Mapping[str, Path]
) -> tuple[list[tuple[SourceConfig, "Subset[Sample]"]], dict[str, "Subset[Sample]"]]:
    """(what to train on with its config, what to validate on by name), from ``--data NAME=PATH``.

    Raises:
        InputError: a name is not one of the recipe's sources, or the data does not suit the stage.
    """
    known = {source.name: source for source in config.sources}
    if unknown := sorted(set(data) - set(known)):
        raise InputError(f"unknown data {unknown}: this recipe has the sources {sorted(known)}")
    if not data:
        raise InputError(f"no data: give --data NAME=PATH for one or more of {sorted(known)}")
    training, validation = [], {}
    for name in (source.name for source in config.sources if source.name in data):  # not the order of the command line
        dataset = PairDataset(data[name], split="train")
        if config.stage == "metric" and "disparity" in dataset.kinds:
            raise InputError(f"{dataset.path} has disparity; stage 2 needs depth in metres")
        domains = {domain.name for domain in config.model.domains}
        if config.stage == "metric" and len(domains) > 1 and (others := set(dataset.domains) - domains):
            raise InputError(f"{dataset.path} has the domains {sorted(others)}, the model {sorted(domains)}")
        n_training = len(dataset) - config.holdout
        if n_training < 1:
            raise InputError(f"{dataset.path} has {len(dataset)} pairs: a holdout of {config.holdout} leaves none")
        training.append((known[name], Subset(dataset, range(n_training))))
        if config.holdout and "disparity" not in dataset.kinds:
            validation[name] = Subset(dataset, range(n_training, len(dataset)))
    return training, validation


def augmentations(source: SourceConfig, config: TrainConfig) -> list[augment.Augmentation]:
    """The augmentations of a source, in order."""
    domains = config.model.domains
    steps = [augment.kitti_crop()] if source.kitti_crop else []
    if source.crop == "fit":
        steps.append(augment.fit_crop(config.model.size, max_zoom=source.max_zoom, probability=source.zoom_probability))
    else:
        steps.append(augment.squeeze(config.model.size))
    steps += [augment.flip(), augment.rotate(degrees=source.rotate_degrees)]
    steps.append(
        augment.jitter_colors(
            probability=source.color_probability,
            gamma=source.gamma,
            brightness=source.brightness,
            channel_gain=source.channel_gain,
            saturation=source.saturation,
        )
    )
    ranges = {domain.name: (domain.min_depth, domain.max_depth) for domain in domains}
    steps.append(partial(_limit_by_domain, ranges=ranges))
    if config.stage == "relative":
        steps.append(augment.to_disparity())
    return steps


def _limit_by_domain(sample: Sample, rng: np.random.Generator, *, ranges: dict[str, tuple[float, float]]) -> Sample:
    """Depth outside the range of the sample's domain counts as unknown."""
    low, high = ranges.get(sample.domain) or next(iter(ranges.values()))
    return augment.limit_depth(low, high)(sample, rng)


def launch_fabric(config: TrainConfig, *, devices: int, n_nodes: int) -> "Fabric":
    """Fabric on this machine's accelerator or CPU; several processes by DDP, also under torchrun.

    Raises:
        MissingExtraError: Lightning Fabric is not installed.
    """
    try:
        from lightning_fabric import Fabric
        from lightning_fabric.strategies import DDPStrategy
    except ImportError as error:
        raise MissingExtraError("train", "zoedepth train") from error
    several = devices * n_nodes > 1
    # A batch may use some heads only, so some parameters may get no gradient.
    strategy = DDPStrategy(find_unused_parameters=True) if several else "auto"
    fabric = Fabric(
        accelerator="auto", devices=devices, num_nodes=n_nodes, precision=config.precision, strategy=strategy
    )
    fabric.launch()
    return fabric


def freeze_batch_norm(model: nn.Module) -> None:
    """Put all batch norms into evaluation mode: their statistics stay, their weights still learn."""
    for module in model.modules():
        if isinstance(module, nn.modules.batchnorm._BatchNorm):
            module.eval()


class Log:
    """Console, JSONL and TensorBoard, from the first process only."""

    def __init__(self, folder: Path, config: TrainConfig, *, first_step: int, active: bool) -> None:
        self.active = active
        self._started = time.monotonic()
        self._first_step = first_step
        self._batch_size = config.batch_size
        if not active:
            return
        from torch.utils.tensorboard import SummaryWriter

        folder.mkdir(parents=True, exist_ok=True)
        self._jsonl = folder / "log.jsonl"
        self._forget_after(first_step)
        self._tensorboard = SummaryWriter(str(folder / "tensorboard"), purge_step=first_step)
        self._progress = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
            TextColumn("{task.fields[state]}"), console=console,
        )  # fmt: skip
        self._task = self._progress.add_task(config.stage, total=config.steps, completed=first_step, state="")
        self._progress.start()

    def write(self, step: int, values: Mapping[str, float]) -> None:
        """Log named numbers of a step."""
        if not self.active:
            return
        seconds = time.monotonic() - self._started
        rate = (step - self._first_step) * self._batch_size / max(seconds, 1e-9)
        numbers = {name: round(value, 6) for name, value in values.items()}
        record = {"step": step, **numbers, "images_per_s": round(rate, 2)}
        with self._jsonl.open("a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")
        for name, value in values.items():
            self._tensorboard.add_scalar(name, value, step)
        text = " ".join(f"{name.removeprefix('train/')}={value:.4g}" for name, value in values.items())
        self._progress.update(self._task, completed=step, state=text)
        if not console.is_terminal or any(name.startswith("validation/") for name in values):
            self._progress.console.print(f"step {step}: {text} ({rate:.1f} images/s)", highlight=False)

    def close(self) -> None:
        """Finish the progress bar and the files."""
        if self.active:
            self._progress.stop()
            self._tensorboard.close()

    def _forget_after(self, step: int) -> None:
        """A run resumed from an earlier step repeats the steps logged after it: drop them."""
        if self._jsonl.is_file():
            lines = self._jsonl.read_text(encoding="utf-8").splitlines()
            with atomic_path(self._jsonl) as part:
                part.write_text("".join(f"{line}\n" for line in lines if _logged_step(line) <= step), encoding="utf-8")


def _logged_step(line: str) -> float:
    """The step of a line of the log; infinite for a line that a kill has cut off."""
    try:
        return json.loads(line)["step"]
    except ValueError:
        return math.inf
