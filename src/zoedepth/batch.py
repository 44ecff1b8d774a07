"""Many photos: find them, predict each from file to files, and say which failed.

No console and no options of a command line: a service, a cluster and `zoedepth predict` all use this.

    found = find_photos(["photos/"], Path("depth"))
    for outcome in predict_all(found.photos, predictor, Request(model="zoed-lite"), workers=4):
        print(outcome.photo.path, outcome.failure or outcome.sidecar["depth"])
"""

import errno
import glob
import os
import time
import unicodedata
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from functools import cache
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from zoedepth import __version__
from zoedepth.calibration import Calibration
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError, ZoeDepthError
from zoedepth.folders import Listing, check_writable, list_files, service_folder
from zoedepth.images import IMAGE_SUFFIXES, read_image
from zoedepth.outputs import OUTPUTS, Maps, Options, output_names
from zoedepth.outputs import sidecar as sidecars
from zoedepth.outputs.ownership import is_own_file
from zoedepth.panorama import is_sphere, predict_panorama

if TYPE_CHECKING:
    from zoedepth.predict import Predictor


_OTHER_PICTURES = {
    suffix: advice
    for advice, suffixes in (
        ("which phones write: pip install 'zoedepth[heic]', or save them as JPEG", ".heic .heif .hif .heics"),
        ("which are raw: develop them to JPEG or TIFF, e.g. with darktable",
         ".dng .cr2 .cr3 .crw .nef .nrw .arw .sr2 .raf .orf .rw2 .pef .srw .raw .rwl .3fr .iiq .x3f .gpr"),
        ("which are JPEG XL: save them as JPEG", ".jxl"),
        ("which are films: take pictures out of them first, e.g. ffmpeg -i FILM frames/%05d.png",
         ".mp4 .mov .avi .mkv .m4v .mts .m2ts .webm .insv .insp .360"),
        ("which are documents: save their pictures as JPEG or PNG", ".psd .pdf .svg .xcf .ai"),
        ("which have a wide range of light: save them as JPEG or PNG", ".exr .hdr .pfm"),
        ("which are archives: unpack them first", ".zip .tar .tgz .gz .7z .rar"),
    )
    for suffix in suffixes.split()
}  # fmt: skip
"""Suffix (lower case) of files that somebody may take for photos → what they are, and what to do."""

_UNKNOWN_CAMERA = (
    "without a known camera: that of the training photos was assumed, and depth was not corrected by the focal length. "
    "Say the field of view (--fov-x, --fov-diagonal) or the camera (--camera FILE)"
)

_NOT_CALIBRATED = (
    "a calibration is of photos of one camera, and a panorama looks everywhere and has none: leave the calibration out"
)

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)


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
    unreadable: dict[str, str] = field(default_factory=dict)
    """Source or folder that could not be read → why."""
    left_out: Counter[str] = field(default_factory=Counter)
    """Reason why files of folders and globs were left out, e.g. "hidden" → how many."""

    @property
    def failures(self) -> list[str]:
        """One message for each source or folder that could not be read."""
        return [f"{path}: {reason}" for path, reason in self.unreadable.items()]

    @property
    def n_ignored(self) -> int:
        """Everything that was left out of folders and globs."""
        return self.left_out.total()


@dataclass(frozen=True)
class Request:
    """The files to make of every photo, and how.

    Raises:
        InputError: an output is unknown or cannot be made, or an option needs metres where there are none.
    """

    model: str
    """The model's name for the sidecar."""
    outputs: tuple[str, ...] | None = None
    """Names in ``OUTPUTS``, or suffixes (``output_names``); a sidecar is always written. None: the depth (or relative
    depth) and its preview."""
    options: Options = field(default_factory=Options)
    """How the files are written."""
    domain: str | None = None
    """Scene type whose head to use; None leaves it to the model's router."""
    relative: bool = False
    """True predicts relative depth instead of metres."""
    calibration: Calibration | None = None
    """The calibration by which metres are put right; photos that it does not hold for fail."""
    panorama: bool = False
    """True takes all photos for panoramas of 360 x 180 degrees. Those that say so in their XMP are found anyway."""

    def __post_init__(self) -> None:
        options = self.options
        given = {
            "domain": self.domain,
            "png_scale": options.png_scale,
            "vmin": options.vmin,
            "vmax": options.vmax,
            "calibration": self.calibration,
        }
        metric = [name for name, value in given.items() if value is not None]
        if self.relative and metric:
            raise InputError(f"relative depth has no metres: leave out {', '.join(metric)}")
        if self.relative and self.panorama:
            raise InputError(
                "the parts of a panorama are joined by their metres, and relative depth has none: take a model of "
                "metres, without --relative"
            )
        if self.calibration is not None and self.panorama:
            raise InputError(_NOT_CALIBRATED)
        for name in self.names:
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
        return (self.map, "preview") if self.outputs is None else output_names(self.outputs, map=self.map)


