"""Sources of predictions: a model, a folder of somebody's depth maps, or a guess that never looks at the photo."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar, runtime_checkable
from typing import Protocol as Interface

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float

from zoedepth.config import ModelConfig
from zoedepth.data.augment import kitti_crop
from zoedepth.data.fit import lies_across
from zoedepth.data.names import Finder
from zoedepth.data.sample import DepthDataset, Sample
from zoedepth.download import Progress
from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import Protocol
from zoedepth.forward.answer import Precision
from zoedepth.geometry.camera import Camera
from zoedepth.geometry.points import known_depth
from zoedepth.images import DepthArray, to_image
from zoedepth.model.interface import DepthModel
from zoedepth.opening import open_dataset
from zoedepth.predict import Predictor
from zoedepth.runtimes.fast import load_fast
from zoedepth.stored import DEPTH_SUFFIXES, StoredMap, read_stored
from zoedepth.threads import cpu_count, share_cores
from zoedepth.weights.exported import ExportedModel
from zoedepth.weights.fingerprint import files_state, fingerprint, weights_fingerprint
from zoedepth.weights.load import find, load_for_prediction, pinned

# The usual ones first; DEPTH_SUFFIXES has all that can be read.
_SUFFIXES = tuple(dict.fromkeys((".png", ".npy", ".npz", *DEPTH_SUFFIXES)))


_MOST_WORKERS = 4


class Prediction(NamedTuple):
    """The answer of a source for one photo.

    A ``DepthMap`` is what a model makes of a photo, in metres and at the photo's size. A prediction may also come from
    a file or a guess: it can have any size, it can be relative, and nothing is known of a router or of the photo.
    """

    depth: DepthArray
    """Metres; inverse depth up to an unknown scale and shift where ``relative``."""
    std: DepthArray | None = None
    """Standard deviation of the depth in metres, where the source has one."""
    domain: str | None = None
    """Domain of the head that was chosen, where there was a choice."""
    relative: bool = False
    """True where the depth is inverse, up to an unknown scale and shift."""
    file: Path | None = None
    """The file that it was read from, if it was."""


Kind = Literal["depth", "disparity"]
"""depth: metres, or whole numbers with a scale. disparity: inverse depth up to an unknown scale and shift."""


@runtime_checkable
class PredictionSource(Interface):
    """Anything that predicts the depth of a photo.

    A source may have an attribute ``about``: a dict of facts that tell it from others, such as its settings. It is
    stored with the scores, and a folder with other facts is refused. It may have a method ``state`` that is given the
    name of a photo, as its data set lists it, and returns plain values that change when its prediction may, such as a
    hash of the weights: scores that were made in another state are made anew.
    """

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        """Predict the depth of a sample's photo, which is cropped already. The true depth must not be looked at."""
        ...


CameraUse = Literal["none", "data"]
"""none: a model is told nothing of the camera. data: it is told the camera that the data set says, and corrects its
depth by the focal length, whether or not it does so by itself."""


