"""Download files from the web: whole or not at all, going on where an interrupted download stopped."""

import errno
import hashlib
import json
import logging
import os
import shutil
import stat
import tempfile
from collections.abc import Callable
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
"""Seconds to wait for an answer or for the next byte before giving up."""

Progress = Callable[[str, int, int | None], object]
"""Function that is told how far a download is: the file's name, the bytes that are here, and the bytes of the whole
file (None where the server does not say). It is called before the first byte and after every piece."""

_CHUNK = 1 << 20
_WORTH_A_LINE = 1_000_000
"""Bytes from which a download is logged; smaller files arrive before anybody wonders."""

_log = logging.getLogger("zoedepth")


def cache_home() -> Path:
    """Return the folder for files that can be fetched again: ``XDG_CACHE_HOME``, else ``~/.cache``.

    A user without a home, or with one that cannot be written to, as in containers, has one in the folder for temporary
    files instead. It is made for that user alone.

    Raises:
        InputError: the one in the folder for temporary files is, or may have been filled, by somebody else.
    """
    if given := os.environ.get("XDG_CACHE_HOME"):
        return Path(os.path.expanduser(given))
    home = Path(os.path.expanduser("~"))  # unlike Path.home, it raises nothing: without a home it gives "~"
    cache = home / ".cache"
    if os.path.isdir(cache) or (home.is_absolute() and os.access(home, os.W_OK)):
        return cache
    user = os.getuid() if hasattr(os, "getuid") else None
    folder = Path(tempfile.gettempdir()) / f"zoedepth-{'user' if user is None else user}"
    _own(folder, user)
    return folder


def _own(folder: Path, user: int | None) -> None:
    """Make a folder for one user alone, where everybody may make one of this name before.

    Raises:
        InputError: it is there, and somebody else may write into it: weights and compiled models would be theirs.
    """
    with suppress(OSError):  # it is there already; or nothing can be made here, and whoever writes a file says so
        folder.mkdir(mode=0o700)
    try:
        found = folder.lstat()
    except OSError:  # see above
        return
    if user is None:  # on Windows the folder for temporary files is the user's own
        return
    if not stat.S_ISDIR(found.st_mode):
        problem = "is a link or a file, and no folder"
    elif found.st_uid != user:
        problem = "belongs to another user"
    elif found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        problem = "can be written to by other users"
    else:
        return
    raise InputError(
        f"{folder}, where files would be kept for a user without a home, {problem}: what lies in it cannot be trusted. "
        "Set XDG_CACHE_HOME to a folder of your own (HF_HOME for models of Hugging Face alone), or remove it"
    )


def download(
    url: str, path: Path, *, sha256: str | None = None, name: str | None = None, progress: Progress | None = None
) -> Path:
    """Download a file to ``path``, whole or not at all. If the file is there already, no network is used.

    The bytes of an interrupted download stay in ``<path>.part``. The next call goes on from there if the server still
    has the same file.

    Args:
        url: http or https address.
        path: file to write; missing folders are made.
        sha256: expected SHA-256 of the file, in hexadecimal; None trusts the server.
        name: how messages call the file; None: its file name.
        progress: function to call while the file arrives; None: one line in the log, ``logging.getLogger("zoedepth")``.

    Returns:
        ``path``.

    Raises:
        InputError: the address is not http(s), the server cannot be reached or refuses, the connection is cut, the disk
            is too small, or the file has another hash. The message says what to do.
    """
    if path.exists():
        return path
    name = name or path.name
    if not url.lower().startswith(("http://", "https://")):
        raise InputError(f"cannot download {name} from {url!r}: the address must begin with http:// or https://")
    part, record, lock = (path.with_name(path.name + end) for end in (".part", ".part.json", ".lock"))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Only one process may write the part. The lock belongs to the operating system, which frees it when a process
        # is killed. A process that had to wait finds the file complete. The lock file is removed only after that: a
        # lock on a removed file protects nothing, but by then nobody needs it.
        with FileLock(lock):
            if not path.exists():
                _receive(url, part, record, name=name, checked=sha256 is not None, progress=progress)
                if sha256 is not None:
                    _verify(url, part, record, sha256=sha256, name=name)
                part.replace(path)
                record.unlink(missing_ok=True)
            with suppress(OSError):  # Windows does not remove open files
                lock.unlink()
    except InputError:
        raise
    except (OSError, HTTPException, ValueError) as error:  # ValueError: an address or a header that makes no sense
        if isinstance(error, OSError) and error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise InputError(
                f"cannot download {name} to {path.parent}: {error.strerror}. Set XDG_CACHE_HOME to a folder that you "
                "can write to, or give the path of the file"
            ) from error
        reason = error.reason if type(error) is URLError else error
        raise InputError(
            f"cannot download {name} from {url}: {reason}. Check the address, the connection and the disk. Or download "
            f"the file by other means and put it at {path}, or give its path"
        ) from error
    return path


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def version_of(url: str) -> str | None:
    """Return a text that changes with the file at an address: what its server says of its length, tag and time.

    None where the server cannot be reached, or says none of them.
    """
    try:
        with _open(url, {"Range": "bytes=0-0"}) as response:
            about = _describe(url, response)
    except (OSError, HTTPException, ValueError):
        return None
    said = {key: value for key, value in about.items() if key != "url" and value is not None}
    return json.dumps(said, sort_keys=True) if said else None