@dataclass(frozen=True)
class Outcome:
    """The result for one photo: files and their sidecar, or a failure."""

    photo: Photo
    sidecar: Mapping[str, object] = field(default_factory=dict)
    """The content of the sidecar; empty after a failure."""
    files: Mapping[str, Path] = field(default_factory=dict)
    """Name of the output, or "sidecar" → the file that was written."""
    notes: tuple[str, ...] = ()
    """Sentences for the user about the files, see ``Written``."""
    failure: str | None = None
    """The path of the photo and the error; None where all is well."""


def find_photos(sources: Iterable[str], out: Path) -> Found:
    """Find the photos named by files, folders and globs: each once, each with files of its own.

    A photo's files are <out>/<its folder below the source>/<stem>. With several folders each keeps its own name in the
    tree. Photos that would share files (a.jpg and a.png) take their whole name (a.jpg, a.png), then a number.

    Links to folders are followed (see ``folders.list_files``). Files that this package wrote are no photos, wherever
    they lie, and neither are the thumbnails that other programs keep. A file that is named itself is always tried.

    Args:
        sources: photos, folders (searched with their subfolders) and globs ("photos/**/*.jpg").
        out: the folder that the files go to. It need not exist.
    """
    sources, found = list(sources), Found()
    several_folders = sum(Path(source).is_dir() for source in sources) > 1
    places: dict[str, tuple[Path, Path]] = {}  # where a photo really is -> its path and its place in the tree
    real_folder = cache(os.path.realpath)

    def add(path: Path, place: Path) -> None:
        places.setdefault(os.path.join(real_folder(path.parent), path.name), (path, place))

    for source in sources:
        path = Path(source)
        if path.is_dir():
            listing, root = list_files(path), path
            above = path.resolve().name if several_folders else ""
        elif os.path.lexists(path):
            add(path, Path(path.name))  # named one by one: tried whatever its suffix
            continue
        elif glob.has_magic(source):
            root, above = _fixed_part(source), ""
            listing = _matching(source, root)
            if not listing.files:
                found.unreadable[source] = "matches no file"
        else:
            found.unreadable[source] = "no such file or folder"
            continue
        found.unreadable.update(listing.unreadable)
        found.left_out.update(listing.left_out)
        for file in listing.files:
            if reason := _no_photo(file):
                found.left_out[reason] += 1
            elif not file.suffix and file.is_symlink() and not file.exists():
                found.unreadable[str(file)] = "the link leads nowhere: is the disk there?"
            elif file.suffix.lower() in IMAGE_SUFFIXES:
                add(file, above / file.relative_to(root))
    found.photos = _with_targets(list(places.values()), out)
    return found


def blocked(photo: Photo, request: Request) -> str | None:
    """Return why the files of a photo cannot be written: another program's, or another photo's, would be replaced.

    None: nothing is there, or what this package wrote for this photo before.
    """
    sidecar = sidecars.read_sidecar(photo.file(sidecars.ENDING))
    if sidecar is not None and not sidecars.of_same_photo(sidecar, photo.path):
        return f"{photo.file(sidecars.ENDING)} is of {sidecar['source']}, another photo: choose another folder"
    for file in _files(photo, request).values():
        if os.path.lexists(file) and not is_own_file(file):
            return f"{file} is not from zoedepth and would be replaced: choose another folder, or move it"
    return None


