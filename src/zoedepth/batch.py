"""Many photos: find them, predict each from file to files, and say which failed.

No console and no options of a command line: a service, a cluster and `zoedepth predict` all use this.

    found = find_photos(["photos/"], Path("depth"))
    for outcome in predict_all(found.photos, predictor, Request(model="zoed-lite"), workers=4):
        print(outcome.photo.path, outcome.failure or outcome.sidecar["depth"])
"""

import glob
import os
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from zoedepth import __version__
from zoedepth.errors import InputError, ZoeDepthError
from zoedepth.images import IMAGE_SUFFIXES, read_image
from zoedepth.outputs import OUTPUTS, Maps, Options
from zoedepth.outputs import sidecar as sidecars

if TYPE_CHECKING:
    from zoedepth.predict import Predictor


@dataclass(frozen=True)
class Photo:
    """A photo to predict, and where its files go."""

    path: Path
    target: Path
    """The path of its files without their endings: <out>/<folder>/<name>."""

    def file(self, ending: str) -> Path:
        """Return the path of the file with this ending, e.g. "_depth.png"."""
        return self.target.with_name(self.target.name + ending)


@dataclass
class Found:
    """The photos that the sources named, and what else was there."""

    photos: list[Photo] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    """One message for each source or folder that could not be read."""
    n_ignored: int = 0
    """Files in folders and globs that are no photos by their suffix, are hidden, or were written by an earlier run."""


@dataclass(frozen=True)
class Request:
    """The files to make of every photo, and how.

    Raises:
        InputError: an output is unknown or cannot be made, or an option needs metres where there are none.
    """

    model: str
    """The model's name for the sidecar."""
    outputs: tuple[str, ...] | None = None
    """Names in ``OUTPUTS``; a sidecar is always written. None: the depth (or relative depth) and its preview."""
    options: Options = field(default_factory=Options)
    """How the files are written."""
    domain: str | None = None
    """Scene type whose head to use; None leaves it to the model's router."""
    relative: bool = False
    """True predicts relative depth instead of metres."""

    def __post_init__(self) -> None:
        options = self.options
        given = {"domain": self.domain, "png_scale": options.png_scale, "vmin": options.vmin, "vmax": options.vmax}
        metric = [name for name, value in given.items() if value is not None]
        if self.relative and metric:
            raise InputError(f"relative depth has no metres: leave out {', '.join(metric)}")
        for name in self.names:
            if name not in OUTPUTS:
                raise InputError(f"there is no output {name!r}: use one of {', '.join(OUTPUTS)}")
            if self.map not in OUTPUTS[name].maps:
                found = "relative depth" if self.relative else "depth in metres"
                fitting = [known for known, output in OUTPUTS.items() if self.map in output.maps]
                raise InputError(f"{name!r} cannot be written from {found}: use one of {', '.join(fitting)}")

    @property
    def map(self) -> str:
        """The map that is predicted: "depth" or "relative"."""
        return "relative" if self.relative else "depth"

    @property
    def names(self) -> tuple[str, ...]:
        """Names in ``OUTPUTS`` of the files that are written."""
        return (self.map, "preview") if self.outputs is None else self.outputs


@dataclass(frozen=True)
class Outcome:
    """The result for one photo: files and their sidecar, or a failure."""

    photo: Photo
    sidecar: Mapping[str, object] = field(default_factory=dict)
    """The content of the sidecar; empty after a failure."""
    notes: tuple[str, ...] = ()
    """Sentences for the user about the files, see ``Written``."""
    failure: str | None = None
    """The path of the photo and the error; None where all is well."""


def find_photos(sources: Iterable[str], out: Path) -> Found:
    """Find the photos named by files, folders and globs: each once, each with files of its own.

    A photo's files are <out>/<its folder below the source>/<stem>. With several folders each keeps its own name in the
    tree. Photos that would share files (a.jpg and a.png) take their whole name (a.jpg, a.png), then a number.

    Args:
        sources: photos, folders (searched with their subfolders) and globs ("photos/**/*.jpg").
        out: the folder that the files go to. It need not exist.
    """
    sources, found = list(sources), Found()
    several_folders = sum(Path(source).is_dir() for source in sources) > 1
    places: dict[str, tuple[Path, Path]] = {}  # absolute path -> the photo and its place in the tree

    def add(path: Path, place: Path) -> None:
        places.setdefault(os.path.abspath(path), (path, place))

    for source in sources:
        path = Path(source)
        if path.is_dir():
            files, root = list(_walk(path, found)), path
            above = path.resolve().name if several_folders else ""
        elif path.exists():
            add(path, Path(path.name))  # named one by one: tried whatever its suffix
            continue
        elif glob.has_magic(source):
            matches = [Path(match) for match in sorted(glob.glob(source, recursive=True))]
            files, root, above = [match for match in matches if match.is_file()], _fixed_part(source), ""
            if not files:
                found.failures.append(f"{source}: matches no file")
        else:
            found.failures.append(f"{source}: no such file or folder")
            continue
        for file in files:
            if file.suffix.lower() in IMAGE_SUFFIXES and not _is_own_output(file, out):
                add(file, above / file.relative_to(root))
            else:
                found.n_ignored += 1
    found.photos = _with_targets(list(places.values()), out)
    return found


