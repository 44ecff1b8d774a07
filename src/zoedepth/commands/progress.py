"""Show on standard error how far a download is."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

import zoedepth.download

_STEP = 100_000_000
"""Bytes between two lines where there is no terminal."""


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


class _Lines:
    """A line at the start, one after every 100 MB, and one at the end."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.next = 0

    def __call__(self, name: str, done: int, total: int | None) -> None:
        """Print a line where one is due."""
        if done < self.next and done != total:
            return
        self.next = done - done % _STEP + _STEP
        of_total = "" if total is None else f" of {total / 1e6:,.0f}"
        self.console.print(f"downloading {escape(name)}: {done / 1e6:,.0f}{of_total} MB", soft_wrap=True)
