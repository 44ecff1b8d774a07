"""The manifest of a job: a file of JSON lines that says what became of each input, and by which settings.

    {"zoedepth_manifest": 1, "fingerprint": "5f0c…", "settings": {…}, "named": false, …}    a command has begun
    {"input": "/photos/a.jpg", "size": 81920, "version": 17642…, "status": "done", "outputs": {…}, "seconds": 0.21}
    {"input": "/photos/b.jpg", "size": 0, "version": 17642…, "status": "failed", "error": "… is not an image …"}

Lines are only ever added, each in one write, after the files that it tells of have their names. So whatever moment a
command is killed at, the file tells the truth: a line that is cut is no line, and its input is done again.
"""

import errno
import hashlib
import json
import os
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO
from uuid import uuid4

from zoedepth.errors import InputError
from zoedepth.jobs.names import row_key, temporary_database
from zoedepth.jobs.shard import JobShard
from zoedepth.lock import only_one, this_process
from zoedepth.stored import readable, to_json

NAME = "zoedepth-manifest"
"""Beginning of a manifest's name."""

_BEGINS = b'{"zoedepth_manifest": 1, '
_MAX_LINE = 1 << 20  # bytes
_AT_ONCE = 10_000  # lines that go into the index together
_COUNTED = "(:run IS NULL OR run = :run)"  # of the index: by all settings, or by these
_Row = tuple[bytes, int, int, str, str]  # of the index, as its table is


@dataclass(frozen=True)
class Entry:
    """A line of the manifest: what became of an input."""

    input: str
    """The input: an absolute path, an address, or archive::member."""
    status: str
    """ "done" or "failed"."""
    size: int | None = None
    """Bytes of the input; None where the store does not say it."""
    version: int | str | None = None
    """The time of the input's last change in nanoseconds, or what its store has for it, such as an ETag."""
    outputs: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    """Name of the output, or "sidecar" → its file, relative to the job's folder, and that file's bytes."""
    seconds: float = 0.0
    """Time from the open input to the written files."""
    error: str | None = None

    def to_line(self) -> bytes:
        """Return the line, with its end."""
        values: dict[str, object] = {
            "input": self.input,
            "size": self.size,
            "version": self.version,
            "status": self.status,
            "outputs": self.outputs,
            "seconds": round(self.seconds, 3),
        }
        if self.error is not None:
            values["error"] = self.error
        return to_json(values).encode() + b"\n"


def parse_line(line: bytes) -> Entry | dict[str, Any] | None:
    """Read a line: an entry, the values of a command that has begun, or None for what is neither (a line cut short)."""
    if not line.endswith(b"\n") or len(line) > _MAX_LINE:
        return None
    try:
        values = json.loads(line.decode())
        if "zoedepth_manifest" in values:
            return values if isinstance(values["fingerprint"], str) else None
        size, version = values["size"], values["version"]
        outputs = {str(name): (str(file), int(n_bytes)) for name, (file, n_bytes) in values["outputs"].items()}
        return Entry(
            str(values["input"]),
            str(values["status"]),
            None if size is None else int(size),
            version if version is None or isinstance(version, int) else str(version),
            outputs,
            float(values["seconds"]),
            None if values.get("error") is None else str(values["error"]),
        )
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None


def manifest_name(shard: JobShard) -> str:
    """Return the name of the file: each shard has its own."""
    return f"{NAME}.jsonl" if shard.count == 1 else f"{NAME}-{shard.index}-of-{shard.count}.jsonl"


def only_command(manifest: Path) -> AbstractContextManager[None]:
    """Return the lock of a manifest, see ``zoedepth.lock.only_one``."""
    return only_one(
        manifest,
        work=f"works on {manifest}",
        advice="wait for it, stop it, give each command a --shard of its own, or choose another --out",
    )


def is_manifest(path: Path) -> bool:
    """Return True for a manifest of ours, or the beginning of one that was cut."""
    with path.open("rb") as file:
        start = file.read(len(_BEGINS))
    return start == _BEGINS[: len(start)]


