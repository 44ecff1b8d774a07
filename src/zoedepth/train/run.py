"""A run: one training of one stage, from its first step or from the last checkpoint in its folder."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torch import nn
from torch.utils.data import Subset

from zoedepth.build import build_model
from zoedepth.data.sample import Sample, Samples
from zoedepth.errors import InputError, TrainingError
from zoedepth.lock import only_one
from zoedepth.model.interface import DepthModel
from zoedepth.provenance import Provenance
from zoedepth.train.batches import Batches, load_batches
from zoedepth.train.config import SourceConfig, TrainConfig
from zoedepth.train.identity import data_state, start_state
from zoedepth.train.interruption import Interruption
from zoedepth.train.log import Log, Ticker, check_log, say
from zoedepth.train.optim import build_optimizer
from zoedepth.train.processes import resolve
from zoedepth.train.sources import load_sources
from zoedepth.train.start import start_from
from zoedepth.train.state import TrainState, averaged, check_same, checkpoints, damaged, precision_of
from zoedepth.train.tolerant import Tolerant
from zoedepth.weights.checkpoint import read_checkpoint
from zoedepth.weights.load import find

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
    tolerant: tuple[Tolerant, ...]
    """Their samples, which know of those that are broken."""
    validation: Mapping[str, "Subset[Sample]"]
    """Name of a data set → its held-out samples."""
    batches: Batches
    """This process's share of the steps that are left."""
    identity: Mapping[str, Any]
    """Plain values that tell this run from another of the same configuration: its data and starting weights."""
    log: Log
    interruption: Interruption

    @property
    def turns(self) -> int:
        """Number of steps in which all data sets have had their turns; 1 where they share a batch."""
        apart = self.config.mix_by == "batch" and len(self.sources) > 1
        return sum(source.weight for source in self.sources) if apart else 1


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

    An error in the context, which has not been foreseen, saves the last step as an interruption does.

    Raises:
        InputError: data, starting weights or checkpoint do not suit the configuration, or belong to another run.
    """
    fabric.seed_everything(config.seed, workers=True, verbose=False)
    finished = checkpoints(out)
    if not finished:
        check_log(out)
    model = build_model(config.model)
    # A folder may get a newer checkpoint at any moment: the one that is loaded is the one that is written down.
    start = str(find(init)) if init is not None and Path(init).is_dir() else init
    started_from = f"{finished[-1].name} of {out}" if finished else start_from(model, start)
    ticker = Ticker("looking at the data", say if fabric.is_global_zero else lambda text: None)
    training, validation = load_sources(config, data, progress=ticker)
    identity = identity_of({source.name: samples.samples for source, samples in training}, data, init, start=start)
    if finished:
        check_same(finished[-1], config, identity)
        model.provenance = _provenance_of(finished[-1])
    else:
        seen = {f"{source.name} ({len(tolerant)} pairs)": licence_of(tolerant.samples) for source, tolerant in training}
        model.provenance = model.provenance.after_training(seen)
    if config.gradient_checkpointing:
        model.encoder.checkpoint_gradients()
    network = part(model)
    plain = build_optimizer(network, config.optim)
    network, optimizer = fabric.setup(network, plain)
    # Behind it, where the weights are on their device: what an optimizer loads goes to where they are by then.
    state = TrainState(model, plain, averaged(model, config.ema_decay), fabric.strategy.precision)
    if finished:
        state.load(finished[-1], config, identity)
    batches = load_batches(config, fabric, training, first_step=state.step)
    n_images = sum(len(subset) for _, subset in training)
    sources = tuple(source for source, _ in training)
    with (
        _alone(out, fabric, finished),
        Log(out, config, first_step=state.step, active=fabric.is_global_zero) as log,
        Interruption() as interruption,
    ):
        if state.step < config.steps:
            log.say(f"{config.stage} from {started_from}: steps {state.step} to {config.steps}, {n_images} images")
        else:
            log.say(f"{started_from} has taken all of its {state.step} steps: there is nothing left to train")
        tolerant = tuple(samples for _, samples in training)
        for problem in (problem for samples in tolerant for problem in samples.problems.values()):
            log.say(f"skipped: {problem}")
        before = precision_of(finished[-1]) if finished else None
        if before not in (None, resolve(config.precision)):
            log.say(
                f"warning: {before} was the precision until here, and this machine takes {resolve(config.precision)}: "
                "the result is not that of one machine. Give --config.precision from the first command on"
            )
        for samples in tolerant:
            for doubt in samples.doubts:
                log.say(f"{samples.name}: warning: {doubt}")
        run = Run(
            config, out, fabric, state, network, optimizer, sources, tolerant, validation, batches, identity, log,
            interruption,
        )  # fmt: skip
        try:
            yield run
        except TrainingError:  # the numbers went wrong: older checkpoints are worth more
            raise
        except Exception:  # nobody foresaw it: the last step is saved, and it is raised again
            _rescue(run)
            raise
        finally:
            batches.close()


def identity_of(
    opened: Mapping[str, Samples], data: Mapping[str, str | Path], init: str | None, *, start: str | None = None
) -> dict[str, Any]:
    """Return the plain values that tell a run from another of the same configuration.

    Args:
        opened: name of a data set → its samples, or a ``Subset`` of them.
        data: name of a data set → where it is.
        init: starting weights.
        start: the place of these weights, where it is known already.
    """
    whole: dict[str, Any] = {
        name: samples.dataset if isinstance(samples, Subset) else samples for name, samples in opened.items()
    }
    places = {name: _tidy(place) for name, place in sorted(data.items())}
    return {
        "data": places,
        "data_state": {name: data_state(whole[name], places[name]) for name in sorted(whole)},
        "init": start_state(init, start=start),
    }


def _tidy(source: str | Path) -> str:
    """Return a path as it is without a slash at its end, which shells add; what is no path as it is."""
    return str(Path(source)) if Path(source).exists() else str(source)


def _provenance_of(checkpoint: Path) -> Provenance:
    try:
        return read_checkpoint(checkpoint).provenance
    except InputError as error:
        raise damaged(checkpoint, error) from error


@contextmanager
def _alone(out: Path, fabric: "Fabric", finished: list[Path]) -> Iterator[None]:
    """Keep other commands from training in a folder until the block ends.

    Args:
        out: the folder; it is made.
        fabric: the processes, all of which learn what the first one meets.
        finished: the checkpoints that were found there before.

    Raises:
        InputError: another command trains there, or has done so since.
    """
    with ExitStack() as stack:
        problem = ""
        if fabric.is_global_zero:
            try:
                out.mkdir(parents=True, exist_ok=True)
                advice = "wait for it, stop it, or choose another --out"
                stack.enter_context(only_one(out / "log.jsonl", work=f"trains in {out}", advice=advice))
                if checkpoints(out) != finished:
                    problem = f"another command has trained in {out} in the meantime: type this one again"
            except InputError as error:
                problem = str(error)
        if problem := fabric.broadcast(problem):
            raise InputError(problem)
        yield


def licence_of(samples: Samples) -> str | None:
    """Return the licence of a data set, or of that which a ``Subset`` is of; None where nobody says it."""
    return getattr(samples.dataset if isinstance(samples, Subset) else samples, "licence", None)


def _rescue(run: Run) -> None:
    """Save the last step that was finished, if no checkpoint has it yet."""
    newest = checkpoints(run.out)[-1:]
    if not run.fabric.is_global_zero or run.state.step == 0 or not run.state.go_back():
        return
    if newest and newest[0].name == f"step_{run.state.step:06d}":
        return
    try:
        run.state.save(run.out, run.config, run.identity)
    except OSError:  # a full disk is likely what has ended the run
        return
    run.log.say(f"step {run.state.step} is saved; the same command goes on from there")


def last_checkpoint(run: Run) -> Path:
    """Return the newest checkpoint in the run's folder, when all processes have come to this point."""
    run.fabric.barrier()
    return checkpoints(run.out)[-1]
