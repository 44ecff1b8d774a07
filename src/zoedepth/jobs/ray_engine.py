"""A job on a cluster, by Ray Data: actors that hold the model map ``work.do_photo`` over the inputs.

Scheduling, back-pressure, and what happens when a machine is lost are Ray's. Ours is the function, and the manifest,
which this process alone writes: a photo that two machines have done, because one was taken for lost, is one line.
"""

import logging
import os
import pickle
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from zoedepth.batch import Request
from zoedepth.errors import InputError, MissingExtraError
from zoedepth.forward.answer import Precision
from zoedepth.geometry.choice import CameraChoice
from zoedepth.jobs.destinations import Destination
from zoedepth.jobs.manifest import Manifest
from zoedepth.jobs.origins import Held
from zoedepth.jobs.run import Tally, missing, writing
from zoedepth.jobs.work import Done, Input, do_photo
from zoedepth.predict import Predictor
from zoedepth.threads import set_thread_count
from zoedepth.weights.exported import ExportedModel
from zoedepth.weights.load import load_for_prediction

if TYPE_CHECKING:
    from zoedepth.model.interface import DepthModel

_BLOCK, _FIRST_BLOCKS, _LARGE_BLOCK = 8, 10_000, 64
"""Inputs that an actor gets together: few, so that little is lost with it; more where there are very many."""

_STARTS = 3
"""Times that a Ray of this machine is started, where it does not come up."""

_QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_BACKEND_LOG_LEVEL": "fatal",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # Ray's word for: actors without a GPU see what they saw before
}
"""Variables by which Ray reports to nobody, and writes nothing to the terminal."""


@dataclass(frozen=True)
class Recipe:
    """Everything that an actor makes its predictor of."""

    model: str
    """Name of the model, for one that cannot be sent: an exported file or graph, which each machine must have."""
    network: Any
    """Ray's reference to the network, which goes to each machine once; None for one that cannot be sent."""
    device: str
    precision: Precision
    flip_average: bool
    pad: bool
    squeeze: bool
    camera: CameraChoice
    focal_correction: bool | None

    def predictor(self) -> Predictor:
        """Make the predictor, on one core where it computes on the CPU."""
        import ray

        set_thread_count(1)
        network: "DepthModel | ExportedModel"
        if self.network is None:  # exported files know no float16, which the predictor refuses
            precision = "bfloat16" if self.precision == "bfloat16" else "float32"
            network = load_for_prediction(self.model, device="cpu", precision=precision)
        else:
            network = ray.get(self.network)
        return Predictor(
            network,
            flip_average=self.flip_average,
            pad=self.pad,
            resize="squeeze" if self.squeeze else None,
            device=self.device,
            precision=self.precision,
            camera=self.camera,
            focal_correction=self.focal_correction,
        )


class Worker:
    """An actor: it makes a predictor once, and predicts the photos that it is sent."""

    def __init__(self, recipe: Recipe, request: Request, destination: Destination) -> None:
        self.predictor = recipe.predictor()
        self.request, self.destination = request, destination

    def __call__(self, batch: dict[str, Any]) -> dict[str, list[bytes]]:
        """Do the photos of a batch; both sides are pickled, by this program for itself."""
        photos: list[Input] = [pickle.loads(each) for each in batch["photo"]]
        results = [do_photo(photo, self.predictor, self.request, self.destination) for photo in photos]
        return {"done": [pickle.dumps(done) for done in results]}