def predict_photo(photo: Photo, predictor: "Predictor", request: Request) -> Outcome:
    """Predict one photo and write its files: all of them, or none.

    Raises:
        InputError: the photo cannot be read or predicted, or a file that is not its own would be replaced.
        OSError: a file cannot be written.
    """
    if reason := blocked(photo, request):
        raise InputError(reason)
    started = time.perf_counter()
    notes: tuple[str, ...] = ()
    if request.relative:
        image = read_image(photo.path)
        maps = Maps(relative=predictor.relative(image), image=image)
        origin: dict[str, object] = {"input_size": image.shape[:2]}
    elif request.panorama or is_sphere(photo.path):
        maps, origin = _look_around(photo.path, predictor, request)
    else:
        result = predictor(photo.path, domain=request.domain)
        if request.calibration is not None:
            result = result.calibrated(request.calibration, network=request.model)
        if predictor.corrects_known_cameras and result.camera.source == "assumed":
            notes = (_UNKNOWN_CAMERA,)
        maps = result.maps
        origin = {
            "config_size": predictor.model.config.size,
            "input_size": result.size,
            "network_size": result.network_size,
            "domain": result.domain,
            "domain_probability": sidecars.rounded(result.domain_probability),
            **_about_camera(result),
        }
    seconds = time.perf_counter() - started
    folder = photo.target.parent
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".", dir=folder) as drafts:
        draft = Photo(photo.path, Path(drafts, photo.target.name))
        written = {name: OUTPUTS[name].write(draft.file(OUTPUTS[name].ending), maps, request.options)
                   for name in request.names}  # fmt: skip
        names = {name: draft.file(OUTPUTS[name].ending).name for name in written}
        sidecar = {
            **sidecars.describe(
                maps,
                origin={"source": str(photo.path), "model": request.model, **origin},
                facts={key: value for output in written.values() for key, value in output.facts.items()},
                files=names,
            ),
            **_files_of_earlier_runs(photo, set(names.values())),
            "zoedepth": __version__,
            "seconds": round(seconds, 3),
        }
        sidecars.write_sidecar(draft.file(sidecars.ENDING), sidecar)
        files = _files(photo, request)
        for kind, file in files.items():
            _files(draft, request)[kind].replace(file)
    return Outcome(photo, sidecar, files, (*notes, *(note for output in written.values() for note in output.notes)))


def predict_all(
    photos: Sequence[Photo], predictor: "Predictor", request: Request, *, workers: int = 1
) -> Iterator[Outcome]:
    """Predict ``workers`` photos at a time, and yield their outcomes in the order of the photos.

    A photo that fails does not stop the others, but when nothing can be written any more, no other is begun. When the
    work ends so, is interrupted or the iterator is closed, photos that have begun are finished, so that no file is left
    half written; after an error or a KeyboardInterrupt those are still yielded before it goes on.

    Args:
        photos: photos whose files do not clash, from ``find_photos``.
        predictor: used by all workers at the same time.
        request: the files to make of each photo.
        workers: photos computed at the same time, each in a thread. See ``share_cores``.

    Raises:
        InputError: ``workers`` is less than 1, or nothing can be written any more: the disk is full, or gone.
    """
    if workers < 1:
        raise InputError(f"workers must be 1 or more, got {workers}")
    inputs = {os.path.abspath(photo.path) for photo in photos}
    ends: list[InputError] = []  # why nothing can be written any more

    def predict_one(photo: Photo) -> Outcome:
        try:
            if clash := [file.name for file in _files(photo, request).values() if os.path.abspath(file) in inputs]:
                raise InputError(f"its {clash[0]} would overwrite another photo, choose another folder to write to")
            return predict_photo(photo, predictor, request)
        except ZoeDepthError as error:
            return Outcome(photo, failure=f"{photo.path}: {error}")
        except OSError as error:  # reading it has errors of its own
            if (end := _end_of_writing(photo, error)) is not None:
                ends.append(end)
            return Outcome(photo, failure=f"{photo.path}: its files cannot be written ({error.strerror or error})")
        except Exception as error:  # out of memory: the rest of ten thousand may still go well
            return Outcome(photo, failure=f"{photo.path}: {type(error).__name__}: {error}")

    executor = ThreadPoolExecutor(workers)
    waiting: deque[Future[Outcome]] = deque()
    try:
        waiting.extend(executor.submit(predict_one, photo) for photo in photos)
        while waiting:
            outcome = waiting[0].result()
            waiting.popleft()
            yield outcome
            if ends:
                raise ends[0]
    except (KeyboardInterrupt, InputError):
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