class ModelSource:
    """A model, run as the protocol says.

    Args:
        model: in evaluation mode, with or without metric heads.
        about: facts that tell it from others; see ``PredictionSource``.
        weights: a hash of its weights; scores that were made with others are made anew.
        camera: the knowledge of the photos' cameras that the model is given.
        streams: photos at the same time that an exported model was loaded for (``load_exported``).
        precision: see ``Predictor``.

    Raises:
        InputError: the model is to correct depth by the focal length, and its config does not say that of its training.
    """

    def __init__(
        self,
        model: DepthModel | ExportedModel,
        *,
        about: Mapping[str, object] | None = None,
        weights: str | None = None,
        camera: CameraUse = "none",
        streams: int = 1,
        precision: Precision = "float32",
    ) -> None:
        if camera == "data":
            Predictor(model, focal_correction=True)  # says what is missing, before any photo
        self.model = model
        # Scores without a camera were kept before there was a choice, and still hold.
        self.about = {**(about or {}), **({"camera": camera} if camera == "data" else {})}
        self.weights = weights
        self.camera: CameraUse = camera
        self._streams = streams
        self._precision: Precision = precision

    @classmethod
    def load(
        cls,
        name: str | Path,
        *,
        compat: Sequence[str] = (),
        device: str = "auto",
        camera: CameraUse = "none",
        fast: bool = False,
        progress: Progress | None = None,
        tell: Callable[[str], object] | None = None,
    ) -> "ModelSource":
        """Load a model, and remember the hash of its weights.

        Args:
            name: see ``zoedepth.weights.load.load_model``.
            compat: behaviours of the original code to take over; see there, too.
            device: cpu, cuda, mps, or auto for the best there is.
            camera: the knowledge of the photos' cameras that the model is given.
            fast: take what computes it fastest on this machine, see ``zoedepth.runtimes.fast.load_fast``. Its depth is
                within 1 % of that in float32, and so are its scores.
            progress: function to call while weights are downloaded; see there, too.
            tell: called with a sentence before something that takes long, and with the choice where ``fast``; None: a
                line in the log before what takes long.

        Raises:
            InputError: there is no such model, behaviour or device, or it cannot correct depth by the focal length.
        """
        streams = min(cpu_count(), _MOST_WORKERS)
        precision: Precision = "float32"
        place = pinned(name)
        about: dict[str, object] = {"model": str(name), "compat": list(compat)}
        with share_cores(streams):  # an exported model takes its threads when it is loaded
            if fast:
                chosen = load_fast(place, compat=compat, device=device, streams=streams, progress=progress, tell=tell)
                loaded, precision, device = chosen.model, chosen.precision, chosen.device
                about["fast"] = chosen.runtime
                if tell is not None:
                    tell(f"{name} is computed by {chosen.runtime} ({chosen.why})")
            else:
                loaded = load_for_prediction(place, device=device, compat=compat, streams=streams, progress=progress)
        model = Predictor(loaded, device=device).model
        if isinstance(model, ExportedModel):
            about["runtime"] = model.runtime
        # What is fast may be a file that was exported from the weights: one in 8 bits is another for other photos.
        weights = weights_fingerprint(model.path if fast and isinstance(model, ExportedModel) else find(place))
        return cls(model, about=about, weights=weights, camera=camera, streams=streams, precision=precision)

    @property
    def workers(self) -> int:
        """Photos that are best predicted at the same time, each with its share of the cores.

        On the CPU these are as many as there are cores, up to four, as each takes memory. The threads of an exported
        model are fixed when it is loaded: these are as many as it was loaded for.
        """
        if isinstance(self.model, ExportedModel):
            return self._streams
        return min(cpu_count(), _MOST_WORKERS) if self.model.device.type == "cpu" else 1

    def state(self, name: str) -> str | None:
        """Return the hash of the weights, whatever the photo."""
        return self.weights

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        """Predict depth at the photo's size; relative depth where the model has no metric heads.

        A labeled router (R.1) is told the domain that the data says, as it is in use; others are not.

        Raises:
            InputError: the data set's camera is to be used, and it says none for this photo; or a labeled model has no
                head for the photo's domain.
        """
        predictor = Predictor(
            self.model,
            flip_average=protocol.flip_average,
            pad=protocol.pad,
            upsampling=protocol.upsampling,
            resize=protocol.resize,
            precision=self._precision,
            focal_correction=self.camera == "data",
        )
        photo = to_image(_resize_photo(sample.image, protocol))
        if not self.model.config.domains:
            return Prediction(predictor.relative(photo), relative=True)
        labeled = self._is_labeled()
        if labeled and sample.domain not in (names := [domain.name for domain in self.model.config.domains]):
            raise InputError(
                f"{sample.name} is of the domain {sample.domain!r}, and this model, which must be told the domain, has "
                f"heads for {names}: name one of these in the data"
            )
        found = predictor(
            photo,
            domain=sample.domain if labeled else None,
            camera=self._camera(sample, (photo.shape[0], photo.shape[1])),
        )
        chosen = len(self.model.config.domains) > 1 and not labeled
        return Prediction(found.depth, found.std, found.domain if chosen else None)

    def _is_labeled(self) -> bool:
        """Return True if the model must be told the domain of each photo."""
        config = self.model.config
        return isinstance(config, ModelConfig) and len(config.domains) > 1 and config.router.kind == "labeled"

    def _camera(self, sample: Sample, size: tuple[int, int]) -> Camera | Literal["none"]:
        """Return the camera of a sample's photo after the protocol has resized it to ``size``."""
        if self.camera == "none":
            return "none"
        if sample.camera is None:
            raise InputError(
                f"the data says no camera for {sample.name}: give fx, fy, cx, cy in the list or in dataset.json, or "
                "evaluate with --camera none (from Python: camera='none')"
            )
        height, width = sample.image.shape[-2:]
        return Camera.of(sample.camera, (height, width)).resized(size)


