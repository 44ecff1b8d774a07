"""The manifest of a job that writes to a store, which has no files that one can add to: many parts of it."""

import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Any

from zoedepth.jobs.destinations import Store
from zoedepth.jobs.manifest import Manifest
from zoedepth.jobs.origins import open_store, patiently

EVERY = 5.0
"""Seconds after which new lines go to the store as a part, at the next line."""


class StoredManifest(Manifest):
    """A manifest in parts, objects below ``<prefix>/<name>/``, whose order is that of their names.

    It is worked on in a temporary folder. A kill loses the lines of the last ``EVERY`` seconds: their photos are done
    again, and their files replaced by the same ones. A store knows no locks, so that nothing tells two commands of one
    another: give each a ``--shard``.

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
        self._began, self._parts = time.time_ns(), 0
        self._waiting: list[bytes] = []
        self._flushed = time.monotonic()
        self._flushing = Lock()
        path = Path(self._folder.name, name)
        with path.open("wb") as file:
            for part in stored_parts(store, self._prefix):
                file.write(part)
        super().__init__(path)

    def begin(self, settings: Mapping[str, object], *, named: bool, overwrite: bool = False) -> None:
        """See ``Manifest.begin``. The line is in the store when this returns."""
        super().begin(settings, named=named, overwrite=overwrite)
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
        part = Path(self._folder.name, "part")
        part.write_bytes(b"".join(self._waiting))
        self._store.put(part, f"{self._prefix}/{self._began:020d}-{self._parts:08d}.jsonl")
        self._waiting.clear()
        self._parts += 1
        self._flushed = time.monotonic()

    def close(self) -> None:
        """Bring the last lines to the store, and take the copy off the disk.

        Raises:
            OSError: the store does not take them.
        """
        try:
            with self._flushing:
                self._flush()
        finally:
            super().close()
            self._folder.cleanup()


def stored_parts(store: Store, prefix: str) -> list[bytes]:
    """Return the parts of a manifest in their order; none where there is no manifest.

    Args:
        store: the store, with its prefix.
        prefix: name of the manifest without its suffix.
    """
    system, root = open_store(store.address)
    folder = f"{root.rstrip('/')}/{prefix}"

    def names() -> list[str]:
        try:
            found: list[Any] = system.ls(folder, detail=False)
        except FileNotFoundError:
            return []
        return sorted(str(name) for name in found if str(name).endswith(".jsonl"))

    return [patiently(lambda name=name: system.cat_file(name)) for name in patiently(names)]
