"""The models, and the threads in which photos are decoded, predicted and written."""

import asyncio
import errno
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from zoedepth.config import ModelConfig
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError, MissingExtraError, ZoeDepthError, is_no_memory, no_such
from zoedepth.geometry.choice import CameraChoice
from zoedepth.predict import Predictor
from zoedepth.serve.gate import Gate
from zoedepth.serve.metrics import Metrics
from zoedepth.serve.photos import Decoded, check_photo, decode_photo
from zoedepth.serve.problems import ClientGone, Problem, sentence
from zoedepth.serve.settings import Settings
from zoedepth.threads import cpu_count
from zoedepth.weights.exported import ExportedModel
from zoedepth.weights.load import load_for_prediction, pinned, weights_of
from zoedepth.weights.releases import RELEASES

Result = TypeVar("Result")

_LOOKERS = 2  # threads that look at headers; it takes milliseconds
_BATCH = 8
_LAST_WORDS = 1.0  # seconds before the end of the grace, in which the rest is refused


@dataclass(frozen=True)
class Wanted:
    """The way in which a photo is to be predicted."""

    model: str | None = None
    """Name of the model; None: the default."""
    domain: str | None = None
    """Scene type whose head to use; None leaves it to the model's router."""
    camera: CameraChoice = "exif"
    """Camera of the photo, see ``Predictor``."""
    flip: bool = True
    """True averages with the prediction for the mirrored photo."""
    focal_correction: bool | None = None
    """Correction by the focal length, see ``Predictor``."""


class Times(NamedTuple):
    """Seconds that the parts of a request took."""

    waiting: float
    """In the queue."""
    computing: float
    """From the first byte that was decoded to the last one that was written."""


class Model:
    """A model that clients can choose.

    Args:
        source: the model as ``load_model`` takes it.
        settings: device and precision.
        streams: photos that are computed at the same time.
    """

    def __init__(self, source: str, settings: Settings, *, streams: int) -> None:
        self.source = source
        path = Path(source)
        self.name = source if source in RELEASES else (path.stem if path.is_file() else path.name) or source
        self.told = path.name if path.is_file() else self.name
        """The name in calibrations: a file's with its ending, without the folder, which is no business of a client."""
        place = pinned(source)
        network = load_for_prediction(place, device=settings.device, precision=settings.precision, streams=streams)
        if not network.config.domains:
            raise InputError(f"{source} gives relative depth, and the service answers in metres: choose another model")
        self._precision: Any = settings.precision
        base = Predictor(network, device=settings.device, precision=self._precision)
        self.network = base.model
        """The network, on its device."""
        self.weights = weights_of(place, pad=base.pad)
        """Hash by which calibrations know the weights."""
        self.on_cpu = isinstance(network, ExportedModel) or base.device.type == "cpu"
        """True where the network computes on the CPU."""
        self._predictors: dict[tuple[bool, bool | None], Predictor] = {(True, None): base}

    @property
    def domains(self) -> list[str]:
        """Names of the scene types that it has a head for."""
        return [domain.name for domain in self.network.config.domains]

    @property
    def votes_together(self) -> bool:
        """True where photos of one batch would share a head."""
        config = self.network.config
        return isinstance(config, ModelConfig) and config.router.vote == "batch"

    def predictor(self, wanted: Wanted) -> Predictor:
        """Return the predictor that does what is wanted.

        Raises:
            InputError: the depth of this model cannot be corrected by the focal length.
        """
        key = (wanted.flip, wanted.focal_correction)
        if key not in self._predictors:
            self._predictors[key] = Predictor(
                self.network, flip_average=wanted.flip, precision=self._precision, focal_correction=key[1]
            )
        return self._predictors[key]


@dataclass(eq=False)
class _Job:
    """A photo on its way through the model."""

    photo: Decoded
    gone: asyncio.Future[None]
    result: asyncio.Future[DepthMap] = field(repr=False)


