"""The number of threads of a forward: torch's, or, where torch is not imported, the one that it would take.

An exported model needs no torch, which takes seconds to import, and shall use the same threads.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_VARIABLE = "OMP_NUM_THREADS"
"""Variable of the environment that torch reads once, when it is imported."""


def cpu_count() -> int:
    """Return the number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count() -> int:
    """Return the number of threads that a forward computes with."""
    torch = sys.modules.get("torch")
    if torch is not None:
        return torch.get_num_threads()
    said = os.environ.get(_VARIABLE, "")
    return int(said) if said.isdecimal() and int(said) else cpu_count()


@contextmanager
def threads(number: int) -> Iterator[None]:
    """Let forwards compute with this number of threads until the block ends; torch, too, if it is imported inside."""
    before, said = thread_count(), os.environ.get(_VARIABLE)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(number)
    else:
        os.environ[_VARIABLE] = str(number)
    try:
        yield
    finally:
        if said is not None:
            os.environ[_VARIABLE] = said
        else:
            os.environ.pop(_VARIABLE, None)
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(before)