class FolderSource:
    """A folder of depth maps, all in one place or in the photos' tree: ``name.png``, ``.npy``, ``.npz`` and others.

    A depth map is found by the photo's path as its list has it, or by its file name alone, each with or without
    ``_depth`` at the end. One of another size than the true depth is resized bilinearly.

    Args:
        folder: where the depth maps are.
        scale: stored value of one metre, for all files of the folder. None takes what each PNG says, and floating point
            for metres.
        kind: "depth", or "disparity" (inverse depth up to an unknown scale and shift), as MiDaS and its successors
            write it. None is depth, too, but lets ``plausible.check_predictions`` doubt it.

    Raises:
        InputError: the folder does not exist, or the scale is not positive.
    """

    def __init__(self, folder: Path, *, scale: float | None = None, kind: Kind | None = None) -> None:
        if not folder.is_dir():
            raise InputError(f"there is no folder {folder} with predictions: give the folder that holds the depth maps")
        if scale is not None and not 0 < scale < math.inf:
            raise InputError(
                f"the scale of {folder} must be finite and > 0, the stored value of one metre; it is {scale}"
            )
        self.folder = folder
        self.scale = scale
        self.kind = kind
        self.about: dict[str, object] = {"folder": str(folder), "scale": scale, "kind": kind or "depth"}
        self._photos: dict[Path, str] = {}
        self._finder = Finder(folder, anywhere=True)

    def state(self, name: str) -> object:
        """Return name, size and times of the files of a photo."""
        return None if self.find(name) is None else files_state(self._files(name))

    def find(self, name: str) -> Path | None:
        """Return the file of a photo; None where there is none."""
        path = next(self._candidates(name), None)
        if path is not None:
            self._photos.setdefault(path, name)
        return path

    def _candidates(self, name: str) -> Iterator[Path]:
        """Yield the files that may be a photo's."""
        stem = Path(name).with_suffix("")
        names = [stem, Path(stem.name), stem.with_name(f"{stem.name}_depth"), Path(f"{stem.name}_depth")]
        for found in dict.fromkeys(names):
            for suffix in _SUFFIXES:
                path = self._finder.find(f"{found}{suffix}", str(self.folder))
                if path.is_file():
                    yield path

    def _files(self, name: str) -> list[Path]:
        """Return the files that may be a photo's in the first folder that has one: its tree, or that of all maps."""
        files = list(self._candidates(name))
        return [file for file in files if file.parent == files[0].parent]

    def unit(self, name: str) -> float | None:
        """Return the stored value of one metre in the file of a photo; None where nobody says it.

        Raises:
            InputError: the file cannot be read, or has 8 bits a pixel.
        """
        return self._read(name)[2]

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        """Read the depth map of this photo.

        Raises:
            InputError: there is none, it is damaged, nobody says its scale, or it is another photo's already.
        """
        path, values, scale = self._read(sample.name)
        if self.kind == "disparity":
            return Prediction(values, relative=True, file=path)
        if scale is None and protocol.alignment != "none":
            scale = 1.0  # the alignment finds it
        if scale is None:
            raise InputError(
                f"{path} does not say how many of its steps are one metre: give --predictions-scale (from Python: "
                "scale), 1000 for millimetres, or 256 for KITTI's and the original's maps"
            )
        return Prediction(values / np.float32(scale), file=path)

    def _read(self, name: str) -> tuple[Path, DepthArray, float | None]:
        """Read a photo's file, its values and the stored value of one metre."""
        path = self.find(name)
        if path is None:
            raise InputError(
                f"{self.folder} has no depth of {name}: add {Path(name).with_suffix('')}.png, .npy or .npz to it"
            )
        if (other := self._photos[path]) != name:
            raise InputError(
                f"{path} would be the depth of two photos, {other} and {name}: put the depth maps into folders like "
                "those of the photos"
            )
        path, stored = self._chosen(name)
        if stored.values.dtype.itemsize < 2 and self.kind != "disparity":
            raise InputError(
                f"{path} has 8 bits a pixel: it is a picture of depth. Give 16 bits or floating point; if it is "
                "inverse depth, add --predictions-kind disparity"
            )
        if stored.relative and self.kind is None:
            raise InputError(f"{path} says that it is relative depth, without metres: add --predictions-kind disparity")
        return path, stored.values.astype(np.float32), self._scale_of(stored)

    def _scale_of(self, stored: StoredMap) -> float | None:
        return self.scale or stored.scale or (1.0 if stored.values.dtype.kind == "f" else None)

    def _chosen(self, name: str) -> tuple[Path, StoredMap]:
        """Return the file of a photo and its content: the most exact one of several that hold the same depth.

        Raises:
            InputError: none can be read, or two hold other depth than each other.
        """
        files, found, problem = self._files(name), [], None
        for file in files:
            try:
                found.append((file, read_stored(file)))
            except InputError as error:  # a preview has colours
                problem = error
        if len(files) > 1 and self.kind != "disparity":
            maps = [(file, stored) for file, stored in found if stored.values.dtype.itemsize > 1]  # 8 bits: a picture
            found = maps or found
        if not found:
            assert problem is not None, "there is a file"
            raise problem
        found.sort(key=lambda each: each[1].values.dtype.kind != "f")
        (first, exact), *others = found
        for file, stored in others:
            if not self._same(exact, stored):
                raise InputError(f"{first} and {file} may both be the depth of {name}. Remove one of them")
        return first, exact

    def _same(self, one: StoredMap, other: StoredMap) -> bool:
        """Return True where two files hold the same metres, or disparity up to its scale and shift, but for steps."""
        if one.values.shape != other.values.shape:
            return False
        if self.kind == "disparity":
            both = np.stack([one.values.ravel(), other.values.ravel()]).astype(np.float64)
            return bool(np.asarray(np.corrcoef(both))[0, 1] > 0.999)
        scales = self._scale_of(one), self._scale_of(other)
        if None in scales:
            return False
        (a, step), (b, other_step) = (
            (stored.values / np.float32(scale), 0.0 if stored.values.dtype.kind == "f" else 1 / scale)
            for stored, scale in zip((one, other), scales, strict=True)
            if scale is not None
        )
        known = known_depth(a) & known_depth(b)
        return bool(np.allclose(a[known], b[known], rtol=1e-3, atol=max(step, other_step)))


