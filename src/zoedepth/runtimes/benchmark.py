"""Measure every runtime that is installed on this machine: time, memory, first depth, and how far the depth differs."""

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

from zoedepth.download import Progress
from zoedepth.errors import InputError, ZoeDepthError
from zoedepth.images import DepthArray, read_image
from zoedepth.runtimes.choice import ENOUGH_PHOTOS, Choice, Row, allowed_rel, fastest
from zoedepth.runtimes.exports import exported_file, find_source, packaged_graph
from zoedepth.runtimes.machine import Machine, this_machine, versions
from zoedepth.runtimes.products import products
from zoedepth.runtimes.runtime import BASE, RUNTIMES, Runtime
from zoedepth.runtimes.worker import Process, Task, Work, Worker, largest_rel
from zoedepth.weights.exported import is_exported

EXAMPLES = tuple(
    Path(__file__).parents[1] / "serve" / "page" / "examples" / f"{name}.jpg" for name in ("room", "coffee", "rocket")
)
"""The photos of the package."""

MAX_CALIBRATION = 300
"""Photos that int8 is calibrated on, at most."""

MEMINFO = Path("/proc/meminfo")

_HALF = Runtime("torch", "bfloat16")
_HOPELESS = 0.3
"""Speed of products in bfloat16, in those of float32, from which torch's row in it is measured. A processor that has no
instruction for it takes minutes for a photo of a large model."""
_SAME_PHOTOS = "calibrated on the photos that it is compared on: give more photos"
_ROOM = 1.5
"""Share of the largest worker's memory that must be free to start another one beside it."""


@dataclass(frozen=True)
class Benchmark:
    """The table of a machine, and the row that was chosen from it."""

    rows: tuple[Row, ...]
    choice: Choice
    compared: tuple[Path, ...]
    """Photos whose depth was compared."""
    calibrated: tuple[Path, ...]
    """Photos that int8 was calibrated on."""
    max_rel: float
    """Largest REL with which a row could be chosen."""


def benchmark(
    model: str | Path = "zoed-lite",
    *,
    photos: Sequence[Path] = (),
    compat: Iterable[str] = (),
    flip_average: bool = True,
    int8: bool = True,
    device: str = "auto",
    at_once: int | None = None,
    repeats: int = 7,
    progress: Progress | None = None,
    tell: Callable[[str], object] | None = None,
    start: Callable[[Work], Worker] = Process,
) -> Benchmark:
    """Measure a model in every runtime of this machine, and choose the fastest.

    Exported files and the speed of one large product are kept in the user's cache; nothing else is written.

    Every runtime has a process of its own, which is started by ``spawn``: a program calls this below
    ``if __name__ == "__main__"``.

    Args:
        model: a name, file or folder of weights, or Hugging Face id; no exported file.
        photos: photos to time and to compare on; those of the package, where there are none. Of four and more, int8 is
            calibrated on other ones than it is compared on.
        compat: see ``load_model``.
        flip_average: see ``Predictor``.
        int8: False leaves 8 bits out.
        device: "cpu" leaves the GPU out.
        at_once: photos that are computed at the same time for the rate; None: as many as there are cores.
        repeats: photos that are timed in each runtime. They take turns.
        progress: see ``load_model``.
        tell: called with a sentence before each part of the work.
        start: starts a worker for a row.

    Raises:
        InputError: there is no such model or photo, the model is an exported file or gives no metres, ``repeats`` or
            ``at_once`` is less than 1, or torch itself fails.
    """
    if is_exported(model):
        raise InputError(
            f"{model} is an exported file, which runs in one runtime: give the model that it was made from"
        )
    if repeats < 1:
        raise InputError(f"repeats must be 1 or more, got {repeats}")
    if at_once is not None and at_once < 1:
        raise InputError(f"at_once must be 1 or more, got {at_once}")
    say = tell or (lambda _: None)
    compared, calibrated = split(photos or EXAMPLES)
    for photo in compared:
        read_image(photo)  # what is wrong with it is said now
    source = find_source(model, compat=compat, progress=progress)
    machine = this_machine(device)
    rows: dict[str, Row] = {}
    works: list[Work] = []
    for runtime in RUNTIMES.values():
        problem = runtime.missing(machine, packaged=packaged_graph(source) is not None)
        if runtime.numbers == "int8" and not int8:
            problem = "left out"
        if runtime.on_gpu and device == "cpu":
            problem = "left out"
        if runtime == _HALF and not problem:
            found = products(replace(machine, accelerator=None))  # this row computes on the CPU, whatever GPU is there
            ratio = found["bfloat16"] / found["float32"]
            if ratio < _HOPELESS:
                problem = f"products in bfloat16 are {ratio:.2f} times as fast as in float32 here"
        rows[runtime.name] = Row(runtime.name, problem=problem)
        if problem:
            continue
        file = source.path
        if runtime.suffix is not None:
            try:
                file = exported_file(source, runtime, photos=calibrated if runtime.numbers == "int8" else (), tell=say)
            except (ZoeDepthError, OSError) as error:
                # That it computes another depth is no failure, but an answer.
                failed = isinstance(error, InputError | OSError)
                rows[runtime.name] = Row(runtime.name, problem=str(error), failed=failed)
                continue
        works.append(Work(runtime, file, source.compat, flip_average, compared, at_once or machine.cores))
    measured = measure(works, repeats=repeats, start=start, tell=say)
    for work in works:
        row = measured[work.runtime.name]
        in_doubt = work.runtime.numbers == "int8" and set(compared) & set(calibrated) and not row.problem
        rows[row.runtime] = replace(
            row,
            file=str(work.model) if work.runtime.suffix is not None else "",
            doubt=_SAME_PHOTOS if in_doubt else "",
        )
    table = tuple(rows.values())
    max_rel = allowed_rel(len(compared))
    return Benchmark(table, _choice(table, max_rel, source.weights, machine), compared, calibrated, max_rel)


