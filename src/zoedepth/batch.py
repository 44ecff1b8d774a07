"""Many photos: predict each from file to files, and say which failed.

No console and no options of a command line: a service, a cluster and `zoedepth predict` all use this.

    found = find_photos(["photos/"], Path("depth"))
    for outcome in predict_all(found.photos, predictor, Request(model="zoed-lite"), workers=4):
        print(outcome.photo.path, outcome.failure or outcome.sidecar["depth"])
"""

import errno
import os
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from io import BytesIO
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, TypeVar

from zoedepth import __version__
from zoedepth.calibration import Calibration
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError, ZoeDepthError
from zoedepth.folders import check_writable
from zoedepth.images import read_image
from zoedepth.moved import moved_name
from zoedepth.outputs import OUTPUTS, Maps, Options, output_names
from zoedepth.outputs import sidecar as sidecars
from zoedepth.outputs.ownership import is_own_file
from zoedepth.panorama import is_sphere, predict_panorama
from zoedepth.photos import Photo
from zoedepth.tiles import Tiles, check_tiles, predict_tiled

if TYPE_CHECKING:
    from zoedepth.predict import Predictor


_UNKNOWN_CAMERA = (
    "without a known camera: that of the training photos was assumed, and depth was not corrected by the focal length. "
    "Say the field of view (--fov-x, --fov-diagonal) or the camera (--camera FILE)"
)

_NOT_CALIBRATED = (
    "a calibration is of photos of one camera, and a panorama looks everywhere and has none: leave the calibration out"
)

_NO_TILES = (
    "hardly larger than what the network sees, or seen in parts anyway (panoramas): tiles would add nothing, and depth "
    "is as without --tiles"
)

MAX_HELD = 1 << 28
"""Bytes that inputs hold while they wait, such as members of compressed archives: beyond, no more of them are read."""

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)

Item = TypeVar("Item")
Result = TypeVar("Result")


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
    weights: str | None = None
    """Hash of the model's weights for the calibration, see ``weights.load.weights_of``; None does not compare them."""
    panorama: bool = False
    """True takes all photos for panoramas of 360 x 180 degrees. Those that say so in their XMP are found anyway."""
    tiles: Tiles | None = None
    """(rows, columns) of the tiles in which large photos are seen, too, or "auto"; None for none. See ``tiles``."""

    def __post_init__(self) -> None:
        options = self.options
        given = {
            "domain": self.domain,
            "png_scale": options.png_scale,
            "vmin": options.vmin,
            "vmax": options.vmax,
            "colormap": None if options.colormap == Options.colormap else options.colormap,
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
        if self.tiles is not None:
            check_tiles(self.tiles)
            if self.relative:
                raise InputError("tiles are joined by their metres, and relative depth has none: leave the tiles out")
            if self.panorama:
                raise InputError("a panorama is seen in parts anyway: leave the tiles out")
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


def blocked(photo: Photo, request: Request, *, own: Collection[str] = ()) -> str | None:
    """Return why the files of a photo cannot be written: another program's, or another photo's, would be replaced.

    None: nothing is there, or what this package wrote for this photo before.

    Args:
        photo: the photo.
        request: the files that would be written.
        own: names of files that are known to be this photo's.
    """
    sidecar = sidecars.read_sidecar(photo.file(sidecars.ENDING))
    if sidecar is not None and not sidecars.of_same_photo(sidecar, Path(photo.name)):
        return f"{photo.file(sidecars.ENDING)} is of {sidecar['source']}, another photo: choose another folder"
    for file in files_of(photo, request).values():
        if os.path.lexists(file) and file.name not in own and not is_own_file(file):
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
    maps = predict_maps(photo, predictor, request)
    folder = photo.target.parent
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".", dir=folder) as drafts:
        earlier = earlier_files(photo, {file.name for file in files_of(photo, request).values()})
        draft = write_drafts(photo, maps, request, Path(drafts), earlier=earlier)
        files = files_of(photo, request)
        for kind, file in draft.files.items():
            file.replace(files[kind])
    return replace(draft, files=files)


