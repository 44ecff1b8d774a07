"""Where the files of a job go: a folder, or a prefix of a store. Each file gets its name when it is whole."""

import errno
import json
import os
import shutil
import socket
from collections.abc import Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory, mkdtemp
from typing import Protocol

from zoedepth.batch import Photo, Request, blocked, earlier_files, end_of_writing, files_of
from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.jobs.origins import open_store, patiently
from zoedepth.outputs import sidecar as sidecars
from zoedepth.outputs.ownership import has_own_mark

DRAFTS = ".zoedepth-drafts"
"""Beginning of the name of the folder in which files are written before they get their places."""

_EXCLUSIVE = {"s3", "s3a", "gs", "gcs"}
"""Stores that can be asked to take a file only if there is none."""

_WHOLE = {*_EXCLUSIVE, "abfs", "abfss", "az", "adl", "oci", "oss", "r2", "memory"}
"""Stores in which a file is there when all of it is, and not before."""

_LATER = "Look after the store, and type the same again"

_HEAD = 1 << 12  # bytes of a file that say whose it is


class Destination(Protocol):
    """A place for files. Threads may use it at the same time, and other processes a copy of it."""

    @property
    def name(self) -> str:
        """The name of the place, for people."""
        ...

    def where(self, file: str) -> str:
        """Return the path or the address of a file that lies at a path relative to this place."""
        ...

    def photo(self, path: Path, place: PurePosixPath) -> Photo:
        """Return a photo whose files lie at ``place``, the path below this one without an ending."""
        ...

    def blocked(self, photo: Photo, request: Request, *, own: Collection[str] = ()) -> str | None:
        """Return why the files of a photo cannot be written; None: nothing that is not its own would be replaced.

        Args:
            photo: the photo.
            request: the files that would be written.
            own: names of files that the manifest knows to be this photo's.
        """
        ...

    def earlier(self, photo: Photo, names: set[str]) -> list[str]:
        """Return the names of files that earlier runs wrote for a photo, without ``names``."""
        ...

    def drafts(self) -> AbstractContextManager[Path]:
        """Give a folder to write the files of one photo in; what is left in it is gone after."""
        ...

    def deliver(self, photo: Photo, drafts: Path, files: Mapping[str, str]) -> dict[str, tuple[str, int]]:
        """Give files their places, the sidecar last.

        Args:
            photo: the photo.
            drafts: folder that has them.
            files: name of the output → name of the file.

        Returns:
            Name of the output → the file's path relative to this place, and its bytes.

        Raises:
            OSError: they cannot be written.
        """
        ...

    def has(self, outputs: Mapping[str, tuple[str, int]]) -> bool:
        """Return True if all files are there and have their sizes.

        Raises:
            InputError: nobody can tell, because a store does not answer.
        """
        ...

    def sidecar(self, outputs: Mapping[str, tuple[str, int]]) -> dict[str, object] | None:
        """Return the content of the sidecar among files; None where there is none."""
        ...

    def end(self, photo: Photo, error: OSError) -> InputError | None:
        """Return why nothing can be written any more, after an error; None where it is this photo alone that fails."""
        ...


