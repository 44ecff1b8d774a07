"""The manifest of a job that writes to a store, which has no files that one can add to: many parts of it."""

import errno
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock

from zoedepth.jobs.manifest import Manifest, parse_line
from zoedepth.jobs.origins import open_store, patiently
from zoedepth.jobs.store import Store

EVERY = 5.0
"""Seconds after which new lines go to the store as a part, at the next line."""


class StoredManifest(Manifest):
    """A manifest in parts, objects below ``<prefix>/<name>/``, whose order is that of their names.

    It is worked on in a temporary folder. A kill loses the lines of the last ``EVERY`` seconds: their photos are done
    again, and their files replaced by the same ones.

    A store knows no locks, and a command that was killed there looks like one that works. So the command that began
    last goes on: each part has the next number, under which there must be nothing yet, and a command that finds another
    one's part there ends.

    Args:
        store: the store, with its prefix.
        name: name of the manifest (``manifest.manifest_name``).

    Raises:
        InputError: the parts are none of a manifest.
        OSError: the store does not answer.
    """

    def __init__(self, store: Store, name: str) -> None:
        self._folder = TemporaryDirectory(prefix="zoedepth-")
        self._store, self._prefix = store, name.removesuffix(".jsonl")
        self._waiting: list[bytes] = []
        self._flushed = time.monotonic()
        self._flushing = Lock()
        self._number = 0  # of the next part
        path = Path(self._folder.name, name)
        with path.open("wb") as file:
            for number, part in stored_parts(store, self._prefix):
                file.write(part)
                self._number = number + 1
        super().__init__(path)
        self.name = f"{store.address}/{self._prefix}"

    def begin(self, settings: Mapping[str, object], *, named: bool, overwrite: bool = False) -> None:
        """See ``Manifest.begin``. The line is in the store when this returns."""
        super().begin(settings, named=named, overwrite=overwrite)
        self.flush()

    def flush(self) -> None:
        """See ``Manifest.flush``."""
        with self._flushing:
            self._flush()

    def _write(self, line: bytes) -> None:
        super()._write(line)
        with self._flushing:
            self._waiting.append(line)
            if time.monotonic() - self._flushed >= EVERY:
                self._flush()

    def _flush(self) -> None:
        if not self._waiting:
            return
        content = b"".join(self._waiting)
        part, relative = Path(self._folder.name, "part"), f"{self._prefix}/{self._number:08d}.jsonl"
        part.write_bytes(content)
        try:
            self._store.put(part, relative, replace=False)
        except OSError as error:
            there = self._store.content(relative)
            if there is None:
                raise
            if there != content:  # it is, where the store has taken it, and its answer was lost
                raise FileExistsError(errno.EEXIST, _taken(there)) from error
        self._waiting.clear()
        self._number += 1
        self._flushed = time.monotonic()

    def close(self) -> None:
        """Bring the last lines to the store, if it takes them, and take the copy off the disk."""
        with suppress(OSError):  # after ``flush`` there are none; photos of lines that are lost are done again
            self.flush()
        super().close()
        self._folder.cleanup()


def stored_parts(store: Store, prefix: str) -> Iterator[tuple[int, bytes]]:
    """Yield the number and the content of each part of a manifest, in their order; none where there is no manifest.

    Args:
        store: the store, with its prefix.
        prefix: name of the manifest without its suffix.
    """
    system, root = open_store(store.address)
    folder = f"{root.rstrip('/')}/{prefix}"

    def names() -> list[str]:
        try:
            return [str(name) for name in system.ls(folder, detail=False)]
        except FileNotFoundError:
            return []

    for name in sorted(patiently(names)):
        if found := re.fullmatch(r"(\d+)\.jsonl", name.rpartition("/")[2]):
            yield int(found[1]), patiently(lambda name=name: system.cat_file(name))


def _taken(part: bytes) -> str:
    """Return what to tell somebody whose manifest has another command's part."""
    first = parse_line(part.splitlines(keepends=True)[0]) if part else None
    who = str(first.get("by")) if isinstance(first, dict) else "it does not say who"
    return (
        f"another command has begun on it since: {who}. This one ends, so that no more is done twice. Give each "
        "command a --shard of its own, or another --out"
    )
