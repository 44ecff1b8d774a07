"""A run: one training of one stage, from its first step or from the last checkpoint in its folder."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torch import nn
from torch.utils.data import Subset

from zoedepth.build import build_model
from zoedepth.data.sample import Sample
from zoedepth.model.interface import DepthModel
from zoedepth.train.batches import Batches, load_batches
from zoedepth.train.config import SourceConfig, TrainConfig
from zoedepth.train.interruption import Interruption
from zoedepth.train.log import Log
from zoedepth.train.optim import build_optimizer
from zoedepth.train.sources import load_sources
from zoedepth.train.start import start_from
from zoedepth.train.state import TrainState, averaged, checkpoints

if TYPE_CHECKING:
    from lightning_fabric import Fabric
    from lightning_fabric.wrappers import _FabricModule, _FabricOptimizer


@dataclass(frozen=True)
class Run:
    """The parts that both stages train with. Only ``state`` and what it points to change while training."""

    config: TrainConfig
    out: Path
    """Folder of the run: checkpoints, log, pictures."""
    fabric: "Fabric"
    state: TrainState
    """Weights, optimizer, moving average, and the number of steps taken."""
    network: "_FabricModule"
    """The part of the model that is trained, as Fabric calls it: in its precision, on all processes."""
    optimizer: "_FabricOptimizer"
    """The optimizer of the state, as Fabric calls it."""
    sources: tuple[SourceConfig, ...]
    """The data sets that are trained on."""
    validation: Mapping[str, "Subset[Sample]"]
    """Name of a data set → its held-out samples."""
    batches: Batches
    """This process's share of the steps that are left."""
    identity: Mapping[str, Any]
    """Plain values that tell this run from another of the same configuration: its data."""
    log: Log
    interruption: Interruption


@contextmanager
def set_up(
    config: TrainConfig,
    fabric: "Fabric",
    *,
    part: Callable[[DepthModel], nn.Module],
    data: Mapping[str, str | Path],
    out: Path,
    init: str | None,
) -> Iterator[Run]:
    """Build a run, or load what its folder has of it; on leaving the context its files are closed.

    Args:
        config: the configuration, most often of a recipe.
        fabric: the processes, see ``zoedepth.train.processes.launch_fabric``.
        part: takes the model and returns the part of it that is trained.
        data: name of a source of the configuration → where its data is.
        out: folder of the run.
        init: starting weights, see ``zoedepth.train.start.start_from``; not read when resuming.

    Raises:
        InputError: data, starting weights or checkpoint do not suit the configuration.
    """
    fabric.seed_everything(config.seed, workers=True, verbose=False)
    training, validation = load_sources(config, data)
    model = build_model(config.model)
    finished = checkpoints(out)
    started_from = f"{finished[-1].name} of {out}" if finished else start_from(model, init)
    if config.gradient_checkpointing:
        model.encoder.checkpoint_gradients()
    network = part(model)
    optimizer = build_optimizer(network, config.optim)
    state = TrainState(model, optimizer, averaged(model, config.ema_decay))
    identity = {"data": {name: str(path) for name, path in sorted(data.items())}}
    if finished:
        state.load(finished[-1], config, identity)
    network, optimizer = fabric.setup(network, optimizer)
    batches = load_batches(config, fabric, training, first_step=state.step)
    n_images = sum(len(subset) for _, subset in training)
    sources = tuple(source for source, _ in training)
    with Log(out, config, first_step=state.step, active=fabric.is_global_zero) as log, Interruption() as interruption:
        log.say(f"{config.stage} from {started_from}: steps {state.step} to {config.steps}, {n_images} images")
        try:
            yield Run(
                config, out, fabric, state, network, optimizer, sources, validation, batches, identity, log,
                interruption,
            )  # fmt: skip
        finally:
            batches.close()


def last_checkpoint(run: Run) -> Path:
    """Return the newest checkpoint in the run's folder, when all processes have come to this point."""
    run.fabric.barrier()
    return checkpoints(run.out)[-1]