def _receive(url: str, part: Path, record: Path, *, name: str, checked: bool, progress: Progress | None) -> None:
    """Complete ``part``. ``record`` describes the file that it is a part of."""
    start, known = _left_over(part, record)
    if start and (known["url"], known["total"]) == (url, start):
        return  # the last attempt stopped between the last byte and the renaming
    response, start = _request(url, start, known)
    with response:
        about = _describe(url, response)
        total = about["total"]
        if response.headers.get_content_type() == "text/html":
            raise InputError(
                f"{url} is a web page, not the file {name}. A log-in page or a proxy may be in the way: open the "
                "address in a browser"
            )
        if total is not None and (free := shutil.disk_usage(part.parent).free) < total - start:
            raise InputError(
                f"the disk of {part.parent} has {free:,} bytes free, and {name} needs {total - start:,}: make room, "
                "or choose another place"
            )
        if progress is None and (total is None or total >= _WORTH_A_LINE):
            size = "of unknown size" if total is None else f"{total / 1e6:,.0f} MB"
            _log.warning("downloading %s (%s) from %s to %s", name, size, url, part.with_name(part.stem))
        with part.open("ab" if start else "wb") as file:
            # All weights of one architecture are equally long: without a tag or a hash, a part of another version
            # would look like a part of this one.
            resumable = total is not None and bool(about["etag"] or about["modified"] or checked)
            record.write_text(json.dumps(about) if resumable else "", encoding="utf-8")
            tell = progress or (lambda *_: None)
            done, trouble = _copy(response, file, start, lambda done: tell(name, done, total))
    if trouble or (total is not None and done != total):
        of_total = "" if total is None else f" of {total:,}"
        again = "goes on from there" if resumable else "starts over"
        raise InputError(
            f"the download of {name} from {url} stopped after {done:,}{of_total} bytes "
            f"({trouble or 'the connection was cut'}): typing the command again {again}"
        )


def _left_over(part: Path, record: Path) -> tuple[int, dict[str, Any]]:
    """Return the bytes that arrived before and the description of their file; 0 and {} if they cannot be used."""
    try:
        return part.stat().st_size, json.loads(record.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return 0, {}


def _request(url: str, start: int, known: dict[str, Any]) -> tuple[HTTPResponse, int]:
    """Ask for the file from byte ``start`` on, or for all of it if it has changed. Return where the answer begins."""
    if start:
        try:
            response = _open(url, {"Range": f"bytes={start}-"})
        except HTTPError as error:
            if error.code != HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:  # the file has become shorter
                raise
        else:
            if response.status == HTTPStatus.OK:  # this server sends whole files only
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
        error.close()  # or its connection stays open
        raise


def _describe(url: str, response: HTTPResponse) -> dict[str, Any]:
    """Return the headers that tell one version of a file from another."""
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
    response: HTTPResponse, file: IO[bytes], done: int, tell: Callable[[int], object]
) -> tuple[int, Exception | None]:
    """Write the bytes that arrive. Return the length of the file so far, and the error that stopped it, if any."""
    tell(done)
    try:
        while chunk := response.read1(_CHUNK):  # unlike read, it hands out what arrived before a connection broke
            file.write(chunk)
            done += len(chunk)
            tell(done)
    except (OSError, HTTPException) as error:
        return done, error
    return done, None


def _verify(url: str, part: Path, record: Path, *, sha256: str, name: str) -> None:
    """Refuse and delete a file with another hash."""
    found = sha256_of(part)
    if found != sha256.lower():
        part.unlink()
        record.unlink(missing_ok=True)
        raise InputError(
            f"{name} from {url} is not the file it should be: its SHA-256 is {found}, expected "
            f"{sha256.lower()}. It was deleted. Try again; if the hash stays the same, the file at this address has "
            "changed"
        )