@dataclass(frozen=True)
class LocalFolder:
    """A folder of a file system.

    Args:
        folder: the folder; it is made where it does not exist.
        drafts_of: name of the manifest whose command writes; its drafts have a folder of their own.
    """

    folder: Path
    drafts_of: str

    @property
    def name(self) -> str:
        """The path."""
        return str(self.folder)

    def where(self, file: str) -> str:
        """See ``Destination``."""
        return str(self.folder / file)

    @property
    def _drafts(self) -> Path:
        return self.folder / f"{DRAFTS}-{self.drafts_of}"

    def photo(self, path: Path, place: PurePosixPath) -> Photo:
        """See ``Destination``."""
        return Photo(path, self.folder / place)

    def blocked(self, photo: Photo, request: Request, *, own: Collection[str] = ()) -> str | None:
        """See ``Destination``."""
        return blocked(photo, request, own=own)

    def earlier(self, photo: Photo, names: set[str]) -> list[str]:
        """See ``Destination``."""
        return earlier_files(photo, names)

    @contextmanager
    def drafts(self) -> Iterator[Path]:
        """See ``Destination``. The folder lies in this one, because only there is renaming one step."""
        self._drafts.mkdir(parents=True, exist_ok=True)
        # The machine's name, because a cluster's may share the folder.
        folder = Path(mkdtemp(prefix=f"{socket.gethostname()[:40]}-", dir=self._drafts))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def deliver(self, photo: Photo, drafts: Path, files: Mapping[str, str]) -> dict[str, tuple[str, int]]:
        """See ``Destination``. A kill between two files is mended by ``mend``."""
        photo.target.parent.mkdir(parents=True, exist_ok=True)
        place = photo.target.parent.relative_to(self.folder)
        (drafts / _PLACE).write_text(json.dumps({"place": place.as_posix(), "files": list(files.values())}))
        outputs = {}
        for name, file in files.items():
            n_bytes = (drafts / file).stat().st_size
            _move(drafts / file, photo.target.parent / file)
            outputs[name] = ((place / file).as_posix(), n_bytes)
        return outputs

    def has(self, outputs: Mapping[str, tuple[str, int]]) -> bool:
        """See ``Destination``."""
        root = f"{self.folder}{os.sep}"
        try:
            return all(os.stat(root + file).st_size == n_bytes for file, n_bytes in outputs.values())
        except OSError:
            return False

    def sidecar(self, outputs: Mapping[str, tuple[str, int]]) -> dict[str, object] | None:
        """See ``Destination``."""
        return sidecars.read_sidecar(self.folder / outputs["sidecar"][0]) if "sidecar" in outputs else None

    def end(self, photo: Photo, error: OSError) -> InputError | None:
        """See ``Destination``."""
        return end_of_writing(photo, error)

    def mend(self) -> None:
        """Take away the drafts of a command that was killed. Files that were about to get their places get them.

        The lock of the manifest must be held.
        """
        for folder in self._drafts.iterdir() if self._drafts.is_dir() else ():
            if (folder / _PLACE).is_file():
                _finish(folder, self.folder)
            shutil.rmtree(folder, ignore_errors=True)
        self.tidy()

    def tidy(self) -> None:
        """Remove the folder of the drafts, which is empty after a command."""
        with suppress(OSError):  # it is not there, or an actor of a command that was killed has not noticed that yet
            self._drafts.rmdir()


_PLACE = "place"
"""File among the drafts of a photo, written when all are whole: where they go."""


def _finish(drafts: Path, folder: Path) -> None:
    """Give the files of a photo the places that some of them have already."""
    try:
        plan = json.loads((drafts / _PLACE).read_text())
        place, files = PurePosixPath(plan["place"]), [PurePosixPath(file).name for file in plan["files"]]
    except (OSError, ValueError, KeyError, TypeError):
        return  # cut while it was written: no file has got its place
    if place.is_absolute() or ".." in place.parts:
        return
    for file in files:
        if (drafts / file).is_file():
            _move(drafts / file, folder / place / file)


def _move(file: Path, place: Path) -> None:
    """Rename a file; copy it where a folder of the tree lies on another disk, by a link or as a mount."""
    try:
        file.replace(place)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        with atomic_path(place) as temporary:
            shutil.copyfile(file, temporary)


