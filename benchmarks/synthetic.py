"""Measure how fast synthetic scenes are rendered: images a second in one and two processes, CPU seconds an image."""

import os
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from rich.console import Console
from rich.table import Table

from zoedepth.synthetic import SyntheticScenes

SIZE = (288, 384)
PER_PROCESS = 24


def render(indices: Iterable[int], domain: str) -> tuple[float, int]:
    """Render the images of these numbers; return (CPU seconds, how many)."""
    data = SyntheticScenes(10_000, size=SIZE, domains=[domain])
    start, count = time.process_time(), 0
    for index in indices:
        data[index]
        count += 1
    return time.process_time() - start, count


def main() -> None:
    """Time rooms and streets of 384x288 pixels and print a table."""
    table = Table("", "processes", "images/s", "CPU s/image", title=f"synthetic scenes, {SIZE[1]}x{SIZE[0]}")
    for domain in ("indoor", "outdoor"):
        for n_processes in (1, 2):
            with ProcessPoolExecutor(n_processes, mp_context=get_context("spawn")) as pool:
                # Each process imports the package and makes its tables before the clock starts.
                list(pool.map(render, [range(2)] * n_processes, [domain] * n_processes))
                starts = [1000 * k for k in range(n_processes)]
                start = time.perf_counter()
                done = list(pool.map(render, [range(k, k + PER_PROCESS) for k in starts], [domain] * n_processes))
                seconds = time.perf_counter() - start
            cpu, count = (sum(column) for column in zip(*done, strict=True))
            table.add_row(domain, str(n_processes), f"{count / seconds:.2f}", f"{cpu / count:.3f}")
    Console().print(table)
    Console().print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