class ConstantSource:
    """One depth for all photos of a domain: the constant with the least mean REL on the training data.

    Args:
        training: samples whose depth is read, each in a domain of ``protocols``.
        protocols: domain → protocol, which crops the samples and limits the depth.
        about: facts that tell it from others; see ``PredictionSource``.

    Raises:
        InputError: a domain has no known depth.
    """

    def __init__(
        self,
        training: Iterable[Sample],
        protocols: Mapping[str, Protocol],
        *,
        about: Mapping[str, object] | None = None,
    ) -> None:
        values: dict[str, list[np.ndarray]] = {}
        for sample in training:
            protocol = protocols[sample.domain]
            truth = _known(prepare(sample, protocol), protocol)
            # A few pixels of each image are enough for one number.
            values.setdefault(sample.domain, []).append(truth[:: max(1, len(truth) // 2000)])
        self.depth = {domain: _least_rel(np.concatenate(found), domain) for domain, found in values.items()}
        self.about = dict(about or {})

    def state(self, name: str) -> str:
        """Return a hash of the constants."""
        return fingerprint(self.depth)

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        """Return the domain's constant at every pixel.

        Raises:
            InputError: the training data had no photo of this domain.
        """
        depth = _of_domain(self.depth, sample)
        return Prediction(np.full(tuple(sample.target.shape[1:]), depth, dtype=np.float32))


class MeanMapSource:
    """The mean of all depth maps of the training data, pixel by pixel: what can be learned without the photo.

    Args:
        training: samples whose depth is read, each in a domain of ``protocols``.
        protocols: domain → protocol, which crops the samples and limits the depth.
        about: facts that tell it from others; see ``PredictionSource``.

    Raises:
        InputError: a domain has no known depth.
    """

    SIZE = (240, 320)
    """(height, width) of the mean maps."""

    def __init__(
        self,
        training: Iterable[Sample],
        protocols: Mapping[str, Protocol],
        *,
        about: Mapping[str, object] | None = None,
    ) -> None:
        total: dict[str, np.ndarray] = {}
        count: dict[str, np.ndarray] = {}
        for sample in training:
            protocol = protocols[sample.domain]
            shown = prepare(sample, protocol)
            truth, mask = (F.interpolate(x[None].float(), self.SIZE, mode="nearest")[0, 0].numpy()
                           for x in (shown.target, shown.mask))  # fmt: skip
            known = (mask > 0) & (truth > protocol.min_depth) & (truth < protocol.max_depth)
            total[sample.domain] = total.get(sample.domain, np.zeros(self.SIZE)) + np.where(known, truth, 0)
            count[sample.domain] = count.get(sample.domain, np.zeros(self.SIZE)) + known
        self.depth = {domain: _filled(total[domain], count[domain], domain) for domain in total}
        self.about = dict(about or {})
        self._state = fingerprint({domain: depth.tobytes().hex() for domain, depth in self.depth.items()})

    def state(self, name: str) -> str:
        """Return a hash of the maps."""
        return self._state

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        """Return the domain's mean map at the size of the true depth.

        Raises:
            InputError: the training data had no photo of this domain.
        """
        mean = torch.from_numpy(_of_domain(self.depth, sample))[None, None]
        size = tuple(sample.target.shape[1:])
        return Prediction(F.interpolate(mean, size, mode="bilinear", align_corners=True)[0, 0].numpy())


_NO_CHANCE = np.random.default_rng(0)  # the crop is always the same, and asks for nothing of it

TRIVIAL = ("best constant", "mean depth map")
"""Labels of the sources that need no photo."""


def trivial_sources(
    training: Sequence[Path], protocols: Mapping[str, Protocol], *, root: Path | None = None
) -> dict[str, PredictionSource]:
    """Make the two sources that need no photo from training data, with the labels ``TRIVIAL``.

    Args:
        training: lists of photos with depth; see ``zoedepth.opening.open_dataset``. Disparity in them is passed over.
        protocols: domain → protocol; samples of other domains are passed over.
        root: the folder that the paths of lists are relative to; None takes that of each list.

    Raises:
        InputError: there is no such list, or a domain has no known depth.
    """
    datasets = [open_dataset(path, split="train", root=root) for path in training]
    about = {"training": [str(path) for path in training]}
    constant = ConstantSource(_training_samples(datasets, protocols), protocols, about=about)
    mean_map = MeanMapSource(_training_samples(datasets, protocols), protocols, about=about)
    return dict(zip(TRIVIAL, (constant, mean_map), strict=True))


def prepare(sample: Sample, protocol: Protocol) -> Sample:
    """Crop photo and depth as the protocol says, before the photo is predicted and the depth is scored."""
    return kitti_crop()(sample, _NO_CHANCE) if protocol.kitti_crop else sample


def predict(source: PredictionSource, sample: Sample, protocol: Protocol) -> tuple[Prediction, Sample]:
    """Predict a sample as an evaluation does; returns the sample as it is scored, too.

    A file may hold the depth of the whole photo where the protocol crops it: it is cropped in the same way.

    Raises:
        InputError: the source says so; or a file's size does not tell whether its depth is that of the photo or of the
            crop, or shows that photo or depth lies on its side.
    """
    shown = prepare(sample, protocol)
    found = source.predict(shown, protocol)
    if found.file is None:
        return found, shown
    whole, cropped = tuple(sample.target.shape[1:]), tuple(shown.target.shape[1:])
    if found.depth.shape[::-1] == whole != found.depth.shape or lies_across(whole, found.depth.shape):
        raise InputError(
            f"{found.file} is {_size(found.depth.shape)}, and {sample.name} {_size(whole)} (height x width): turn one"
        )
    if whole != cropped and found.depth.shape == whole:
        map_ = torch.from_numpy(found.depth)[None]
        return found._replace(depth=kitti_crop()(replace(sample, target=map_), _NO_CHANCE).target[0].numpy()), shown
    if whole != cropped != found.depth.shape:
        raise InputError(
            f"{found.file} is {_size(found.depth.shape)} (height x width): give it the size of the photo, "
            f"{_size(whole)}, or that of the crop of the protocol, {_size(cropped)}"
        )
    return found, shown


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[0]} x {shape[1]}"


Value = TypeVar("Value")


def _training_samples(datasets: Sequence[DepthDataset], protocols: Mapping[str, Protocol]) -> Iterator[Sample]:
    for dataset in datasets:
        if set(dataset.domains) & protocols.keys():  # else nothing of it need be read
            for index in range(len(dataset)):
                sample = dataset[index]
                if sample.kind == "depth" and sample.domain in protocols:
                    yield sample


def _of_domain(values: dict[str, Value], sample: Sample) -> Value:
    if sample.domain not in values:
        raise InputError(
            f"the training data has no photo of the domain {sample.domain!r}, only of {sorted(values)}: "
            "add a list that has some"
        )
    return values[sample.domain]


def _known(sample: Sample, protocol: Protocol) -> Float[np.ndarray, " pixels"]:
    truth = sample.target[0].numpy()
    return truth[sample.mask[0].numpy() & (truth > protocol.min_depth) & (truth < protocol.max_depth)]


def _least_rel(truth: Float[np.ndarray, " pixels"], domain: str) -> float:
    """Return the constant c with the least mean |truth - c| / truth: the median of the truth, weighted by 1 / truth."""
    if not len(truth):
        raise InputError(_nothing_known(domain))
    truth = np.sort(truth.astype(np.float64))
    weight = np.cumsum(1 / truth)
    return float(truth[np.searchsorted(weight, weight[-1] / 2)])


def _filled(total: np.ndarray, count: np.ndarray, domain: str) -> DepthArray:
    """Return the mean of each pixel; where nothing was known, that of its row, or of the whole map."""
    if not count.any():
        raise InputError(_nothing_known(domain))
    with np.errstate(invalid="ignore"):
        mean, rows = total / count, total.sum(1) / count.sum(1)
    rows = np.where(np.isfinite(rows), rows, total.sum() / count.sum())
    return np.where(count > 0, mean, rows[:, None]).astype(np.float32)


def _nothing_known(domain: str) -> str:
    return f"the training data of the domain {domain!r} has no known depth in the protocol's range: give other lists"


def _resize_photo(image: Float[torch.Tensor, "3 _ _"], protocol: Protocol) -> Float[torch.Tensor, "3 _ _"]:
    """Resize the photo to the size that the protocol gives it before the model, if any."""
    size = protocol.photo_size
    if protocol.photo_short_side is not None:
        height, width = image.shape[1:]
        scale = protocol.photo_short_side / min(height, width)
        size = (round(height * scale), round(width * scale))
    if size is None or tuple(image.shape[1:]) == size:
        return image
    antialias = protocol.photo_antialias
    return F.interpolate(image[None], size, mode="bilinear", align_corners=False, antialias=antialias)[0].clamp(0, 1)