def _look_around(panorama: Path, predictor: "Predictor", request: Request) -> tuple[Maps, dict[str, object]]:
    """Return the maps of a panorama, and how they were made."""
    if predictor.camera != "exif":
        raise InputError("it is a panorama, which looks everywhere and has no camera: leave the camera out (--camera)")
    if request.calibration is not None:
        raise InputError(_NOT_CALIBRATED)
    result = predict_panorama(predictor, panorama, domain=request.domain)
    return result.maps, {
        "config_size": predictor.model.config.size,
        "input_size": result.size,
        "domain": result.domain,
        "views": len(result.scales),
        "disagreement": round(result.disagreement, 4),
        "focal_correction": result.focal_correction,
    }


def _about_camera(result: DepthMap) -> dict[str, object]:
    """Return what became of the depth because of its camera; ``sidecars.describe`` tells the camera itself."""
    about: dict[str, object] = {"focal_correction": result.focal_correction}
    if result.camera_note:
        about["camera_note"] = result.camera_note
    if result.calibration is not None:
        about["calibration"] = replace(result.calibration, readings=()).to_json()
    return about


def _files(photo: Photo, request: Request) -> dict[str, Path]:
    """Return all files of a photo by their outputs, the sidecar last: where it is, the others are complete."""
    endings = {name: OUTPUTS[name].ending for name in request.names} | {"sidecar": sidecars.ENDING}
    return {name: photo.file(ending) for name, ending in endings.items()}


def _files_of_earlier_runs(photo: Photo, names: set[str]) -> dict[str, object]:
    """Return what a sidecar says of files that it does not describe, and that are still there: they are ours, too."""
    sidecar = sidecars.read_sidecar(photo.file(sidecars.ENDING))
    earlier = set() if sidecar is None else sidecars.listed(sidecar) - names
    there = sorted(name for name in earlier if photo.target.with_name(name).exists())
    return {"other_files": there} if there else {}


def _end_of_writing(photo: Photo, error: OSError) -> InputError | None:
    """Return the reason why no file can be written any more; None where it is this photo alone that fails."""
    folder = photo.target.parent
    if error.errno in _DISK_FULL:
        return InputError(f"nothing more can be written to {folder} ({error.strerror}). Make room, and run it again")
    try:
        check_writable(folder)
    except InputError as refusal:
        return refusal
    return None


def _no_photo(file: Path) -> str | None:
    """Return why a file in a folder is no photo, or None."""
    suffix = file.suffix.lower()
    if (suffix in IMAGE_SUFFIXES or suffix in _OTHER_PICTURES) and is_own_file(file):
        return "written by zoedepth"
    if suffix in IMAGE_SUFFIXES:
        return None
    if suffix in _OTHER_PICTURES:
        return f"{suffix} files, {_OTHER_PICTURES[suffix]}"
    return "files of other kinds" if suffix or not file.is_symlink() or file.exists() else None


def _fixed_part(pattern: str) -> Path:
    """Return the folders of a glob before its first wildcard."""
    parts = Path(pattern).parts
    n_fixed = next(i for i, part in enumerate(parts) if glob.has_magic(part))
    return Path(*parts[:n_fixed])


def _matching(pattern: str, root: Path) -> Listing:
    """List the files that match a glob, without those in the folders of other programs.

    Python's own glob goes round in circles where links do.
    """
    parts = Path(pattern).parts[len(root.parts) :]
    if "**" in parts:
        listing = list_files(root)
        listing.files = [file for file in listing.files if _fits(file.relative_to(root).parts, parts)]
        return listing
    listing = Listing()
    for file in map(Path, sorted(glob.glob(pattern))):
        if service := service_folder(file.relative_to(root).parent):
            listing.left_out[f"in {service}, where another program keeps its files"] += 1
        elif file.is_file():
            listing.files.append(file)
    return listing


def _fits(names: tuple[str, ...], parts: tuple[str, ...]) -> bool:
    """Return True if the parts of a path fit those of a glob; ** stands for any number of folders."""
    if not parts:
        return not names
    if parts[0] == "**":
        return any(_fits(names[n:], parts[1:]) for n in range(len(names) + 1))
    return bool(names) and fnmatch(names[0], parts[0]) and _fits(names[1:], parts[1:])


def _with_targets(photos: list[tuple[Path, Path]], out: Path) -> list[Photo]:
    """Give each photo, with its place in the tree, a target that no other has."""

    def key(place: Path) -> str:
        # a.jpg and A.png share their files on Windows and macOS, and so do two ways to write é on macOS.
        return unicodedata.normalize("NFC", unicodedata.normalize("NFD", str(place)).casefold())

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
