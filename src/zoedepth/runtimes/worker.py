"""A row of the benchmark in a process of its own: memory and the time to the first depth are its own, too."""

import math
import multiprocessing
import signal
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, Protocol

from zoedepth.batch import Request, predict_photo
from zoedepth.errors import InputError, ZoeDepthError
from zoedepth.images import DepthArray, read_image
from zoedepth.photos import Photo
from zoedepth.predict import Predictor
from zoedepth.runtimes.runtime import Runtime
from zoedepth.threads import share_cores

LONG_ENOUGH = 1.0
"""Seconds that several photos at a time are timed, at least."""

KEPT = 250_000
"""Pixels of a photo's depth that are compared, at most."""

_REQUEST = Request("the model that is measured", ("depth",))

STATUS = Path("/proc/self/status")

Task = Literal["one", "many", "memory", "depths"]


@dataclass(frozen=True)
class Work:
    """A row to measure."""

    runtime: Runtime
    model: Path
    """The weights, or the exported file."""
    compat: tuple[str, ...]
    flip_average: bool
    photos: tuple[Path, ...]
    """Photos whose depth is compared. The first one is timed."""
    at_once: int
    """Photos that ``zoedepth predict`` would compute at the same time."""


class Worker(Protocol):
    """Somebody who does the work of a row."""

    def ask(self, task: Task | None) -> Any:
        """Let it do a task, and return the result; None: wait for the first depth. See ``Bench.do``.

        Raises:
            InputError: it has failed.
        """
        ...

    def end(self) -> None:
        """Let it go."""
        ...


class Process:
    """A worker in a process of its own, which is started at once."""

    def __init__(self, work: Work) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, there = context.Pipe()
        self._process = context.Process(target=serve, args=(work, there, time.time()), daemon=True)
        self._process.start()
        there.close()  # or nobody would notice that the process has ended

    def ask(self, task: Task | None) -> Any:
        """See ``Worker``."""
        try:
            if task is not None:
                self._pipe.send(task)
            done, result = self._pipe.recv()
        except (EOFError, OSError) as error:
            self._process.join(timeout=10)
            raise InputError(
                f"its process ended by itself (exit code {self._process.exitcode}): is there too little memory?"
            ) from error
        if not done:
            raise InputError(result)
        return result

    def end(self) -> None:
        """See ``Worker``."""
        self._process.terminate()
        self._process.join()
        self._pipe.close()


def serve(work: Work, pipe: Connection, began: float) -> None:
    """Do the tasks that come through a pipe, until it ends, or one fails.

    Args:
        work: the row.
        pipe: gets the seconds to the first depth first, then the result of each task: (True, result), or (False, why
            it failed).
        began: the time (``time.time``) at which the process was started.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; who started it ends it
    try:
        bench = Bench(work)
        pipe.send((True, time.time() - began))
        while True:
            pipe.send((True, bench.do(pipe.recv())))
    except EOFError:
        return
    except ZoeDepthError as error:
        pipe.send((False, str(error)))
    except Exception as error:  # of the libraries, which share no class
        pipe.send((False, f"{type(error).__name__}: {str(error)[:300]}"))


class Bench:
    """A runtime that is measured. The first depth is there when it is made.

    Args:
        work: the row.

    Raises:
        InputError: the model cannot be loaded, or a photo cannot be read.
    """

    def __init__(self, work: Work) -> None:
        self.work = work
        self.photos = [read_image(photo) for photo in work.photos]
        self.predictor = self._load()
        if not self.predictor.model.config.domains:
            raise InputError("the model gives relative depth, and metres are compared: choose a model of metres")
        self.predictor(self.photos[0])
        self.shared = work.at_once < 2

    def do(self, task: Task) -> Any:
        """Do a task, and return its result.

        Args:
            task: "one": the seconds of the first photo, with all cores. "many": photos a second, several at the same
                time, each read from its file, and its depth written to one. "memory": the most of it so far, in MB, of
                the process and of the GPU; None where it is not known. "depths": the depth of each photo, of a part of
                its pixels.
        """
        tasks: dict[Task, Callable[[], Any]] = {
            "one": self._one, "many": self._many, "memory": self._memory, "depths": self._depths,
        }  # fmt: skip
        return tasks[task]()

    def _load(self, streams: int = 1) -> Predictor:
        work = self.work
        return Predictor(
            work.runtime.load(work.model, compat=work.compat, streams=streams),
            flip_average=work.flip_average,
            precision=work.runtime.precision if work.runtime.library == "torch" else "float32",
            device="auto" if work.runtime.on_gpu else "cpu",
            camera="none",
        )

    def _one(self) -> float:
        started = time.perf_counter()
        self.predictor(self.photos[0])
        return time.perf_counter() - started

    def _many(self) -> float:
        n_photos = self.work.at_once
        with (
            share_cores(n_photos),
            ThreadPoolExecutor(n_photos) as executor,
            TemporaryDirectory(prefix="zoedepth-") as folder,
        ):
            if not self.shared:  # an exported model takes its threads when it is loaded
                if self.work.runtime.suffix is not None:
                    self.predictor = self._load(streams=n_photos)
                list(executor.map(self.predictor, self.photos[:1] * n_photos))
                self.shared = True
            n_done, started = 0, time.perf_counter()
            while not n_done or time.perf_counter() - started < LONG_ENOUGH:
                photos = [Photo(self.work.photos[0], Path(folder, str(number))) for number in range(2 * n_photos)]
                list(executor.map(lambda photo: predict_photo(photo, self.predictor, _REQUEST), photos))
                n_done += len(photos)
            return n_done / (time.perf_counter() - started)

    def _memory(self) -> tuple[float | None, float | None]:
        on_gpu = None
        if self.work.runtime.on_gpu:
            import torch

            on_gpu = torch.cuda.max_memory_reserved() / 1e6 if torch.cuda.is_available() else None
        return peak_memory_mb(), on_gpu

    def _depths(self) -> list[DepthArray]:
        return [thinned(self.predictor(photo).depth) for photo in self.photos]


def thinned(depth: DepthArray) -> DepthArray:
    """Return every n-th pixel of a depth map in both directions, so that ``KEPT`` are left at most."""
    step = math.ceil(math.sqrt(depth.size / KEPT))
    return depth[::step, ::step].copy()


def largest_rel(depths: Sequence[DepthArray], expected: Sequence[DepthArray]) -> float:
    """Return the largest REL of a photo: mean of |depth - expected| / expected.

    Raises:
        InputError: a depth is not finite.
    """
    rels = [float((abs(depth - base) / base).mean()) for depth, base in zip(depths, expected, strict=True)]
    if not all(map(math.isfinite, rels)):
        raise InputError("its depth is not finite")
    return max(rels)


def peak_memory_mb() -> float | None:
    """Return the most memory that this process has held, in MB; None on Windows."""
    try:
        lines = STATUS.read_text(encoding="ascii", errors="replace").splitlines()
        return next(int(line.split()[1]) * 1024 / 1e6 for line in lines if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        pass
    if sys.platform != "darwin":
        return None
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
