"""Where the files of a job go: a folder, or a store (``store``). Each file gets its name when it is whole."""

import errno
import json
import os
import shutil
import socket
from collections.abc import Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import mkdtemp
from typing import Protocol

from zoedepth.batch import Request, blocked, earlier_files, end_of_writing
from zoedepth.errors import InputError
from zoedepth.images import atomic_path
from zoedepth.outputs import sidecar as sidecars
from zoedepth.photos import Photo
from zoedepth.stored import unreadable

DRAFTS = ".zoedepth-drafts"
"""Beginning of the name of the folder in which files are written before they get their places."""


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

        def size(file: str) -> int:
            try:
                return os.stat(root + file).st_size
            except FileNotFoundError:
                if "\\x" not in file:
                    raise
                return os.stat(root + unreadable(file)).st_size  # the manifest spells out what is not UTF-8

        try:
            return all(size(file) == n_bytes for file, n_bytes in outputs.values())
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