class _Threads(ThreadPoolExecutor):
    """Threads that know whether they have something to do."""

    def __init__(self, n_threads: int, name: str) -> None:
        super().__init__(n_threads, name)
        self._tasks: set[Future[Any]] = set()

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Let a thread call a function."""
        task = super().submit(fn, *args, **kwargs)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    @property
    def are_busy(self) -> bool:
        """True until everything is done that was not cancelled before it began."""
        return not all(task.done() for task in self._tasks.copy())


class Engine:
    """Models, threads and the gate before them. ``start`` loads the models; it belongs to one event loop.

    Args:
        settings: the settings of the service.
        metrics: where the work is counted.
    """

    def __init__(self, settings: Settings, metrics: Metrics) -> None:
        self._settings, self._metrics = settings, metrics
        self.models: dict[str, Model] = {}
        """Models by the names that clients use; the first is the default."""
        self.ready = False
        """True while models are there to be asked."""
        self.n_threads = settings.threads or cpu_count()
        """Photos that are computed at the same time."""
        self._batches: dict[tuple[object, ...], list[_Job]] = {}
        self._ending = asyncio.Event()

    def start(self) -> None:
        """Load the models, and start the threads.

        Raises:
            InputError: a model cannot be loaded, or two have one name.
        """
        settings = self._settings
        if self.models:
            return
        for source in settings.models:
            model = Model(source, settings, streams=self.n_threads)
            if model.name in self.models:
                raise InputError(f"two models have the name {model.name}: rename one of the files (--model)")
            self.models[model.name] = model
        on_cpu = all(model.on_cpu for model in self.models.values())
        self.batch_size = settings.batch_size or (1 if on_cpu else _BATCH)
        """Photos that go through a model together, at most."""
        places = self.n_threads if self.batch_size == 1 else max(self.n_threads, 2 * self.batch_size)
        self.gate = Gate(places, settings.limits.queue, self._watch)
        """The queue."""
        self._workers = _Threads(places, "photo")
        self._lookers = _Threads(_LOOKERS, "header")
        # A batch keeps the whole device busy; photos one by one each have cores of their own.
        self._runners = _Threads(self.n_threads if self.batch_size == 1 else 1, "model")
        self.ready = True

    def close(self) -> None:
        """Begin nothing new, send away who waits, and, shortly before the end, who is still computed."""
        if self.ready:
            self.ready = False
            self.gate.close()
            loop = asyncio.get_running_loop()
            loop.call_later(max(0.0, self._settings.limits.grace - _LAST_WORDS), self._ending.set)

    def stop(self) -> None:
        """Let the threads end when they are done."""
        self.ready = False
        for threads in (self._lookers, self._workers, self._runners):
            threads.shutdown(wait=False, cancel_futures=True)

    def admit(self) -> None:
        """Refuse a photo for which there is no place in the queue: asked before its body is read.

        Raises:
            Problem: the queue is full, or the service shuts down.
        """
        self.gate.check()

    @property
    def is_computing(self) -> bool:
        """True while threads compute something, whoever waits for it."""
        return bool(self.models) and any(threads.are_busy for threads in (self._lookers, self._workers, self._runners))

    def model(self, wanted: Wanted) -> Model:
        """Return the model that is wanted.

        Raises:
            InputError: there is no such model, or it has no such domain.
        """
        name = wanted.model or next(iter(self.models))
        if name not in self.models:
            raise no_such("model", name[:100], self.models)
        model = self.models[name]
        if wanted.domain is not None:
            model.predictor(wanted).domain_index(wanted.domain)
        return model

    async def compute(
        self,
        content: bytes,
        wanted: Wanted,
        finish: Callable[[DepthMap, Decoded], Result],
        *,
        gone: asyncio.Future[None],
        began: float | None = None,
    ) -> tuple[Result, Times]:
        """Predict a photo when its turn comes; returns what ``finish`` makes of the depth, and how long it took.

        Args:
            content: the photo's file.
            wanted: how to predict it.
            finish: function that is called in a thread with the depth map and the photo.
            gone: a future that is done when the client has hung up: then nothing more is done for it.
            began: when the request came, by ``time.perf_counter``, if not now.

        Raises:
            Problem: the photo is refused, the queue is full, or it takes too long.
            ClientGone: the client hung up.
        """
        limits, started = self._settings.limits, time.perf_counter()
        until = (started if began is None else began) + limits.max_seconds
        loop = asyncio.get_running_loop()
        with told():
            self.gate.check()
            model = self.model(wanted)
            predictor = model.predictor(wanted)
            header = await loop.run_in_executor(
                self._lookers, lambda: check_photo(content, max_pixels=limits.max_pixels)
            )
            _refuse_narrow(predictor, header.size)
        patience = max(0.0, min(limits.max_wait, until - time.perf_counter()))
        if not await self.gate.enter(seconds=patience, gone=gone):
            self._metrics.dropped.inc()
            raise ClientGone
        waited = time.perf_counter() - started
        work = asyncio.ensure_future(self._inside(content, wanted, model, finish, gone))
        ending = asyncio.ensure_future(self._ending.wait())
        await asyncio.wait(
            {work, gone, ending}, timeout=max(0.0, until - time.perf_counter()), return_when=asyncio.FIRST_COMPLETED
        )
        ending.cancel()
        if work.done():
            return work.result(), Times(waited, time.perf_counter() - started - waited)
        work.add_done_callback(lambda done: done.cancelled() or done.exception())  # nobody waits for its error
        if gone.done():
            self._metrics.dropped.inc()
            raise ClientGone
        gone.set_result(None)  # what has not begun shall not begin
        if self._ending.is_set():
            raise Problem("shutting-down", "The service is shutting down. Try again later.")
        raise Problem("took-too-long", f"It took more than {limits.max_seconds:.0f} seconds. Send a smaller photo.")

    async def _inside(
        self,
        content: bytes,
        wanted: Wanted,
        model: Model,
        finish: Callable[[DepthMap, Decoded], Result],
        gone: asyncio.Future[None],
    ) -> Result:
        """Decode, predict and write one photo, and give its place back when that has ended, whoever waits for it."""
        limits, loop = self._settings.limits, asyncio.get_running_loop()

        def begun(function: Callable[..., Any], *arguments: object) -> Any:
            if gone.done():
                raise ClientGone
            return function(*arguments)

        try:
            with told():
                photo: Decoded = await loop.run_in_executor(
                    self._workers,
                    lambda: begun(lambda: decode_photo(content, wanted.camera, max_pixels=limits.max_pixels)),
                )
                depth_map = await self._predict(photo, wanted, model, gone)
                return await loop.run_in_executor(self._workers, begun, finish, depth_map, photo)
        finally:
            self.gate.leave()

    async def _predict(self, photo: Decoded, wanted: Wanted, model: Model, gone: asyncio.Future[None]) -> DepthMap:
        """Predict a photo, together with others of its network size that come within a few milliseconds."""
        loop = asyncio.get_running_loop()
        predictor = model.predictor(wanted)
        height, width = photo.image.shape[:2]
        size = predictor.network_size((height, width))
        most = 1 if model.votes_together else self.batch_size
        key = (model.name, wanted.flip, wanted.focal_correction, wanted.domain, size)
        job = _Job(photo, gone, loop.create_future())
        batch = self._batches.setdefault(key, [])
        batch.append(job)

        def run() -> None:
            if self._batches.get(key) is batch:
                del self._batches[key]
                task = loop.run_in_executor(self._runners, self._run, batch, predictor, wanted.domain, model.name)
                task.add_done_callback(lambda done: _hand_out(batch, done))

        if len(batch) >= most:
            run()
        elif len(batch) == 1:
            loop.call_later(self._settings.batch_wait, run)
        result = await job.result
        return replace(result, camera_note=photo.camera_note)

    def _run(self, batch: list[_Job], predictor: Predictor, domain: str | None, name: str) -> dict[int, DepthMap]:
        """Predict a batch in this thread; returns the results by their places. Clients who left have none."""
        rows = [row for row, job in enumerate(batch) if not job.gone.done()]
        if not rows:
            return {}
        started = time.perf_counter()
        photos = [batch[row].photo for row in rows]
        found = predictor.batch(
            [photo.image for photo in photos],
            domain=domain,
            camera=[photo.camera for photo in photos],
            batch_size=len(photos),
        )
        self._metrics.batch_size.observe(len(rows))
        self._metrics.model_seconds.labels(name).observe(time.perf_counter() - started)
        return dict(zip(rows, found, strict=True))

    def _watch(self, waiting: int, inside: int) -> None:
        self._metrics.waiting.set(waiting)
        self._metrics.computing.set(inside)


def _hand_out(batch: list[_Job], done: "asyncio.Future[dict[int, DepthMap]]") -> None:
    """Give each photo of a batch its result."""
    error = ClientGone() if done.cancelled() else done.exception()
    results = {} if error is not None else done.result()
    for row, job in enumerate(batch):
        if job.result.done():
            continue
        if row in results:
            job.result.set_result(results[row])
        else:
            job.result.set_exception(error or ClientGone())


def _refuse_narrow(predictor: Predictor, stored: tuple[int, int]) -> None:
    """Refuse a photo that is too narrow for the model, before it waits: its notes may turn it, so either way is tried.

    Args:
        predictor: its predictor.
        stored: (height, width) as its header says.

    Raises:
        InputError: it is too narrow, upright and on its side.
    """
    try:
        predictor.network_size(stored)
    except InputError:
        try:
            predictor.network_size((stored[1], stored[0]))
        except InputError:
            pass
        else:
            return
        raise


@contextmanager
def told() -> Iterator[None]:
    """Turn errors of the package into problems that clients are told, until the block ends."""
    try:
        yield
    except (Problem, ClientGone):
        raise
    except Exception as error:  # what is no problem of a photo is raised again
        if (problem := as_problem(error)) is not None:
            raise problem from error
        raise


def as_problem(error: Exception) -> Problem | None:
    """Return how a client is told of an error; None for those that are none of its business."""
    if is_no_memory(error):  # first: its words may name files of the service
        return Problem("no-room", "There is too little memory for this photo now. Send it resized, or try again later.")
    if isinstance(error, MissingExtraError):
        return Problem("not-acceptable", f"{sentence(error)}, on the machine of the service.")
    if isinstance(error, ZoeDepthError):
        return Problem("invalid-request", sentence(error))
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EROFS):
        return Problem("no-room", "There is no room for the answer now. Try again later.")
    return None
