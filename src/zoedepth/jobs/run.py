"""A job in this process: what is missing or failed is done, several inputs at a time."""

import filecmp
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

from zoedepth.batch import Request, in_turn
from zoedepth.errors import InputError
from zoedepth.jobs.destinations import Destination, LocalFolder
from zoedepth.jobs.manifest import Manifest
from zoedepth.jobs.origins import Held
from zoedepth.jobs.work import Done, Input, do_photo
from zoedepth.outputs.sidecar import ENDING
from zoedepth.predict import Predictor
from zoedepth.stored import readable, unreadable


@dataclass
class Tally:
    """Numbers of inputs, for a progress line. Another thread may read them."""

    done: int = 0
    """Inputs that this command has done."""
    failed: int = 0
    """Inputs that have failed in this command."""
    before: int = 0
    """Inputs that an earlier command has done."""
    total: int | None = None
    """Inputs of this command or shard; None as long as it is not known."""

    @property
    def seen(self) -> int:
        """All inputs that need nothing more."""
        return self.done + self.failed + self.before

    def count(self, done: Done) -> None:
        """Count a result."""
        if done.before:
            self.before += 1
        elif done.entry.status == "done":
            self.done += 1
        else:
            self.failed += 1


def run_job(
    inputs: Iterable[Input],
    predictor: Predictor,
    request: Request,
    *,
    manifest: Manifest,
    destination: Destination,
    workers: int,
    tally: Tally,
    overwrite: bool = False,
    tell_done: bool = False,
) -> Iterator[Done]:
    """Do those inputs that are not done yet, and yield the results in the order of the inputs.

    Each result is in the manifest before it is yielded. When the job is interrupted, inputs that have begun are
    finished.

    Args:
        inputs: photos, each once; they are asked for as they are needed.
        predictor: used by all workers at the same time.
        request: the files to make of each photo.
        manifest: the manifest, for which ``Manifest.begin`` was called.
        destination: where the files go.
        workers: photos computed at the same time, each in a thread.
        tally: counts the inputs.
        overwrite: do those again that are done.
        tell_done: yield a result for those, too, that an earlier command has done.

    Raises:
        InputError: nothing can be written any more: the disk is full, or gone, or another command has begun on the same
            manifest in a store.
    """
    ends: list[InputError] = []

    def work(item: Input | Done) -> Done:
        if isinstance(item, Done):
            return item
        done = do_photo(item, predictor, request, destination)
        if done.end is not None:
            ends.append(InputError(done.end))
            return done
        try:
            with writing(manifest):
                manifest.add(done.entry)
        except InputError as error:
            ends.append(error)
        return done

    to_do = missing(inputs, manifest, destination, tally, overwrite=overwrite, tell_done=tell_done)
    for done in in_turn(work, to_do, workers=workers, held=_held, stop=lambda: ends[0] if ends else None):
        tally.count(done)
        yield done
    with writing(manifest):
        manifest.flush()


def _held(item: Input | Done) -> int:
    """Return the bytes that an input holds."""
    return len(item.origin.content) if isinstance(item, Input) and isinstance(item.origin, Held) else 0


@contextmanager
def writing(manifest: Manifest) -> Iterator[None]:
    """Name the manifest where it cannot be written.

    Raises:
        InputError: it cannot be written: the disk is full, or gone, or another command has begun on it.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"the manifest {manifest.name} cannot be written ({error.strerror or error})") from error


def missing(
    inputs: Iterable[Input],
    manifest: Manifest,
    destination: Destination,
    tally: Tally,
    *,
    overwrite: bool = False,
    tell_done: bool = False,
) -> Iterator[Input | Done]:
    """Yield the inputs that are not done: new ones, failed ones, those that changed, and those whose files are gone.

    See ``run_job`` for the arguments. With ``tell_done`` there is a ``Done`` in the place of each that is done;
    otherwise they are counted here.
    """
    for item in inputs:
        entry = None if overwrite else manifest.find(item.name)
        if entry is None:
            yield replace(item, rival=_rival(item, manifest, destination))
        elif item.state() != (entry.size, entry.version) or not destination.has(entry.outputs):
            own = tuple(PurePosixPath(file).name for file, _ in entry.outputs.values())
            yield replace(item, own=own, rival=_rival(item, manifest, destination))
        elif tell_done:
            yield Done(item.name if item.origin else str(item.path), entry, before=True)
        else:
            tally.before += 1


def _rival(item: Input, manifest: Manifest, destination: Destination) -> str | None:
    """Return the photo whose files lie where those of an input go, if it is still there and another one.

    So two photos of one relative path, each typed in a folder of its own, do not replace each other's depth. A photo
    that is gone may have been moved to the input's place, and one with the same bytes was copied. Stores are not asked.
    """
    sidecar = f"{item.target}{ENDING}"
    if not isinstance(destination, LocalFolder) or not os.path.lexists(destination.where(sidecar)):
        return None
    other = manifest.input_of(readable(sidecar))
    if other is None or other == readable(item.name):
        return None
    path = unreadable(other)
    if not os.path.exists(path.partition("::")[0]) or _equal(path, item.name):
        return None
    return other


def _equal(one: str, other: str) -> bool:
    """Return True for two files with the same bytes."""
    try:
        return filecmp.cmp(one, other, shallow=False)
    except OSError:
        return False


def count_in_background(tally: Tally, count: Callable[[], Iterable[object]]) -> threading.Thread:
    """Count inputs in a thread of its own, for ``Tally.total``; it ends with the process at the latest.

    Args:
        tally: gets the number when all are counted.
        count: lists the inputs a second time.
    """

    def work() -> None:
        try:
            tally.total = sum(1 for _ in count())
        except Exception:  # the job itself meets it, and says it
            return

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread
