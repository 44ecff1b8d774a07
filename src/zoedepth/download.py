"""Files from the web: whole or not at all, and taken up where an interrupted download stopped."""

import hashlib
import json
import shutil
from contextlib import suppress
from http import HTTPStatus
from http.client import HTTPException, HTTPResponse
from pathlib import Path
from typing import IO, Any
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

from filelock import FileLock

from zoedepth.errors import InputError

TIMEOUT = 30.0
"""Seconds without an answer or a byte after which a server is given up."""

_CHUNK = 1 << 20


def download(url: str, path: Path, *, sha256: str | None = None, name: str | None = None) -> Path:
    """Download a file to ``path``, whole or not at all; a file that is there already is returned without network.

    What has arrived of an interrupted download stays in ``<path>.part``, and the next call goes on from there if the
    server still has the same file.

    Args:
        url: address, http or https.
        path: where to write; folders are made.
        sha256: what the bytes must hash to, in hexadecimal; None trusts the server.
        name: what to call the file in messages; None: its file name.

    Returns:
        ``path``.

    Raises:
        InputError: the address is of another kind, the server cannot be reached or refuses, the connection is cut, the
            disk is too small, or the file is not the one of ``sha256``. The message says what to do.
    """
    if path.exists():
        return path
    name = name or path.name
    if not url.lower().startswith(("http://", "https://")):
        raise InputError(f"cannot download {name} from {url!r}: the address must begin with http:// or https://")
    part, record, lock = (path.with_name(path.name + end) for end in (".part", ".part.json", ".lock"))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Two processes must not write to one part. The lock is the operating system's, so that a process that is killed
        # holds none; who waits for it finds the file complete. It is removed only once the file is there: a lock taken
        # on a removed file is worth nothing, but then nobody needs one any more.
        with FileLock(lock):
            if not path.exists():
                _receive(url, part, record, name=name, checked=sha256 is not None)
                if sha256 is not None:
                    _verify(url, part, record, sha256=sha256, name=name)
                part.replace(path)
                record.unlink(missing_ok=True)
            with suppress(OSError):  # Windows does not remove open files
                lock.unlink()
    except InputError:
        raise
    except (OSError, HTTPException, ValueError) as error:  # ValueError: an address or a header that makes no sense
        reason = error.reason if type(error) is URLError else error
        raise InputError(
            f"cannot download {name} from {url}: {reason}. Check the address, the connection and the disk. A file "
            f"downloaded by other means can be put at {path}, or given by its own path"
        ) from error
    return path


def _receive(url: str, part: Path, record: Path, *, name: str, checked: bool) -> None:
    """Complete ``part``; ``record`` says which file it is a part of."""
    start, known = _left_over(part, record)
    if start and (known["url"], known["total"]) == (url, start):
        return  # stopped between the last byte and the renaming
    response, start = _request(url, start, known)
    with response:
        about = _describe(url, response)
        total = about["total"]
        if response.headers.get_content_type() == "text/html":
            raise InputError(f"{url} is a web page, not the file {name}: a log-in page or a proxy may be in the way")
        if total is not None and (free := shutil.disk_usage(part.parent).free) < total - start:
            raise InputError(
                f"the disk of {part.parent} has {free:,} bytes free, and {name} needs {total - start:,}: make room, "
                "or choose another place"
            )
        with part.open("ab" if start else "wb") as file:
            # Files of one architecture are equally long, so that without a tag or a hash a part of another version
            # would be taken for a part of this one.
            resumable = total is not None and bool(about["etag"] or about["modified"] or checked)
            record.write_text(json.dumps(about) if resumable else "", encoding="utf-8")
            done, trouble = _copy(response, file, start=start, total=total, name=name)
    if trouble or (total is not None and done != total):
        of_total = "" if total is None else f" of {total:,}"
        again = "goes on from there" if resumable else "starts over"
        raise InputError(
            f"the download of {name} from {url} stopped after {done:,}{of_total} bytes "
            f"({trouble or 'the connection was cut'}): typing the command again {again}"
        )


def _left_over(part: Path, record: Path) -> tuple[int, dict[str, Any]]:
    """Bytes that have arrived before, and the description of the file they are from; 0 if they cannot be used."""
    try:
        return part.stat().st_size, json.loads(record.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return 0, {}


def _request(url: str, start: int, known: dict[str, Any]) -> tuple[HTTPResponse, int]:
    """The rest of the file from byte ``start`` if it is still the known one, else all of it; and where it begins."""
    if start:
        try:
            response = _open(url, {"Range": f"bytes={start}-"})
        except HTTPError as error:
            if error.code != HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:  # that is: the file has become shorter
                raise
        else:
            if response.status == HTTPStatus.OK:  # this server does not send parts
                return response, 0
            begins = response.headers.get("Content-Range", "").startswith(f"bytes {start}-")
            if begins and _describe(url, response) == known:
                return response, start
            response.close()
    return _open(url, {}), 0


def _open(url: str, headers: dict[str, str]) -> HTTPResponse:
    try:
        return urlopen(Request(url, headers={"User-Agent": "zoedepth", **headers}), timeout=TIMEOUT)
    except HTTPError as error:
        error.close()  # its connection stays open otherwise
        raise


def _describe(url: str, response: HTTPResponse) -> dict[str, Any]:
    """What tells one version of a file from another."""
    if response.status == HTTPStatus.PARTIAL_CONTENT:
        total = response.headers.get("Content-Range", "").rpartition("/")[2]
    else:
        total = response.headers.get("Content-Length", "")
    return {
        "url": url,
        "total": int(total) if total.isdecimal() else None,
        "etag": response.headers.get("ETag"),
        "modified": response.headers.get("Last-Modified"),
    }


def _copy(
    response: HTTPResponse, file: IO[bytes], *, start: int, total: int | None, name: str
) -> tuple[int, Exception | None]:
    """Write what arrives, with a progress bar on a terminal; returns the length reached, and what stopped it early."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

    console, done = Console(stderr=True), start
    columns = (
        TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(escape(name), total=total, completed=start)
        try:
            while chunk := response.read1(_CHUNK):  # unlike read, hands out what arrived before a connection broke
                file.write(chunk)
                done += len(chunk)
                progress.update(task, completed=done)
        except (OSError, HTTPException) as error:
            return done, error
    return done, None


def _verify(url: str, part: Path, record: Path, *, sha256: str, name: str) -> None:
    digest = hashlib.sha256()
    with part.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    if digest.hexdigest() != sha256.lower():
        part.unlink()
        record.unlink(missing_ok=True)
        raise InputError(
            f"{name} from {url} is not the file it should be: its SHA-256 is {digest.hexdigest()}, expected "
            f"{sha256.lower()}. It was deleted; try again, and if it stays so, the file behind the address has changed"
        )