def predict_photo(photo: Photo, predictor: "Predictor", request: Request) -> Outcome:
    """Predict one photo and write its files, the sidecar last: where it is, the other files are complete.

    Raises:
        InputError: the photo cannot be read or predicted.
        OSError: a file cannot be written.
    """
    started = time.perf_counter()
    if request.relative:
        image = read_image(photo.path)
        maps = Maps(relative=predictor.relative(image), image=image)
        origin: dict[str, object] = {"input_size": image.shape[:2]}
    else:
        result = predictor(photo.path, domain=request.domain)
        maps = result.maps
        origin = {
            "config_size": predictor.model.config.size,
            "input_size": result.size,
            "network_size": result.network_size,
            "domain": result.domain,
            "domain_probability": sidecars.rounded(result.domain_probability),
        }
    seconds = time.perf_counter() - started
    written = {name: OUTPUTS[name].write(photo.file(OUTPUTS[name].ending), maps, request.options)
               for name in request.names}  # fmt: skip
    sidecar = {
        **sidecars.describe(
            maps,
            origin={"source": str(photo.path), "model": request.model, **origin},
            facts={key: value for output in written.values() for key, value in output.facts.items()},
            files={name: photo.file(OUTPUTS[name].ending).name for name in written},
        ),
        "zoedepth": __version__,
        "seconds": round(seconds, 3),
    }
    sidecars.write_sidecar(photo.file(sidecars.ENDING), sidecar)
    return Outcome(photo, sidecar, tuple(note for output in written.values() for note in output.notes))


def predict_all(
    photos: Sequence[Photo], predictor: "Predictor", request: Request, *, workers: int = 1
) -> Iterator[Outcome]:
    """Predict ``workers`` photos at a time, and yield their outcomes in the order of the photos.

    A photo that fails does not stop the others. When the work is interrupted or the iterator is closed, photos that
    have begun are finished, so that no file is left half written; after a KeyboardInterrupt those are still yielded
    before it goes on.

    Args:
        photos: photos whose files do not clash, from ``find_photos``.
        predictor: used by all workers at the same time.
        request: the files to make of each photo.
        workers: photos computed at the same time, each in a thread. See ``share_cores``.
    """
    inputs = {os.path.abspath(photo.path) for photo in photos}
    endings = [*(OUTPUTS[name].ending for name in request.names), sidecars.ENDING]

    def predict_one(photo: Photo) -> Outcome:
        try:
            files = [photo.file(ending) for ending in endings]
            if clash := [file.name for file in files if os.path.abspath(file) in inputs]:
                raise InputError(f"its {clash[0]} would overwrite another photo, choose another folder to write to")
            return predict_photo(photo, predictor, request)
        except ZoeDepthError as error:
            return Outcome(photo, failure=f"{photo.path}: {error}")
        except Exception as error:  # disk full, out of memory: the rest of ten thousand may still go well
            return Outcome(photo, failure=f"{photo.path}: {type(error).__name__}: {error}")

    executor = ThreadPoolExecutor(workers)
    waiting: deque[Future[Outcome]] = deque()
    try:
        waiting.extend(executor.submit(predict_one, photo) for photo in photos)
        while waiting:
            outcome = waiting[0].result()
            waiting.popleft()
            yield outcome
    except KeyboardInterrupt:
        executor.shutdown(cancel_futures=True)
        yield from (done.result() for done in waiting if not done.cancelled() and done.exception() is None)
        raise
    finally:
        executor.shutdown(cancel_futures=True)


@contextmanager
def share_cores(workers: int) -> Iterator[None]:
    """Give each of ``workers`` forwards that run at the same time its share of the cores, until the block ends.

    A model in OpenVINO's or ONNX's format takes its number of threads when it is loaded: load it inside.
    """
    import torch

    threads = torch.get_num_threads()
    if workers > 1:
        # A core for each photo: the threads of one forward wait for each other all the time.
        torch.set_num_threads(max(1, cpu_count() // workers))
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def cpu_count() -> int:
    """Return the number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _walk(folder: Path, found: Found) -> Iterator[Path]:
    """Yield the files below a folder in a fixed order, without hidden ones (".cache", macOS's "._photo.jpg")."""

    def unreadable(error: OSError) -> None:
        found.failures.append(f"{error.filename}: {error.strerror}")

    for where, folders, files in os.walk(folder, onerror=unreadable):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        found.n_ignored += sum(name.startswith(".") for name in files)
        yield from (Path(where, name) for name in sorted(files) if not name.startswith("."))


def _fixed_part(pattern: str) -> Path:
    """Return the folders of a glob before its first wildcard."""
    parts = Path(pattern).parts
    n_fixed = next(i for i, part in enumerate(parts) if glob.has_magic(part))
    return Path(*parts[:n_fixed])


def _is_own_output(file: Path, out: Path) -> bool:
    """Return True if an earlier run wrote the file, which matters when photos are searched where depth is written."""
    for output in OUTPUTS.values():
        if file.name.endswith(output.ending) and out.resolve() in file.resolve().parents:
            return file.with_name(file.name.removesuffix(output.ending) + sidecars.ENDING).exists()
    return False


def _with_targets(photos: list[tuple[Path, Path]], out: Path) -> list[Photo]:
    """Give each photo, with its place in the tree, a target that no other has."""

    def key(place: Path) -> str:
        return str(place).casefold()  # a.jpg and A.png share their files on Windows and macOS

    n_sharing = Counter(key(place.with_suffix("")) for _, place in photos)
    taken: set[str] = set()

    def names(place: Path) -> Iterator[Path]:
        if n_sharing[key(place.with_suffix(""))] == 1:
            yield place.with_suffix("")
        yield place
        yield from (place.with_name(f"{place.name}-{number}") for number in count(2))

    targets = []
    for path, place in photos:
        name = next(name for name in names(place) if key(name) not in taken)
        taken.add(key(name))
        targets.append(Photo(path, out / name))
    return targets