def run_on_ray(
    inputs: Iterable[Input],
    predictor: Predictor,
    request: Request,
    *,
    model: str,
    device: str,
    manifest: Manifest,
    destination: Destination,
    workers: int | None,
    address: str | None,
    tally: Tally,
    overwrite: bool = False,
    tell_done: bool = False,
) -> Iterator[Done]:
    """Do those inputs that are not done yet on a cluster, and yield the results as they come, in no order.

    All inputs are listed before the first is done. Each result is in the manifest before it is yielded.

    Args:
        inputs: see ``run.run_job``, as for what is not here.
        predictor: its network goes to the machines; it does not compute itself.
        request: the files to make of each photo.
        model: name of the model.
        device: "auto" takes the cluster's GPUs, one for each actor, or its cores, where it has none. Models that are no
            longer in torch take cores.
        manifest: the manifest, for which ``Manifest.begin`` was called.
        destination: where the files go; all machines must see it at the same path.
        workers: actors; None: as many as the cluster has GPUs or cores.
        address: the cluster's, as ``ray.init`` takes it; None: that of RAY_ADDRESS, or a Ray of this machine that ends
            with the job.
        tally: counts the inputs.
        overwrite: see ``run.run_job``.
        tell_done: see ``run.run_job``.

    Raises:
        InputError: the cluster cannot be reached, an input cannot be sent, or nothing can be written any more.
        MissingExtraError: Ray is not installed.
    """
    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    for name in ("ray", "ray.data"):
        logging.getLogger(name).setLevel(logging.ERROR)
    try:
        import ray
        import ray.data
        from pyarrow import table
    except ModuleNotFoundError as error:
        raise MissingExtraError("ray", "--engine ray") from error

    ours = not ray.is_initialized()
    try:
        blocks, n_photos = [], 0
        for block in _blocks(missing(inputs, manifest, destination, tally, overwrite=overwrite, tell_done=tell_done)):
            for item in block:
                if isinstance(item, Done):
                    tally.count(item)
                    yield item
            photos = [pickle.dumps(photo) for photo in block if isinstance(photo, Input)]
            if photos:
                if not ray.is_initialized():
                    _start(address, workers)
                blocks.append(ray.put(table({"photo": photos})))
                n_photos += len(photos)
        tally.total = tally.seen + n_photos
        if not blocks:
            return
        resources = ray.cluster_resources()
        on_cpu = device == "cpu" or isinstance(predictor.model, ExportedModel)
        n_gpus = 0 if on_cpu else int(resources.get("GPU", 0))
        n_actors = workers or n_gpus or max(1, int(resources.get("CPU", 1)))
        recipe = _recipe(predictor, model, device if device != "auto" else "cuda" if n_gpus else "cpu")
        results = ray.data.from_arrow_refs(blocks).map_batches(
            Worker,
            batch_size=None,
            fn_constructor_args=(recipe, request, destination),
            compute=ray.data.ActorPoolStrategy(min_size=1, max_size=n_actors),
            num_cpus=1,
            num_gpus=1 if n_gpus else None,
        )
        for batch in results.iter_batches(batch_size=None, prefetch_batches=0):
            for each in batch["done"]:
                done: Done = pickle.loads(each)
                if done.end is None:
                    with writing(manifest):
                        manifest.add(done.entry)
                tally.count(done)
                yield done
                if done.end is not None:
                    raise InputError(done.end)
        with writing(manifest):
            manifest.flush()
    finally:
        if ours and ray.is_initialized():
            ray.shutdown()


def _start(address: str | None, workers: int | None) -> None:
    """Connect to a cluster, or start one on this machine, without a word on the terminal."""
    import ray
    import ray.data

    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    where = address or os.environ.get("RAY_ADDRESS") or "local"
    if where == "local":
        _start_here(lambda: ray.init("local", num_cpus=workers, include_dashboard=False, **quiet))
    else:
        try:
            ray.init(where, **quiet)
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise InputError(f"--address {where}: no Ray cluster answers there ({error})") from error
    context = ray.data.DataContext.get_current()
    context.enable_progress_bars = False
    context.print_on_execution_start = False


def _start_here(start: Callable[[], object]) -> None:
    """Start a Ray of this machine, again where it is too busy for the 30 seconds that Ray gives itself."""
    import ray

    for left in reversed(range(_STARTS)):
        try:
            start()
            return
        except Exception as error:  # Ray has no class of its own for this one
            ray.shutdown()
            if not left:
                raise InputError(
                    f"Ray does not start on this machine ({error}): leave --engine ray out, or try when it is less busy"
                ) from error


def _recipe(predictor: Predictor, model: str, device: str) -> Recipe:
    import ray

    network = predictor.model
    exported = isinstance(network, ExportedModel)
    return Recipe(
        model,
        None if exported else ray.put(network.to("cpu")),
        "cpu" if exported else device,
        predictor.precision,
        predictor.flip_average,
        predictor.pad,
        not predictor.keep_aspect_ratio,
        predictor.camera,
        predictor.focal_correction,
    )


def _blocks(items: Iterator[Input | Done]) -> Iterator[list[Input | Done]]:
    """Yield inputs in blocks.

    Raises:
        InputError: an input is the member of a compressed tar file, whose bytes cannot be sent for all.
    """
    block: list[Input | Done] = []
    n_blocks = 0
    for item in items:
        if isinstance(item, Input) and isinstance(item.origin, Held):
            raise InputError(f"{item.name}: a compressed tar file can only be read by one process: unpack it to .tar")
        block.append(item)
        if len(block) >= (_BLOCK if n_blocks < _FIRST_BLOCKS else _LARGE_BLOCK):
            yield block
            block, n_blocks = [], n_blocks + 1
    if block:
        yield block
