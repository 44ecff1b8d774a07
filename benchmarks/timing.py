"""Time several functions in turn, so that a drift of the machine's speed hits all alike."""

import statistics
import time
from collections.abc import Callable, Mapping

from rich.console import Console
from rich.table import Table


def compare(title: str, functions: Mapping[str, Callable[[], object]], *, runs: int = 7, warmup: int = 2) -> None:
    """Print median, fastest and slowest time of each function, and its median as a ratio to the first's."""
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    for run in range(warmup + runs):
        for name, function in functions.items():
            start = time.perf_counter()
            function()
            if run >= warmup:
                seconds[name].append(time.perf_counter() - start)
    table = Table("", "median ms", "fastest", "slowest", "ratio", title=title)
    first = statistics.median(next(iter(seconds.values())))
    for name, times in seconds.items():
        median = statistics.median(times)
        cells = (f"{1000 * value:.1f}" for value in (median, min(times), max(times)))
        table.add_row(name, *cells, f"{median / first:.2f}")
    Console().print(table)