def split(photos: Sequence[Path]) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Return the photos to compare on, and those to calibrate on: others, unless there are fewer than four."""
    photos = tuple(photos)
    if len(photos) < 4:
        return photos, photos
    step = max(2, len(photos) // ENOUGH_PHOTOS)
    compared = photos[::step][:ENOUGH_PHOTOS]
    others = [photo for photo in photos if photo not in compared]
    return compared, tuple(others[:: -(-len(others) // MAX_CALIBRATION)])


def _choice(rows: tuple[Row, ...], max_rel: float, weights: str, machine: Machine) -> Choice:
    chosen = fastest(rows, max_rel=max_rel)
    why = (
        f"fastest of zoedepth benchmark here, {chosen.photos_a_second:.3g} photos a second, REL {chosen.difference:.1e}"
    )
    is_int8 = RUNTIMES[chosen.runtime].numbers == "int8"
    return Choice(
        chosen.runtime,
        why,
        weights,
        machine,
        versions(),
        date.today().isoformat(),
        chosen.file if is_int8 else "",
        rows,
    )


@dataclass
class _Running:
    """A worker, and what it has said so far."""

    work: Work
    worker: Worker
    first_depth: float
    memory: tuple[float | None, float | None]
    seconds: list[float] = field(default_factory=list)
    rates: list[float] = field(default_factory=list)
    depths: list[DepthArray] = field(default_factory=list)

    def remember(self, memory: tuple[float | None, float | None]) -> None:
        """Keep the memory that it has taken."""
        self.memory = memory

    def row(self, expected: Sequence[DepthArray]) -> Row:
        """Return the row, with the difference from the expected depths."""
        seconds = statistics.median(self.seconds)
        return Row(
            self.work.runtime.name,
            seconds=seconds,
            least=min(self.seconds),
            most=max(self.seconds),
            photos_a_second=statistics.median(self.rates) if self.rates else 1 / seconds,
            memory_mb=self.memory[0],
            gpu_memory_mb=self.memory[1],
            first_depth=self.first_depth,
            difference=largest_rel(self.depths, expected),
        )


def measure(
    works: Sequence[Work],
    *,
    repeats: int,
    start: Callable[[Work], Worker] = Process,
    tell: Callable[[str], object] = lambda _: None,
    free_memory_mb: Callable[[], float | None] | None = None,
) -> dict[str, Row]:
    """Measure rows, which take turns, so that a drift of the machine's speed hits all alike.

    They are all in memory meanwhile. Where that is too small, the processes that run already
    finish and end before the next ones start.

    Args:
        works: the rows; the first is the one that depths are compared with.
        repeats: photos that are timed.
        start: starts a worker.
        tell: called with a sentence before each part of the work.
        free_memory_mb: says how much memory is free, if it is known; None: ``free_memory_mb``.

    Returns:
        Name of the runtime → its row, also of those that have failed.

    Raises:
        InputError: the first row has failed.
    """
    free = free_memory_mb or free_memory
    rows: dict[str, Row] = {}
    expected: list[DepthArray] = []
    waiting = list(works)
    while waiting:
        running: list[_Running] = []
        try:
            while waiting and (not running or _has_room(running, free())):
                work = waiting.pop(0)
                tell(f"First depth: {work.runtime.name}")
                worker = start(work)
                try:
                    running.append(_Running(work, worker, worker.ask(None), worker.ask("memory")))
                except BaseException as error:  # whatever it is, the worker must not be left behind
                    worker.end()
                    if not isinstance(error, InputError):
                        raise
                    rows[work.runtime.name] = _failed(work.runtime, error, base=works[0].runtime)
            for result in _take_turns(running, rows, repeats, tell, base=works[0].runtime):
                expected = expected or result.depths
                try:
                    rows[result.work.runtime.name] = result.row(expected)
                except InputError as error:
                    rows[result.work.runtime.name] = _failed(result.work.runtime, error, base=works[0].runtime)
        finally:
            for each in running:
                each.worker.end()
    return rows


def _take_turns(
    running: list[_Running], rows: dict[str, Row], repeats: int, tell: Callable[[str], object], *, base: Runtime
) -> list[_Running]:
    """Let the workers do everything, in turns; returns those that have done it, and puts the others into the rows."""
    left = list(running)

    def each(task: Task, keep: Callable[[_Running, Any], object]) -> None:
        for one in list(left):
            try:
                keep(one, one.worker.ask(task))
            except InputError as error:
                left.remove(one)
                rows[one.work.runtime.name] = _failed(one.work.runtime, error, base=base)

    for number in range(repeats):
        tell(f"One photo at a time, {number + 1} of {repeats}")
        each("one", lambda one, seconds: one.seconds.append(seconds))
    each("memory", _Running.remember)
    if running and running[0].work.at_once > 1:
        n_turns = (repeats + 1) // 2
        for number in range(n_turns):
            tell(f"{running[0].work.at_once} photos at a time, {number + 1} of {n_turns}")
            each("many", lambda one, rate: one.rates.append(rate))
    tell("Comparing the depth of all photos")
    each("depths", lambda one, depths: one.depths.extend(depths))
    return left


def _failed(runtime: Runtime, error: InputError, *, base: Runtime) -> Row:
    """Return the row of a runtime that has failed.

    Raises:
        InputError: it is the one that the others are compared with.
    """
    if runtime == base:
        raise InputError(f"{BASE.name}, with which the others are compared, has failed: {error}") from error
    return Row(runtime.name, problem=str(error), failed=True)


def _has_room(running: Sequence[_Running], free_mb: float | None) -> bool:
    peaks = [one.memory[0] for one in running if one.memory[0] is not None]
    return free_mb is None or not peaks or free_mb > _ROOM * max(peaks)


def free_memory() -> float | None:
    """Return the memory that can be had without swapping, in MB; None where the system does not say it."""
    try:
        lines = MEMINFO.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) * 1024 / 1e6 for line in lines if line.startswith("MemAvailable")), None)
