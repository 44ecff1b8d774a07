"""The function that every engine maps: an input in, its files written, and a line for the manifest out."""

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from zoedepth.batch import NamedBytes, Outcome, Request, files_of, predict_maps, write_drafts
from zoedepth.errors import InputError, ZoeDepthError
from zoedepth.jobs.destinations import Destination
from zoedepth.jobs.manifest import Entry
from zoedepth.outputs.sidecar import ENDING
from zoedepth.photos import Origin, Photo
from zoedepth.predict import Predictor


@dataclass(frozen=True)
class Input:
    """A photo of a job."""

    name: str
    """The name by which the manifest knows it: an absolute path, an address, or archive::member."""
    place: PurePosixPath
    """Its place in the tree of all inputs; its shard depends on it."""
    target: PurePosixPath
    """The place of its files, without their endings."""
    path: Path
    """The path as it was given, of a photo that is a file."""
    origin: Origin | None = None
    """The place of a photo that is no file."""
    size: int | None = None
    """Bytes of a photo that is no file; None where its store does not say it."""
    version: int | str | None = None
    """A value that changes with the content of a photo that is no file; None where its store has none."""
    own: tuple[str, ...] = ()
    """Names of files that the manifest knows to be this photo's, from an earlier command."""
    rival: str | None = None
    """The name of another photo, which is still there, whose files the manifest knows to lie in the place of this
    one's."""

    def opened(self) -> Path | NamedBytes:
        """Return the photo for a reader: its path, or all of its bytes.

        Raises:
            InputError: it is no file, and cannot be read; the message names it.
        """
        if self.origin is None:
            return self.path
        try:
            return NamedBytes(self.origin.read(), self.name)
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from error

    def state(self) -> tuple[int | None, int | str | None]:
        """Return bytes and version: of a file its size and the time of its last change, as they are now."""
        if self.origin is not None:
            return self.size, self.version
        try:
            found = os.stat(self.path)
        except (OSError, ValueError):  # ValueError: the name has a zero byte
            return None, None
        return found.st_size, found.st_mtime_ns


@dataclass(frozen=True)
class Done:
    """The result for one input."""

    name: str
    """The photo, as people know it."""
    entry: Entry
    """The line for the manifest."""
    sidecar: Mapping[str, object] = field(default_factory=dict)
    """The content of the sidecar; empty after a failure."""
    notes: tuple[str, ...] = ()
    """Sentences for the user, see ``outputs.Written``."""
    before: bool = False
    """True if an earlier command has done it."""
    end: str | None = None
    """The reason why nothing can be written any more; None where other inputs may go well."""


def do_photo(photo: Input, predictor: Predictor, request: Request, destination: Destination) -> Done:
    """Predict one photo and write its files: all of them, or none.

    Whatever goes wrong is in the result.
    """
    started = time.perf_counter()
    asked = destination.photo(photo.path, photo.target)
    asked = Photo(asked.path, asked.target, photo.origin)
    size, version = photo.state()
    end: InputError | None = None
    try:
        drafted, outputs = _written(photo, asked, (size, version), predictor, request, destination)
    except ZoeDepthError as error:
        problem = str(error)
    except OSError as error:  # reading it has errors of its own
        end = destination.end(asked, error)
        problem = f"its files cannot be written ({error.strerror or error})"
    except Exception as error:  # out of memory: the rest of ten thousand may still go well
        problem = f"{type(error).__name__}: {error}"
    else:
        entry = Entry(photo.name, "done", size, version, outputs, time.perf_counter() - started)
        return Done(asked.name, entry, drafted.sidecar, drafted.notes)
    entry = Entry(photo.name, "failed", size, version, {}, time.perf_counter() - started, problem)
    return Done(asked.name, entry, end=None if end is None else str(end))


def _written(
    photo: Input,
    asked: Photo,
    state: tuple[int | None, int | str | None],
    predictor: Predictor,
    request: Request,
    destination: Destination,
) -> tuple[Outcome, dict[str, tuple[str, int]]]:
    if photo.rival is not None:
        sidecar = destination.where(f"{photo.target}{ENDING}")
        raise InputError(f"{sidecar} is of {photo.rival}, another photo: choose another --out")
    if reason := destination.blocked(asked, request, own=photo.own):
        raise InputError(reason)
    maps = predict_maps(asked, predictor, request)
    if photo.state() != state:
        raise InputError(
            "it changed while it was read: it is still being written. Type the same again when it is whole"
        )
    with destination.drafts() as folder:
        names = {file.name for file in files_of(asked, request).values()}
        drafted = write_drafts(asked, maps, request, folder, earlier=destination.earlier(asked, names))
        files = {name: file.name for name, file in drafted.files.items()}
        return drafted, destination.deliver(asked, folder, files)
