"""One of n commands that share the inputs of a job: each input belongs to exactly one of them."""

import re
from dataclasses import dataclass
from pathlib import PurePosixPath

from zoedepth.errors import InputError
from zoedepth.jobs.names import key_of

MOST = 100_000
"""Shards of a job, at most."""


@dataclass(frozen=True)
class JobShard:
    """Shard ``index`` of ``count``, both as in ``--shard 0/8``.

    An input's shard depends on its place in the tree alone (its path below the folder, its line in the list), and not
    on the machine, on where the folder is mounted, or on what else is in it.

    Raises:
        InputError: the index is not one of 0 to count - 1.
    """

    index: int = 0
    count: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.count <= MOST or not 0 <= self.index < self.count:
            raise InputError(
                f"--shard must be i/n with i from 0 to n - 1, and n from 1 to {MOST:,}: 0/4, 1/4, 2/4 and 3/4 for four "
                f"commands; got {self.index}/{self.count}"
            )

    @classmethod
    def parse(cls, text: str) -> "JobShard":
        """Read "i/n".

        Raises:
            InputError: it is not of this form.
        """
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text.strip())
        if found is None:
            raise InputError(f"--shard must be i/n, e.g. 0/4 for the first of four commands, got {text!r}")
        return cls(int(found[1]), int(found[2]))

    def holds(self, place: PurePosixPath) -> bool:
        """Return True if the input at this place of the tree belongs to the shard."""
        return self.count == 1 or int.from_bytes(key_of(place.as_posix())[:8], "big") % self.count == self.index

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"
