"""What the two stages share: data, checkpoints, logs. The steps themselves are in ``relative.py`` and ``metric.py``."""

import json
import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from torch import nn
from torch.utils.data import DataLoader, Subset

from zoedepth.data import augment
from zoedepth.data.mix import Mixture, Positions, Source
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import collate
from zoedepth.errors import InputError, MissingExtraError
from zoedepth.train.config import SourceConfig, TrainConfig

if TYPE_CHECKING:
    from lightning.fabric import Fabric

console = Console(stderr=True)


def load_sources(
    config: TrainConfig, data: Mapping[str, Path]
) -> tuple[list[tuple[SourceConfig, Subset]], dict[str, Subset]]:
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
    for name, path in data.items():
        dataset = PairDataset(path, split="train")
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
        steps.append(augment.fit_crop(config.model.size, max_zoom=source.max_zoom))
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


def _limit_by_domain(sample: Any, rng: Any, *, ranges: dict[str, tuple[float, float]]) -> Any:
    """Depth outside the range of the sample's domain counts as unknown."""
    low, high = ranges.get(sample.domain) or next(iter(ranges.values()))
    return augment.limit_depth(low, high)(sample, rng)


def build_loader(
    config: TrainConfig, training: list[tuple[SourceConfig, Subset]], *, first_step: int, fabric: "Fabric"
) -> DataLoader:
    """Batches of every step from ``first_step`` on, this process's share."""
    mixture = Mixture(
        [Source(subset, augmentations(source, config), source.weight) for source, subset in training],
        seed=config.seed,
        turn=config.batch_size if config.mix_by == "batch" else 1,
    )
    # Stage 1 knows no domains: to it they are all the first.
    domains = tuple(domain.name for domain in config.model.domains)[: 1 if config.stage == "relative" else None]
    positions = Positions(
        first_step, config.steps, batch_size=config.batch_size, rank=fabric.global_rank, n_processes=fabric.world_size
    )
    return DataLoader(
        mixture,
        batch_sampler=positions,  # type: ignore[arg-type]  # any iterable of lists will do
        num_workers=config.n_workers,
        collate_fn=partial(collate, domains=domains),
        persistent_workers=False,
        prefetch_factor=4 if config.n_workers else None,
    )


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
        record = {"step": step, **{name: round(value, 6) for name, value in values.items()}, "images_per_s": round(rate, 2)}
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
            kept = [line for line in lines if json.loads(line)["step"] <= step]
            self._jsonl.write_text("".join(f"{line}\n" for line in kept), encoding="utf-8")


def stop_if_not_finite(loss: torch.Tensor, step: int, names: list[str]) -> None:
    """Raises:
    FloatingPointError: the loss is NaN or infinite; the images of the step are named.
    """
    if not math.isfinite(loss.item()):
        raise FloatingPointError(
            f"the loss is {loss.item()} at step {step + 1}; the images were {names[:4]}... "
            "Check their depth, or lower optim.learning_rate. The last checkpoint is intact"
        )