@dataclass(frozen=True)
class Store:
    """A prefix of a store that fsspec knows: s3://bucket/depth.

    Args:
        address: the prefix.
        fresh: nothing was there when the job began, so that nothing can be replaced.
    """

    address: str
    fresh: bool = False

    @property
    def name(self) -> str:
        """The address."""
        return self.address

    def where(self, file: str) -> str:
        """See ``Destination``."""
        return f"{self.address}/{file}"

    def photo(self, path: Path, place: PurePosixPath) -> Photo:
        """See ``Destination``."""
        return Photo(path, Path(place))

    def blocked(self, photo: Photo, request: Request, *, own: Collection[str] = ()) -> str | None:
        """See ``Destination``."""
        if self.fresh:
            return None
        sidecar = self._sidecar(photo.file(sidecars.ENDING))
        where = f"{self.address}/{photo.file(sidecars.ENDING).as_posix()}"
        if sidecar is not None and not sidecars.of_same_photo(sidecar, Path(photo.name)):
            return f"{where} is of {sidecar['source']}, another photo: choose another --out"
        known = set(own) | (set() if sidecar is None else sidecars.listed(sidecar))
        for kind, file in files_of(photo, request).items():
            if file.name in known or (kind == "sidecar" and sidecar is not None):
                continue
            head = self._read(file, first=_HEAD)
            if head is not None and not _is_own(head):
                return (
                    f"{self.address}/{file.as_posix()} is not from zoedepth and would be replaced: choose another --out"
                )
        return None

    def earlier(self, photo: Photo, names: set[str]) -> list[str]:
        """See ``Destination``."""
        sidecar = None if self.fresh else self._sidecar(photo.file(sidecars.ENDING))
        return [] if sidecar is None else sorted(sidecars.listed(sidecar) - names)

    @contextmanager
    def drafts(self) -> Iterator[Path]:
        """See ``Destination``."""
        with TemporaryDirectory(prefix="zoedepth-") as folder:
            yield Path(folder)

    def deliver(self, photo: Photo, drafts: Path, files: Mapping[str, str]) -> dict[str, tuple[str, int]]:
        """See ``Destination``. A store shows a file when all of it is there."""
        outputs = {}
        for name, file in files.items():
            relative = (photo.target.parent / file).as_posix()
            self.put(drafts / file, relative)
            outputs[name] = (relative, (drafts / file).stat().st_size)
        return outputs

    def put(self, file: Path, relative: str, *, replace: bool = True) -> None:
        """Bring a file to its place, whole or not at all.

        Args:
            file: the file.
            relative: its place.
            replace: False makes it an error if a file is there already. Amazon's and Google's stores look and write in
                one step; with others, two commands may do so at the same moment.

        Raises:
            OSError: it cannot be written.
        """
        store, root = open_store(self.address)
        path = f"{root.rstrip('/')}/{relative}"
        protocols = _protocols(store)

        def put() -> None:
            if not replace and protocols & _EXCLUSIVE:
                store.put_file(str(file), path, mode="create")
                return
            if not replace and store.exists(path):
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), path)
            if protocols & _WHOLE:
                store.put_file(str(file), path)
                return
            store.makedirs(path.rpartition("/")[0], exist_ok=True)
            store.put_file(str(file), f"{path}.part")  # servers of files show what has come so far
            store.mv(f"{path}.part", path)

        patiently(put)

    def has(self, outputs: Mapping[str, tuple[str, int]]) -> bool:
        """See ``Destination``."""
        store, root = open_store(self.address)

        def size(relative: str) -> int:
            return patiently(lambda: store.info(f"{root.rstrip('/')}/{relative}"))["size"]

        try:
            return all(size(file) == n_bytes for file, n_bytes in outputs.values())
        except FileNotFoundError:
            return False
        except OSError as error:
            raise InputError(f"{self.address} does not answer ({error}). {_LATER}") from error

    def end(self, photo: Photo, error: OSError) -> InputError | None:
        """See ``Destination``. A store that did not take a file after several tries takes no other."""
        return InputError(f"nothing more can be written to {self.address} ({error}). {_LATER}")

    def sidecar(self, outputs: Mapping[str, tuple[str, int]]) -> dict[str, object] | None:
        """See ``Destination``."""
        return self._sidecar(Path(outputs["sidecar"][0])) if "sidecar" in outputs else None

    def content(self, relative: str) -> bytes | None:
        """Return the bytes of a file; None where there is none."""
        return self._read(Path(relative), first=-1)

    def _sidecar(self, file: Path) -> dict[str, object] | None:
        content = self._read(file, first=sidecars.MAX_BYTES + 1)
        return None if content is None else sidecars.parse_sidecar(content)

    def _read(self, file: Path, *, first: int) -> bytes | None:
        """Return the beginning of a file, all of it for -1; None where there is none."""
        store, root = open_store(self.address)

        def read() -> bytes:
            with store.open(f"{root.rstrip('/')}/{file.as_posix()}", "rb", block_size=1 << 16) as opened:
                return opened.read(first)

        try:
            return patiently(read)
        except FileNotFoundError:
            return None


def _protocols(store: object) -> set[str]:
    protocol = getattr(store, "protocol", ())
    return {protocol} if isinstance(protocol, str) else set(protocol)


def _is_own(head: bytes) -> bool:
    with TemporaryDirectory() as folder:
        file = Path(folder, "head")
        file.write_bytes(head)
        return has_own_mark(file)