class Manifest:
    """A manifest that a command reads, and adds to. Threads may add and ask at the same time.

    Its index is on disk, in a temporary database, so that memory does not grow with the inputs.

    Args:
        path: the file; it need not exist. Its lock must be held (``only_command``).
        whole: the manifest of the whole job, if this is a shard's: what is done there is done.

    Raises:
        InputError: the file is not a manifest.
    """

    def __init__(self, path: Path, *, whole: "Manifest | None" = None) -> None:
        self.path = path
        self._whole = whole
        self.name = str(path)
        """The path or the address, for people."""
        self.fingerprint = ""
        self.runs: list[dict[str, Any]] = []
        """The commands that have worked on it, as their first lines say."""
        self.n_done = self.n_failed = 0
        """Inputs that are done by the settings that count (``counted``), and those that have only failed."""
        self._lock = threading.Lock()
        self._database = temporary_database()
        self._database.execute(
            "CREATE TABLE entries (key BLOB PRIMARY KEY, place INTEGER, done INTEGER, run TEXT, state TEXT) "
            "WITHOUT ROWID"
        )
        self._file: int | None = None
        self._reader: BinaryIO | None = None
        self._knows_sidecars = False
        if path.exists():
            if not is_manifest(path):
                raise InputError(f"{path} is not a manifest of zoedepth: move it, or choose another folder")
            self._read()

    @property
    def last_job(self) -> dict[str, Any] | None:
        """The last command with more than photos that were named one by one; None where there was none."""
        return next((run for run in reversed(self.runs) if not run.get("named")), None)

    @property
    def counted(self) -> str | None:
        """The fingerprint of the settings whose entries count: those of the last job.

        None: photos were only named one by one. These may have settings of their own, and all count.
        """
        return None if self.last_job is None else self.last_job["fingerprint"]

    def begin(self, settings: Mapping[str, object], *, named: bool, overwrite: bool = False) -> None:
        """Write the line of a command that begins; from now on entries are its.

        Args:
            settings: everything that the outputs depend on, for people to read.
            named: the inputs are photos that were named one by one. These may have settings of their own: whoever
                names a photo with another option wants this photo anew. Folders, lists and archives may not, because
                the half of a folder with other weights would be taken for the whole.
            overwrite: every input is done again. What the manifest says of a job before is forgotten.

        Raises:
            InputError: the manifest is of a job with other settings.
            OSError: it cannot be written.
        """
        fingerprint = fingerprint_of(settings)
        forget = overwrite and not named
        last = self.last_job
        if not named and not forget and last is not None and last["fingerprint"] != fingerprint:
            raise InputError(
                f"{self.name} is the manifest of a job with other settings: {_difference(last, settings)}. Give the "
                "same options to go on with it, --overwrite to do everything again, or another --out"
            )
        self._open()
        line = begin_line(settings, fingerprint=fingerprint, named=named, overwrite=forget)
        self._write(line)
        self.fingerprint = fingerprint
        self.runs.append(json.loads(line))
        if forget:
            self._database.execute("DELETE FROM entries")

    def knows(self, path: str) -> bool:
        """Return True for a file that a command has done, whatever its settings, and that has not changed since."""
        asked = (row_key(readable(path)),)
        with self._lock:
            row = self._database.execute("SELECT state FROM entries WHERE key = ? AND done", asked).fetchone()
        if row is None:
            return False
        try:
            now = os.stat(path)
        except OSError:
            return False
        return row[0] == _state(now.st_size, now.st_mtime_ns)

    def find(self, name: str) -> Entry | None:
        """Return the entry of an input that is done by the settings of this command; None where there is none."""
        entry = self._find(readable(name), self.fingerprint)
        if entry is None and self._whole is not None and not any(run.get("overwrite") for run in self.runs):
            entry = self._whole._find(readable(name), self.fingerprint)
        return entry

    def _find(self, name: str, fingerprint: str) -> Entry | None:
        asked = (row_key(name), fingerprint)
        with self._lock:
            row = self._database.execute(
                "SELECT place FROM entries WHERE key = ? AND done AND run = ?", asked
            ).fetchone()
            if row is None or self._reader is None:
                return None
            self._reader.seek(row[0])
            entry = parse_line(self._reader.readline(_MAX_LINE + 1))
        return entry if isinstance(entry, Entry) and entry.input == name else None

    def input_of(self, sidecar: str) -> str | None:
        """Return the last input of an earlier command that got this sidecar; None where there is none.

        The first question reads the file of the manifest once more.

        Args:
            sidecar: its path relative to the job's folder.
        """
        if not self._knows_sidecars:
            self._read_sidecars()
        with self._lock:
            row = self._database.execute("SELECT input FROM sidecars WHERE key = ?", (row_key(sidecar),)).fetchone()
        if row is not None:
            return row[0]
        return None if self._whole is None else self._whole.input_of(sidecar)

    def current(self, fingerprint: str | None = None) -> Iterator[Entry]:
        """Yield the entries that hold: of each input that was done, its last success, and of others, a failure.

        They come in the order of the file.

        Args:
            fingerprint: settings; the entries of others are left out. None: those that count (``counted``).
        """
        asked = {"run": fingerprint or self.counted}
        rows = self._database.execute(f"SELECT place FROM entries WHERE {_COUNTED} ORDER BY place", asked)
        if not self.path.exists():
            return
        with self.path.open("rb") as file:
            for (place,) in rows:
                file.seek(place)
                entry = parse_line(file.readline(_MAX_LINE + 1))
                if isinstance(entry, Entry):
                    yield entry

    def add(self, entry: Entry) -> None:
        """Add an entry. When this returns, it is in the file.

        Raises:
            OSError: it cannot be written: the disk is full, or gone.
        """
        self._write(entry.to_line())

    def flush(self) -> None:
        """Bring all entries to where the next command looks for them. Those of a file are there already.

        Raises:
            OSError: they cannot be written.
        """

    def close(self) -> None:
        """Close the file, and take the index off the disk."""
        if self._file is not None:
            os.close(self._file)
        if self._reader is not None:
            self._reader.close()
        self._file = self._reader = None
        with self._lock:  # SQLite crashes where another thread asks meanwhile
            self._database.close()

    def _open(self) -> None:
        if self._file is not None:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
        size = os.fstat(self._file).st_size
        if not self.runs:
            os.ftruncate(self._file, 0)  # the first line was cut: nothing that follows it could be told
        elif not _ends_with_line(self.path, size):
            self._write(b"\n")  # a command was killed while it wrote a line

    def _write(self, line: bytes) -> None:
        assert self._file is not None, "begin() comes first"
        with self._lock:
            n_written = os.write(self._file, line)
        if n_written < len(line):  # a disk that becomes full takes a part
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))

    def _read(self) -> None:
        rows: list[_Row] = []
        fingerprint = ""
        for place, line in numbered_lines(self.path):
            found = parse_line(line)
            if isinstance(found, Entry):
                state = _state(found.size, found.version)
                rows.append((row_key(found.input), place, found.status == "done", fingerprint, state))
            elif found is not None:
                fingerprint = found["fingerprint"]
                self.runs.append(found)
                if found.get("overwrite"):
                    rows.clear()
                    self._database.execute("DELETE FROM entries")
            if len(rows) >= _AT_ONCE:
                self._keep(rows)
        self._keep(rows)
        if self.runs:
            self.fingerprint = fingerprint
            self._reader = self.path.open("rb")
        count = f"SELECT COUNT(*) FROM entries WHERE done = :done AND {_COUNTED}"
        self.n_done, self.n_failed = (
            self._database.execute(count, {"run": self.counted, "done": done}).fetchone()[0] for done in (1, 0)
        )

    def _read_sidecars(self) -> None:
        with self._lock:
            self._database.execute("CREATE TABLE sidecars (key BLOB PRIMARY KEY, input TEXT) WITHOUT ROWID")
            self._database.execute("BEGIN")
            for _, line in numbered_lines(self.path):
                found = parse_line(line)
                if isinstance(found, dict) and found.get("overwrite"):
                    self._database.execute("DELETE FROM sidecars")
                elif isinstance(found, Entry) and "sidecar" in found.outputs:
                    row = (row_key(found.outputs["sidecar"][0]), found.input)
                    self._database.execute("INSERT OR REPLACE INTO sidecars VALUES (?, ?)", row)
            self._database.execute("COMMIT")
            self._knows_sidecars = True

    def _keep(self, rows: list[_Row]) -> None:
        """Put lines into the index. A success stays, whatever fails after it by the same settings on the same input."""
        self._database.execute("BEGIN")
        self._database.executemany(
            "INSERT INTO entries VALUES (?, ?, ?, ?, ?) ON CONFLICT (key) DO UPDATE SET place = excluded.place, "
            "done = excluded.done, run = excluded.run, state = excluded.state "
            "WHERE excluded.done OR NOT done OR run != excluded.run OR state != excluded.state",
            rows,
        )
        self._database.execute("COMMIT")
        rows.clear()


