"""Show on standard error how far a command is: a bar on a terminal, and a line now and then in a file or a pipe."""

from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager
from time import monotonic
from typing import TypeVar

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

EVERY = 15.0
"""Seconds between two lines where there is no terminal."""

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
