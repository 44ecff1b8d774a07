"""A prefix of a store, to which the files of a job go: s3://bucket/depth."""

import errno
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from zoedepth.batch import Request, files_of
from zoedepth.errors import InputError
from zoedepth.jobs.origins import open_store, patiently
from zoedepth.outputs import sidecar as sidecars
from zoedepth.outputs.ownership import has_own_mark
from zoedepth.photos import Photo

_EXCLUSIVE = {"s3", "s3a", "gs", "gcs"}
"""Stores that can be asked to take a file only if there is none."""

_WHOLE = {*_EXCLUSIVE, "abfs", "abfss", "az", "adl", "oci", "oss", "r2", "memory"}
"""Stores in which a file is there when all of it is, and not before."""

_LATER = "Look after the store, and type the same again"

_HEAD = 1 << 12  # bytes of a file that say whose it is


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
        """See ``destinations.Destination``."""
        return f"{self.address}/{file}"

    def photo(self, path: Path, place: PurePosixPath) -> Photo:
        """See ``destinations.Destination``."""
        return Photo(path, Path(place))

    def blocked(self, photo: Photo, request: Request, *, own: Collection[str] = ()) -> str | None:
        """See ``destinations.Destination``."""
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
        """See ``destinations.Destination``."""
        sidecar = None if self.fresh else self._sidecar(photo.file(sidecars.ENDING))
        return [] if sidecar is None else sorted(sidecars.listed(sidecar) - names)

    @contextmanager
    def drafts(self) -> Iterator[Path]:
        """See ``destinations.Destination``."""
        with TemporaryDirectory(prefix="zoedepth-") as folder:
            yield Path(folder)

    def deliver(self, photo: Photo, drafts: Path, files: Mapping[str, str]) -> dict[str, tuple[str, int]]:
        """See ``destinations.Destination``. A store shows a file when all of it is there."""
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
        """See ``destinations.Destination``."""
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
        """See ``destinations.Destination``. A store that did not take a file after several tries takes no other."""
        return InputError(f"nothing more can be written to {self.address} ({error}). {_LATER}")

    def sidecar(self, outputs: Mapping[str, tuple[str, int]]) -> dict[str, object] | None:
        """See ``destinations.Destination``."""
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
