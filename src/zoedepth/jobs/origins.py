"""Photos that are no files here: members of archives, objects of a store, addresses. Each is read whole, in memory."""

import re
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, cast

from zoedepth.errors import OPTIONAL, InputError, MissingExtraError
from zoedepth.images import check_expansion

MAX_PHOTO = 1 << 29
"""Bytes of a photo that is read into memory, at most."""

TRIES = 4
"""Times that a store is asked for the same thing, where it does not answer."""

_FIRST_WAIT = 0.5  # seconds before the second try; each that follows waits twice as long

# Names of parameters: those that only signed addresses have; others of theirs; others of Azure's, which has sv and sig.
_SIGNATURE = re.compile(r"(?i)x-amz-.*|x-goog-.*|signature|sig|awsaccesskeyid")
_BESIDE_SIGNATURE = re.compile(r"(?i)expires|googleaccessid|key-pair-id|policy|hash-algorithm")
_OF_AZURE = re.compile(r"sv|ss|srt|sp|st|se|spr|sip|sr|si|sdd|ses|scid|saoid|suoid|sk(oid|tid|t|e|s|v)")

Result = TypeVar("Result")


def is_address(text: str) -> bool:
    """Return True for an address of a store or of the web: s3://…, gs://…, https://…"""
    scheme, separator, _ = text.partition("://")
    return (
        bool(separator) and scheme.isascii() and scheme.replace("+", "").replace("-", "").isalnum() and len(scheme) > 1
    )


def open_store(address: str) -> tuple[Any, str]:
    """Return the store that an address names, by fsspec, and the path in it.

    Args:
        address: e.g. "s3://bucket/photos".

    Raises:
        InputError: there is no such kind of address.
        MissingExtraError: the library for this kind of store is not installed.
    """
    try:
        import fsspec
    except ModuleNotFoundError as error:
        raise MissingExtraError("cloud", address) from error
    try:
        return fsspec.core.url_to_fs(address, **_options(address))
    except ValueError as error:
        raise InputError(f"{address}: {error}. Known are s3://, gs://, https:// and others of fsspec") from error
    except ImportError as error:
        library = (error.name or str(error)).partition(".")[0]
        raise MissingExtraError(OPTIONAL.get(library, "cloud"), address) from error


def _options(address: str) -> dict[str, object]:
    """Return what a store is opened with: none keeps lists of files, which others may have changed by now."""
    return {} if address.startswith(("http://", "https://")) else {"use_listings_cache": False}


def patiently(function: Callable[[], Result]) -> Result:
    """Call a function that asks a store, again where it fails as networks do.

    Raises:
        OSError: it failed each time; at once where it will not mend itself: what is asked for is not there, or must not
            be there, or is forbidden. Errors of the store's own kind become one.
    """
    wait = _FIRST_WAIT
    for left in reversed(range(TRIES)):
        try:
            return function()
        except (FileExistsError, FileNotFoundError, PermissionError, IsADirectoryError, InputError):
            raise
        except Exception as error:  # each kind of store has errors of its own
            if not left and isinstance(error, OSError):
                raise
            if not left:
                raise OSError(f"{type(error).__name__}: {error}") from error
        time.sleep(wait)
        wait *= 2
    raise AssertionError("the last try returns or raises")


def open_bytes(where: str) -> BinaryIO:
    """Open a file or an address for reading. Parts of what lies in a store are read as they are asked for."""
    if not is_address(where):
        return Path(where).open("rb")
    store, path = open_store(where)
    return cast(BinaryIO, patiently(lambda: store.open(path, "rb")))


@dataclass(frozen=True)
class Address:
    """An object of a store, or a file of the web."""

    address: str

    @property
    def name(self) -> str:
        """The address, without the signature of one that was signed: that is a secret, and another each time."""
        path, _, query = self.address.partition("?")
        parameters = [(part, part.partition("=")[0]) for part in query.split("&")]
        names = {name for _, name in parameters}
        if not any(map(_SIGNATURE.fullmatch, names)):
            return self.address
        kinds = (_SIGNATURE, _BESIDE_SIGNATURE, *([_OF_AZURE] if {"sv", "sig"} <= names else []))
        kept = [part for part, name in parameters if not any(kind.fullmatch(name) for kind in kinds)]
        return f"{path}?{'&'.join(kept)}" if kept else path

    def read(self) -> bytes:
        """Return its bytes.

        Raises:
            InputError: it cannot be read, or is larger than any photo.
        """
        store, path = open_store(self.address)
        try:
            return patiently(lambda: self._read(store, path))
        except OSError as error:
            raise InputError(f"cannot be read from its store: {_reason(error)}") from error

    def _read(self, store: Any, path: str) -> bytes:
        with store.open(path, "rb", block_size=1 << 22) as file:
            return _bounded(file.read(MAX_PHOTO + 1))


@dataclass(frozen=True)
class ZipMember:
    """A member of a zip file."""

    archive: str
    member: str

    @property
    def name(self) -> str:
        """The archive and the member."""
        return f"{self.archive}::{self.member}"

    def read(self) -> bytes:
        """Return its bytes.

        Raises:
            InputError: it cannot be read: it is damaged, encrypted, larger than any photo, or would unpack to far more
                than it is large.
        """
        try:
            archive = open_zip(self.archive)
            member = archive.getinfo(self.member)
            check_expansion(member.file_size, member.compress_size)
            with archive.open(member) as file:
                return _bounded(file.read(MAX_PHOTO + 1))
        except InputError:
            raise
        except Exception as error:  # zipfile has errors of several kinds, and RuntimeError for encryption
            raise InputError(f"cannot be read from its archive: {_reason(error)}") from error


@dataclass(frozen=True)
class TarMember:
    """A member of a tar file that is not compressed: a stretch of its bytes."""

    archive: str
    member: str
    first: int
    """The byte of the archive at which it begins."""
    size: int

    @property
    def name(self) -> str:
        """The archive and the member."""
        return f"{self.archive}::{self.member}"

    def read(self) -> bytes:
        """Return its bytes.

        Raises:
            InputError: it cannot be read: the archive is cut, or it is larger than any photo.
        """
        if self.size > MAX_PHOTO:
            raise InputError(f"is larger than {MAX_PHOTO:,} bytes: no photo is as large")
        try:
            with open_bytes(self.archive) as file:
                file.seek(self.first)
                content = file.read(self.size)
        except OSError as error:
            raise InputError(f"cannot be read from its archive: {_reason(error)}") from error
        if len(content) < self.size:
            raise InputError("is cut off: the archive ends before it")
        return content


@dataclass(frozen=True)
class Held:
    """A member of a compressed tar file, with its bytes: such a file can only be read from its beginning to its end."""

    name: str
    content: bytes

    def read(self) -> bytes:
        """Return its bytes."""
        return self.content


@lru_cache(maxsize=8)
def open_zip(archive: str) -> zipfile.ZipFile:
    """Return a zip file, opened once for all threads that read from it.

    Raises:
        OSError: it cannot be opened.
        zipfile.BadZipFile: it is no zip file.
    """
    return zipfile.ZipFile(open_bytes(archive))


def _bounded(content: bytes) -> bytes:
    if len(content) > MAX_PHOTO:
        raise InputError(f"is larger than {MAX_PHOTO:,} bytes: no photo is as large")
    return content


def _reason(error: BaseException) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
