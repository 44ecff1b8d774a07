"""The batches of a training: which samples this process reads at which step."""

import signal
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from time import monotonic
from typing import TYPE_CHECKING, cast

import torch
from torch.utils.data import DataLoader

from zoedepth.data.mix import Component, Mixture, Positions
from zoedepth.data.sample import Batch, Samples, collate
from zoedepth.errors import InputError, ZoeDepthError
from zoedepth.train.config import SourceConfig, TrainConfig
from zoedepth.train.sources import augmentations

if TYPE_CHECKING:
    from lightning_fabric import Fabric


class Batches(Iterator[Batch]):
    """An iterator over batches that counts the seconds spent waiting for them.

    Args:
        loader: gives the batches, on the device of the training.
    """

    def __init__(self, loader: Iterable[Batch]) -> None:
        self._batches = iter(loader)
        self._waited = 0.0

    def __next__(self) -> Batch:
        """Return the next batch, its pixels in the order that convolutions like best (channels last).

        Raises:
            InputError: samples cannot be read.
        """
        asked = monotonic()
        try:
            batch = next(self._batches)
        except (StopIteration, KeyboardInterrupt):
            raise
        except Exception as error:
            # From another process, an error comes with all of that process's calls as its message.
            lines = [line for line in str(error).splitlines() if line.strip()] or [repr(error)]
            if isinstance(error, ZoeDepthError) and len(lines) == 1:
                raise
            raise InputError(f"samples cannot be read: {lines[-1].strip()}") from error
        self._waited += monotonic() - asked
        return batch._replace(pixels=batch.pixels.contiguous(memory_format=torch.channels_last))

    def take_waited(self) -> float:
        """Return the seconds waited since the last call."""
        waited, self._waited = self._waited, 0.0
        return waited

    def close(self) -> None:
        """End the processes that read samples."""
        self._batches = iter(())


def load_batches(
    config: TrainConfig,
    fabric: "Fabric",
    training: Sequence[tuple[SourceConfig, Samples]],
    *,
    first_step: int,
) -> Batches:
    """Return this process's share of all steps from ``first_step`` on; ``config.accumulate`` batches make a step.

    Which samples a batch has depends on the seed and the step alone, so a resumed training reads what an uninterrupted
    one would have read.

    Args:
        config: the configuration of the training.
        fabric: says which of the processes this is, and on which device it computes.
        training: the data sets to train on.
        first_step: number of steps already taken.
    """
    mixture = Mixture(
        [Component(subset, augmentations(source, config), source.weight) for source, subset in training],
        seed=config.seed,
        turn=config.batch_size if config.mix_by == "batch" else 1,
    )
    positions = Positions(
        first_step * config.accumulate,
        config.steps * config.accumulate,
        batch_size=config.batch_size // config.accumulate,
        rank=fabric.global_rank,
        n_processes=fabric.world_size,
    )
    # Stage 1 knows no domains: it gives every image the index 0.
    domains = tuple(domain.name for domain in config.model.domains)[: 1 if config.stage == "relative" else None]
    loader = DataLoader(
        mixture,
        batch_sampler=positions,
        num_workers=config.n_workers,
        collate_fn=partial(collate, domains=domains),
        # A generator of its own: numbers drawn from the global one would differ after resuming.
        generator=torch.Generator(),
        prefetch_factor=4 if config.n_workers else None,
        worker_init_fn=_ignore_the_first_signal,
    )
    return Batches(cast(Iterable[Batch], fabric.setup_dataloaders(loader, use_distributed_sampler=False)))


def _ignore_the_first_signal(_: int) -> None:
    """Leave the first SIGTERM, and the first Ctrl-C, to the process that trains: the last step needs samples.

    Schedulers and terminals send them to all processes. The second one ends the process, so that one that hangs can be
    ended.
    """
    for asked in (signal.SIGTERM, signal.SIGINT):
        signal.signal(asked, lambda number, _: signal.signal(number, signal.SIG_DFL))
