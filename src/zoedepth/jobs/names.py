"""A set of names that may be far larger than the memory."""

import errno
import hashlib
import os
import sqlite3
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

_CACHE = 512
"""Kilobytes of memory of a temporary database. SQLite's own 2000 are no faster with keys that come in no order."""


class Names:
    """A set of texts, kept on disk in a temporary database that vanishes with the process.

    It takes about half a megabyte of memory, whether it holds a thousand names or ten million.
    """

    def __init__(self) -> None:
        self._database = temporary_database()
        self._database.execute("CREATE TABLE names (key BLOB PRIMARY KEY, batch INTEGER) WITHOUT ROWID")
        self._n_batches = 0

    def add(self, name: str) -> bool:
        """Add a name; returns True if it was not there before."""
        cursor = self._database.execute("INSERT OR IGNORE INTO names VALUES (?, ?)", (row_key(name), self._n_batches))
        return cursor.rowcount == 1

    def add_all(self, names: Sequence[str]) -> bool:
        """Add names if none of them was there before and no two are equal; otherwise add none, and return False."""
        self._n_batches += 1
        rows = [(row_key(name), self._n_batches) for name in names]
        self._database.execute("BEGIN")
        added = self._database.executemany("INSERT OR IGNORE INTO names VALUES (?, ?)", rows).rowcount
        if added < len(rows):
            self._database.executemany("DELETE FROM names WHERE key = ? AND batch = ?", rows)
        self._database.execute("COMMIT")
        return added == len(rows)

    def close(self) -> None:
        """Give the space on the disk back."""
        self._database.close()


class TemporaryDatabase(sqlite3.Connection):
    """A database on disk without a name, which SQLite deletes when it is closed, also by a kill."""

    def execute(self, sql: str, values: Any = ()) -> sqlite3.Cursor:
        """See ``sqlite3.Connection``.

        Raises:
            OSError: the disk for temporary files is full.
        """
        with _full_disk_is_told():
            return super().execute(sql, values)

    def executemany(self, sql: str, rows: Any) -> sqlite3.Cursor:
        """See ``execute``."""
        with _full_disk_is_told():
            return super().executemany(sql, rows)


@contextmanager
def _full_disk_is_told() -> Iterator[None]:
    try:
        yield
    except sqlite3.OperationalError as error:
        if "full" not in str(error):
            raise
        folder = os.environ.get("SQLITE_TMPDIR") or os.environ.get("TMPDIR") or "/var/tmp"
        full = f"the disk for temporary files is full: make room, or name another by TMPDIR ({error})"
        raise OSError(errno.ENOSPC, full, folder) from error


def temporary_database() -> TemporaryDatabase:
    """Return an empty temporary database."""
    database = sqlite3.connect("", isolation_level=None, check_same_thread=False, factory=TemporaryDatabase)
    database.execute("PRAGMA synchronous = OFF")
    database.execute("PRAGMA journal_mode = OFF")
    database.execute(f"PRAGMA cache_size = -{_CACHE}")
    return database


def key_of(name: str) -> bytes:
    """Return 16 bytes that stand for a name. That two of ten million share them has a chance of 10^-25."""
    return hashlib.blake2b(name.encode("utf-8", "surrogateescape"), digest_size=16).digest()


def row_key(name: str) -> bytes:
    """Return the key of a name in a database: ``key_of`` behind four bytes that the names of a folder share.

    So a folder's names lie side by side, and listing it reads a page of the database once rather than once a name.
    """
    end = max(name.rfind("/"), name.rfind("\\"))
    return zlib.crc32(name[:end].encode("utf-8", "surrogateescape")).to_bytes(4, "big") + key_of(name)
