"""Show on standard error how far a command is: a bar on a terminal, and a line now and then in a file or a pipe."""

import threading
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING, TypeVar

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

import zoedepth.download

if TYPE_CHECKING:
    from zoedepth.jobs.run import Tally

EVERY = 15.0
"""Seconds between two lines where there is no terminal."""

_REDRAW = 0.2  # seconds

_Item = TypeVar("_Item")


@contextmanager
def download_progress() -> Iterator[zoedepth.download.Progress]:
    """Give a callback for ``load_model`` that draws a bar on a terminal, and prints a line now and then elsewhere."""
    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        yield _Lines(console)
        return
    columns = (
        TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    bar = Progress(*columns, console=console, transient=True)  # started by the first download, if there is one

    def draw(name: str, done: int, total: int | None) -> None:
        bar.start()
        task = next((task.id for task in bar.tasks if task.description == escape(name)), None)
        task = bar.add_task(escape(name)) if task is None else task
        bar.update(task, completed=done, total=total)

    try:
        yield draw
    finally:
        if bar.live.is_started:
            bar.stop()


def track(
    items: Iterable[_Item], what: str, *, total: int | None = None, first: int = 0, console: Console | None = None
) -> Iterator[_Item]:
    """Yield the items, and show how many are done: a bar on a terminal, elsewhere a line every ``EVERY`` seconds.

    Args:
        items: things that take time, one after the other.
        what: the work, e.g. "depth".
        total: the number of all items; None: the length of ``items``.
        first: how many of them were done before.
        console: where to show it; None: standard error.
    """
    console = console or Console(stderr=True, highlight=False)
    total = len(items) if total is None and isinstance(items, Sized) else total
    if console.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task(escape(what), total=total, completed=first)
            for item in items:
                yield item
                bar.advance(task)
        return
    began = last = monotonic()
    for done, item in enumerate(items, 1):
        yield item
        now = monotonic()
        if now - last >= EVERY:
            last = now
            of_total = "" if total is None else f" of {total:,}"
            left = "" if total is None else f", {_span((total - first - done) * (now - began) / done)} left"
            console.print(f"{what}: {first + done:,}{of_total}{left}", soft_wrap=True, markup=False)


@contextmanager
def show_tally(tally: "Tally", what: str, console: Console) -> Iterator[None]:
    """Show how far a job is until the block ends: a bar on a terminal, elsewhere a line every ``EVERY`` seconds.

    Args:
        tally: the numbers, which change meanwhile.
        what: the work, e.g. "depth".
        console: where to show it.
    """
    ended = threading.Event()

    def draw() -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task(escape(what), total=tally.total)
            while not ended.wait(_REDRAW):
                bar.update(task, completed=tally.seen, total=tally.total)

    def print_lines() -> None:
        began = monotonic()
        while not ended.wait(EVERY):
            console.print(tally_line(tally, what, seconds=monotonic() - began), soft_wrap=True, markup=False)

    thread = threading.Thread(target=draw if console.is_terminal else print_lines, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def tally_line(tally: "Tally", what: str, *, seconds: float) -> str:
    """Return how far a job is: done, failed, rate, and the time that is left.

    Args:
        tally: the numbers.
        what: the work, e.g. "depth".
        seconds: time since the job began.
    """
    n_worked = tally.done + tally.failed
    of_total = "" if tally.total is None else f" of {tally.total:,}"
    parts = [f"{what}: {tally.done + tally.before:,}{of_total} done", f"{tally.failed:,} failed"]
    if tally.before:
        parts.append(f"{tally.before:,} of them before")
    if n_worked:
        rate = n_worked / seconds
        parts.append(f"{rate:.1f} a second" if rate >= 1 else f"{1 / rate:.1f} s each")
        if tally.total is not None:
            parts.append(f"{_span((tally.total - tally.seen) / rate)} left")
    return ", ".join(parts)


def _span(seconds: float) -> str:
    """Return a time in the unit that suits it: "40 s", "12 min", "3.5 h"."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


class _Lines:
    """A line at the start, one every ``EVERY`` seconds, and one at the end."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.last: float | None = None

    def __call__(self, name: str, done: int, total: int | None) -> None:
        """Print a line where one is due."""
        now = monotonic()
        if self.last is not None and now - self.last < EVERY and done != total:
            return
        self.last = now
        of_total = "" if total is None else f" of {total / 1e6:,.0f}"
        self.console.print(f"downloading {escape(name)}: {done / 1e6:,.0f}{of_total} MB", soft_wrap=True)
