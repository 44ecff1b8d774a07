"""The runtime that was chosen for some weights on this machine, written down in the user's cache."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.runtimes.exports import cache_folder
from zoedepth.runtimes.machine import Machine
from zoedepth.runtimes.runtime import RUNTIMES
from zoedepth.stored import read_json, to_json

MAX_REL, ENOUGH_PHOTOS = 0.01, 8
"""Largest REL of a photo's depth, against that of torch in float32, with which a runtime may be chosen, and the number
of photos that this takes. Of fewer it is half as large, because others may differ more."""

_AS_FAST = 0.03
"""Runtimes this little slower than the fastest are as fast; of these the one is chosen that differs least."""


@dataclass(frozen=True)
class Row:
    """A row of the table: how fast a runtime is here, or why it did not run."""

    runtime: str
    """Name of the runtime."""
    seconds: float | None = None
    """Median time of one photo, with all cores."""
    least: float | None = None
    """Seconds of the fastest photo."""
    most: float | None = None
    """Seconds of the slowest photo."""
    photos_a_second: float | None = None
    """Median rate where as many photos are computed at the same time as there are cores, each on one."""
    memory_mb: float | None = None
    """Most memory of the process, with one photo at a time; None where the system does not say it."""
    gpu_memory_mb: float | None = None
    """Most memory of the GPU; None on the CPU."""
    first_depth: float | None = None
    """Seconds from the start of the process to the first depth."""
    difference: float | None = None
    """Largest REL of a photo: mean of |depth - depth of torch in float32| / the latter."""
    file: str = ""
    """The exported file that ran; empty for torch."""
    problem: str = ""
    """The reason why it did not run; empty where it did."""
    failed: bool = False
    """True if it should have run."""
    doubt: str = ""
    """The reason why it cannot be chosen whatever it differs by; empty where it can."""

    def fits(self, max_rel: float) -> bool:
        """Return True if it ran, and its depth differs by no more than a REL."""
        return self.difference is not None and self.difference <= max_rel and not self.doubt


def allowed_rel(n_photos: int) -> float:
    """Return the largest REL with which a runtime may be chosen that was compared on a number of photos."""
    return MAX_REL if n_photos >= ENOUGH_PHOTOS else MAX_REL / 2


def fastest(rows: Sequence[Row], *, max_rel: float = MAX_REL) -> Row:
    """Return the row that is chosen: the fastest that fits, and of those that are as fast the closest.

    Args:
        rows: the table.
        max_rel: see ``allowed_rel``.

    Raises:
        InputError: none can be chosen.
    """
    fit = [row for row in rows if row.fits(max_rel)]
    if not fit:
        problems = "; ".join(f"{row.runtime}: {row.problem}" for row in rows if row.failed)
        raise InputError(f"no runtime has given a depth: {problems or 'none is installed'}")
    best = max(row.photos_a_second or 0 for row in fit)
    near = [row for row in fit if (row.photos_a_second or 0) >= (1 - _AS_FAST) * best]
    return min(near, key=lambda row: row.difference or 0)


@dataclass(frozen=True)
class Choice:
    """A runtime, and everything for which it was chosen."""

    runtime: str
    """Name of the runtime."""
    why: str
    """The reason in a few words, for people."""
    weights: str
    """``Source.weights``."""
    machine: Machine
    versions: Mapping[str, str | None]
    """``machine.versions``."""
    date: str
    """The day of it, as 2026-01-31."""
    file: str = ""
    """Exported file of an int8 runtime, which cannot be made again without its photos."""
    rows: tuple[Row, ...] = ()
    """The table it was chosen by."""

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"zoedepth_choice": 1, **asdict(self)}


def write_choice(choice: Choice) -> Path:
    """Write a choice down, in place of an earlier one for the same weights and machine.

    Raises:
        OSError: nothing can be written to the cache.
    """
    path = _path(choice.weights, choice.machine)
    with atomic_path(path) as part:
        part.write_text(to_json(choice.to_json(), indent=2) + "\n", encoding="utf-8")
    return path


def read_choice(weights: str, machine: Machine, versions: Mapping[str, str | None]) -> Choice | None:
    """Return what was chosen for these weights, on this machine and with these versions; None where nothing was."""
    try:
        values = read_json(_path(weights, machine))
        known = {field.name for field in fields(Choice)} - {"rows", "machine"}
        choice = Choice(
            **{name: values[name] for name in known},
            machine=Machine(**values["machine"]),
            rows=tuple(Row(**row) for row in values["rows"]),
        )
    except (InputError, KeyError, TypeError):  # there is none, or another version of this package wrote it
        return None
    same = (choice.weights, choice.machine, choice.versions) == (weights, machine, dict(versions))
    return choice if same and choice.runtime in RUNTIMES else None


def _path(weights: str, machine: Machine) -> Path:
    return cache_folder() / "choices" / f"{weights}-{machine.fingerprint}.json"