@dataclass(frozen=True)
class Predicted:
    """The maps of a photo, before they are written."""

    maps: Maps
    origin: Mapping[str, object]
    """How they were made, for the sidecar."""
    seconds: float
    """Time that reading and predicting the photo took."""
    notes: tuple[str, ...] = ()
    """Sentences for the user about the photo, see ``Written``."""


def predict_maps(photo: Photo, predictor: "Predictor", request: Request) -> Predicted:
    """Predict one photo, and write nothing.

    Raises:
        InputError: the photo cannot be read or predicted.
    """
    started = time.perf_counter()
    content = None if photo.origin is None else photo.origin.read()

    def picture() -> Any:
        return photo.path if content is None else NamedBytes(content, photo.name)

    notes: tuple[str, ...] = ()
    if request.relative:
        image = read_image(picture())
        maps = Maps(relative=predictor.relative(image), image=image)
        origin: dict[str, object] = {"input_size": image.shape[:2]}
    elif request.panorama or is_sphere(picture()):
        maps, origin = _look_around(picture(), predictor, request)
        notes = () if request.tiles is None else (_NO_TILES,)
    else:
        if request.tiles is None:
            result = predictor(picture(), domain=request.domain)
        else:
            result = predict_tiled(predictor, picture(), tiles=request.tiles, domain=request.domain)
            notes = (_NO_TILES,) if result.tiles is None else ()
        if request.calibration is not None:
            result = result.calibrated(request.calibration, network=request.model, weights=request.weights)
        if predictor.corrects_known_cameras and result.camera.source == "assumed":
            notes = (*notes, _UNKNOWN_CAMERA)
        maps = result.maps
        origin = {
            "config_size": predictor.model.config.size,
            "input_size": result.size,
            "network_size": result.network_size,
            "domain": result.domain,
            "domain_probability": sidecars.rounded(result.domain_probability),
            **({} if result.tiles is None else {"tiles": result.tiles}),
            **_about_camera(result),
        }
    return Predicted(maps, {**origin, "runtime": predictor.runtime}, time.perf_counter() - started, notes)


def write_drafts(
    photo: Photo, predicted: Predicted, request: Request, folder: Path, *, earlier: Sequence[str] = ()
) -> Outcome:
    """Write all files of a photo to a folder from which they can be moved to their places.

    Args:
        photo: the photo.
        predicted: its maps.
        request: the files to make.
        folder: where to write; it must be there.
        earlier: names of files that earlier runs wrote for this photo: its sidecar goes on to know them.

    Returns:
        The outcome, with the paths of the drafts, the sidecar last.

    Raises:
        InputError: the maps lack what a kind of file needs.
        OSError: a file cannot be written.
    """
    draft = Photo(photo.path, folder / photo.target.name)
    files = files_of(draft, request)
    options = request.options
    shown = predicted.maps.up_to(options.max_depth)
    written = {name: OUTPUTS[name].write(files[name], shown, options) for name in request.names}
    sidecar = {
        **sidecars.describe(
            predicted.maps,
            origin={"source": photo.name, "model": request.model, **predicted.origin},
            facts={key: value for output in written.values() for key, value in output.facts.items()},
            files={name: files[name].name for name in written},
        ),
        **({} if options.max_depth is None else {"max_depth": options.max_depth}),
        **({"other_files": list(earlier)} if earlier else {}),
        "zoedepth": __version__,
        "seconds": round(predicted.seconds, 3),
    }
    sidecars.write_sidecar(files["sidecar"], sidecar)
    notes = (*predicted.notes, *(note for output in written.values() for note in output.notes))
    return Outcome(photo, sidecar, files, notes)