def _state(size: int | None, version: int | str | None) -> str:
    """Return an input's size and version as one text of the index."""
    return f"{size} {version}"


def begin_line(settings: Mapping[str, object], *, fingerprint: str, named: bool, overwrite: bool = False) -> bytes:
    """Return the line of a command that begins; see ``Manifest.begin``."""
    run = {
        "zoedepth_manifest": 1,
        "fingerprint": fingerprint,
        "named": named,
        "overwrite": overwrite,
        "run": uuid4().hex,  # in a store two commands are told apart by it
        "by": this_process(),
        "began": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "settings": settings,
    }
    return to_json(run).encode() + b"\n"


def fingerprint_of(settings: Mapping[str, object]) -> str:
    """Return a short hash of settings."""
    return hashlib.sha256(to_json(dict(sorted(settings.items()))).encode()).hexdigest()[:16]


def numbered_lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the byte at which each line of a file begins, and the line; of a line that is far too long, its parts."""
    place = 0
    with path.open("rb", buffering=1 << 20) as file:
        while line := file.readline(_MAX_LINE + 1):
            yield place, line
            place += len(line)


def _ends_with_line(path: Path, size: int) -> bool:
    if size == 0:
        return True
    with path.open("rb") as file:
        file.seek(size - 1)
        return file.read(1) == b"\n"


def _difference(run: Mapping[str, Any], settings: Mapping[str, object]) -> str:
    """Return which settings of a command differ from those that are wanted now."""
    before = run.get("settings")
    if not isinstance(before, dict):
        return "it does not say which"
    now = json.loads(to_json(settings))
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    return ", ".join(f"{name} was {_short(before.get(name))} and is now {_short(now.get(name))}" for name in names)


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
