"""The number of threads of a forward: torch's, or, where torch is not imported, the one that it would take.

An exported model needs no torch, which takes seconds to import, and shall use the same threads.
"""

import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes.util import find_library
from threading import Lock

_VARIABLE = "OMP_NUM_THREADS"
"""Variable of the environment that torch reads once, when it is imported."""
_DRIVERS = ("/dev/nvidiactl", "/dev/nvmap", "/dev/kfd", "/dev/dxg", "/sys/module/xe")
"""Files of Linux where there is a driver: NVIDIA's, that of its Jetson, AMD's, that of either under Windows, Intel's.

Intel's older driver, i915, is on every laptop, most of which have nothing that torch can use.
"""


def cpu_count() -> int:
    """Return the number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def has_accelerator() -> bool:
    """Return True if there are signs of a device that torch may prefer to the processor. It need not be usable.

    Torch is asked where it is imported already, which takes seconds. Elsewhere the signs are drivers of NVIDIA, AMD and
    Intel, and Apple's processors.
    """
    accelerator = getattr(sys.modules.get("torch"), "accelerator", None)  # torch 2.6 has the first
    if accelerator is not None:
        return accelerator.is_available()
    if sys.platform == "darwin":
        return platform.machine() == "arm64"
    if sys.platform == "win32":
        return find_library("nvcuda") is not None
    return any(os.path.exists(driver) for driver in _DRIVERS)


def thread_count() -> int:
    """Return the number of threads that a forward computes with."""
    torch = sys.modules.get("torch")
    if torch is not None:
        return torch.get_num_threads()
    said = os.environ.get(_VARIABLE, "")
    return int(said) if said.isdecimal() and int(said) else cpu_count()


def wait_asleep() -> bool:
    """Return True if threads shall wait for each other asleep, and not in a loop that keeps a core busy.

    The variable is OpenMP's, which torch reads. The command line sets it.
    """
    return os.environ.get("OMP_WAIT_POLICY", "").upper() == "PASSIVE"


def set_thread_count(number: int) -> None:
    """Let forwards compute with this number of threads from now on; torch, too, if it is imported later."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(number)
    else:
        os.environ[_VARIABLE] = str(number)


@contextmanager
def threads(number: int) -> Iterator[None]:
    """Let forwards compute with this number of threads until the block ends; torch, too, if it is imported inside."""
    before, said = thread_count(), os.environ.get(_VARIABLE)
    set_thread_count(number)
    try:
        yield
    finally:
        if said is not None:
            os.environ[_VARIABLE] = said
        else:
            os.environ.pop(_VARIABLE, None)
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(before)


@contextmanager
def share_cores(workers: int) -> Iterator[None]:
    """Give each of ``workers`` forwards that run at the same time its share of the cores, until the block ends.

    A model in OpenVINO's or ONNX's format takes its number of threads when it is loaded: load it inside.
    """
    # A core for each photo: the threads of one forward wait for each other all the time.
    with threads(thread_count() if workers < 2 else max(1, cpu_count() // workers)):
        yield


_KEPT = Lock()
_keeping = 0
_kept = 0


@contextmanager
def threads_kept() -> Iterator[int]:
    """Give forwards as many threads as before when the block ends: what a thread sets, torch hands on to later ones.

    Blocks may overlap, in threads that share a model: the last to end puts the number back that the first has found.

    Yields:
        That number.
    """
    global _keeping, _kept  # one number for the process, as torch's
    with _KEPT:
        if not _keeping:
            _kept = thread_count()
        _keeping += 1
    try:
        yield _kept
    finally:
        with _KEPT:
            _keeping -= 1
            set_thread_count(_kept)
