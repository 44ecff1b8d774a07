"""Threads of a forward, where torch is imported, where it is not, and where it is imported in between."""

import os
import platform
import subprocess
import sys

import pytest
import torch

from zoedepth import threads as module
from zoedepth.threads import has_accelerator, share_cores, thread_count, threads, threads_kept, wait_asleep


def printed(code: str, **environment: str) -> list[str]:
    """The lines that a fresh interpreter, which has not imported torch, prints after running ``code``."""
    code = f"import os, sys\nfrom zoedepth.threads import *\n{code}"
    others = {name: value for name, value in os.environ.items() if not name.startswith("OMP_")}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**others, **environment}
    )
    return done.stdout.split()


def test_torch_has_the_number_where_it_is_imported() -> None:
    before = torch.get_num_threads()
    with threads(before + 2):
        assert thread_count() == torch.get_num_threads() == before + 2
    assert thread_count() == torch.get_num_threads() == before


@pytest.mark.parametrize("said", ["3", "", "0", "4,2"])
def test_without_torch_the_variable_counts_or_the_cores(said: str) -> None:
    found, cores, torch_is_there = printed("print(thread_count(), cpu_count(), 'torch' in sys.modules)",
                                           OMP_NUM_THREADS=said)  # fmt: skip
    assert found == ("3" if said == "3" else cores)
    assert torch_is_there == "False"


def test_torch_that_is_imported_in_the_block_takes_the_number() -> None:
    code = """
with threads(1):
    print(thread_count())
    import torch
    print(torch.get_num_threads())
print(torch.get_num_threads(), thread_count(), os.environ.get("OMP_NUM_THREADS"))
"""
    assert printed(code, OMP_NUM_THREADS="2") == ["1", "1", "2", "2", "2"]


@pytest.mark.parametrize(
    ("system", "machine", "library", "drivers", "expected"),
    [
        ("linux", "x86_64", None, ("no such file",), False),
        ("linux", "x86_64", None, ("no such file", __file__), True),
        ("darwin", "arm64", None, (), True),
        ("darwin", "x86_64", None, (__file__,), False),
        ("win32", "AMD64", "nvcuda.dll", (), True),
        ("win32", "AMD64", None, (__file__,), False),
    ],
)
def test_accelerators_are_known_by_their_drivers(
    system: str,
    machine: str,
    library: str | None,
    drivers: tuple[str, ...],
    expected: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delitem(sys.modules, "torch")
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(module, "find_library", lambda name: library if name == "nvcuda" else None)
    monkeypatch.setattr(module, "_DRIVERS", drivers)
    assert has_accelerator() == expected


@pytest.mark.parametrize("found", [True, False])
def test_torch_that_is_there_is_asked_for_accelerators(found: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_DRIVERS", () if found else (__file__,))
    monkeypatch.setattr(torch.accelerator, "is_available", lambda: found)
    assert has_accelerator() == found


@pytest.mark.parametrize(("said", "asleep"), [("PASSIVE", True), ("passive", True), ("ACTIVE", False), (None, False)])
def test_threads_wait_as_openmp_is_told_to(said: str | None, asleep: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    if said is not None:
        monkeypatch.setenv("OMP_WAIT_POLICY", said)
    assert wait_asleep() == asleep


def test_threads_are_kept_where_blocks_overlap() -> None:
    before = torch.get_num_threads()
    first, second = threads_kept(), threads_kept()
    try:
        assert first.__enter__() == before
        torch.set_num_threads(before + 3)
        assert second.__enter__() == before
        first.__exit__(None, None, None)
        torch.set_num_threads(before + 4)
        second.__exit__(None, None, None)
        assert thread_count() == torch.get_num_threads() == before
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize(("workers", "expected"), [(2, 3), (4, 1), (1000, 1)])
def test_forwards_side_by_side_share_the_cores(monkeypatch: pytest.MonkeyPatch, workers: int, expected: int) -> None:
    monkeypatch.setattr("zoedepth.threads.cpu_count", lambda: 6)
    threads = torch.get_num_threads()
    with share_cores(1):
        assert torch.get_num_threads() == threads
    with share_cores(workers):
        assert torch.get_num_threads() == expected
    assert torch.get_num_threads() == threads