class NamedBytes(BytesIO):
    """Bytes as an open file with a name, for messages."""

    def __init__(self, content: bytes, name: str) -> None:
        super().__init__(content)
        self.name = name


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
            if clash := [file.name for file in files_of(photo, request).values() if os.path.abspath(file) in inputs]:
                raise InputError(f"its {clash[0]} would overwrite another photo, choose another folder to write to")
            return predict_photo(photo, predictor, request)
        except ZoeDepthError as error:
            return Outcome(photo, failure=f"{photo.path}: {error}")
        except OSError as error:  # reading it has errors of its own
            if (end := end_of_writing(photo, error)) is not None:
                ends.append(end)
            return Outcome(photo, failure=f"{photo.path}: its files cannot be written ({error.strerror or error})")
        except Exception as error:  # out of memory: the rest of ten thousand may still go well
            return Outcome(photo, failure=f"{photo.path}: {type(error).__name__}: {error}")

    yield from in_turn(predict_one, photos, workers=workers, stop=lambda: ends[0] if ends else None)


def in_turn(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    workers: int,
    ahead: int | None = None,
    held: Callable[[Item], int] = lambda item: 0,
    stop: Callable[[], InputError | None] = lambda: None,
) -> Iterator[Result]:
    """Do ``workers`` items at a time, each in a thread, and yield their results in the order of the items.

    When the work is stopped or interrupted, or the iterator is closed, items that have begun are finished; after an
    error or a KeyboardInterrupt their results are still yielded before it goes on.

    Args:
        work: function of an item. It must not raise.
        items: things to do. They are asked for as they are needed.
        workers: items that are done at the same time.
        ahead: items that are asked for before the first of them is done, at most; None: four for each worker.
        held: function that returns the bytes that an item holds. No more items are asked for while those that wait
            hold more than ``MAX_HELD`` together.
        stop: returns why no other item shall be begun, or None. It is asked after each result.

    Raises:
        InputError: the error that ``stop`` returned.
    """
    executor, source = ThreadPoolExecutor(workers), iter(items)
    waiting: deque[Future[Result]] = deque()
    sizes: deque[int] = deque()  # bytes that the items of these results hold
    ahead = ahead or 4 * workers
    try:
        while True:
            while len(waiting) < ahead and sum(sizes) <= MAX_HELD and (more := tuple(islice(source, 1))):
                sizes.append(held(more[0]))
                waiting.append(executor.submit(work, more[0]))
            if not waiting:
                break
            result = waiting[0].result()
            waiting.popleft()
            sizes.popleft()
            yield result
            if (error := stop()) is not None:
                raise error
    except (KeyboardInterrupt, InputError):
        executor.shutdown(cancel_futures=True)
        yield from (done.result() for done in waiting if not done.cancelled() and done.exception() is None)
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def _look_around(panorama: Any, predictor: "Predictor", request: Request) -> tuple[Maps, dict[str, object]]:
    """Return the maps of a panorama, and how they were made."""
    if not isinstance(predictor.camera, str):  # "exif" and "none" name no camera
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


def files_of(photo: Photo, request: Request) -> dict[str, Path]:
    """Return all files of a photo by their outputs, the sidecar last: where it is, the others are complete."""
    endings = {name: OUTPUTS[name].ending for name in request.names} | {"sidecar": sidecars.ENDING}
    return {name: photo.file(ending) for name, ending in endings.items()}


def earlier_files(photo: Photo, names: set[str]) -> list[str]:
    """Return the names of files that a sidecar tells of besides ``names``, and that are still there: they are ours."""
    sidecar = sidecars.read_sidecar(photo.file(sidecars.ENDING))
    earlier = set() if sidecar is None else sidecars.listed(sidecar) - names
    return sorted(name for name in earlier if photo.target.with_name(name).exists())


def end_of_writing(photo: Photo, error: OSError) -> InputError | None:
    """Return the reason why no file can be written any more; None where it is this photo alone that fails."""
    folder = photo.target.parent
    if error.errno in _DISK_FULL:
        return InputError(f"nothing more can be written to {folder} ({error.strerror}). Make room, and run it again")
    try:
        check_writable(folder)
    except InputError as refusal:
        return refusal
    return None


def __getattr__(name: str) -> object:
    return moved_name(__name__, name)
