"""Where predictions come from: a model, a folder of somebody's depth maps, or what one would say without looking."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple, TypeVar, runtime_checkable
from typing import Protocol as Interface

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float

from zoedepth.data.augment import kitti_crop
from zoedepth.data.sample import Sample
from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import Protocol
from zoedepth.images import DepthArray, read_depth, to_image
from zoedepth.model.interface import DepthModel
from zoedepth.predict import Predictor


class Prediction(NamedTuple):
    """What is said of one photo, at any size."""

    depth: DepthArray
    """Metres; or relative inverse depth, where ``relative``."""
    std: DepthArray | None = None
    """Metres: how unsure the prediction is of itself."""
    domain: str | None = None
    """Domain of the head that was chosen, where there was a choice."""
    relative: bool = False
    """The depth is inverse, up to an unknown scale and shift."""


@runtime_checkable
class Source(Interface):
    """Anything that has something to say about a photo."""

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        """Depth of a sample's photo, which is cut as the protocol says already. The truth is not to be looked at."""
        ...


class ModelSource:
    """A ZoeDepth, run as the protocol says."""

    def __init__(self, model: DepthModel) -> None:
        self.model = model

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        """Depth at the photo's size; relative depth from a model without metric heads."""
        predictor = Predictor(
            self.model,
            flip_average=protocol.flip_average,
            pad=protocol.pad,
            upsampling=protocol.upsampling,
            resize=protocol.resize,
        )
        photo = to_image(_resize_photo(sample.image, protocol))
        if not self.model.config.domains:
            return Prediction(predictor.relative(photo), relative=True)
        found = predictor(photo)
        return Prediction(found.depth, found.std, found.domain if len(self.model.config.domains) > 1 else None)


class FolderSource:
    """Depth maps in files: ``name.png`` (16 bits), ``.npy`` or ``.npz``, beside each other or in the photos' tree.

    They are found by the photo's path as its list has it, by its name, or by its name and ``_depth``. What has another
    size than the true depth is resized bilinearly.

    Raises:
        InputError: the folder does not exist.
    """

    def __init__(self, folder: Path, *, scale: float | None = None) -> None:
        if not folder.is_dir():
            raise InputError(f"there is no folder {folder} with predictions")
        self.folder = folder
        self.scale = scale

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        """The file of this photo.

        Raises:
            InputError: there is none, or it is damaged.
        """
        stem = Path(sample.name).with_suffix("")
        names = [stem, Path(stem.name), stem.with_name(f"{stem.name}_depth"), Path(f"{stem.name}_depth")]
        for name in names:
            for suffix in (".png", ".npy", ".npz"):
                path = self.folder / f"{name}{suffix}"
                if path.is_file():
                    return Prediction(read_depth(path, scale=self.scale if suffix == ".png" else None))
        raise InputError(f"{self.folder} has no depth of {sample.name}: neither {names[0]}.png, .npy nor .npz")


class ConstantSource:
    """One depth for every pixel of a domain: the one with the least mean REL on training data."""

    def __init__(self, training: Iterable[Sample], protocols: dict[str, Protocol]) -> None:
        values: dict[str, list[np.ndarray]] = {}
        for sample in training:
            truth = _known(_cut(sample, protocols[sample.domain]), protocols[sample.domain])
            # A few pixels of each image are enough for one number.
            values.setdefault(sample.domain, []).append(truth[:: max(1, len(truth) // 2000)])
        self.depth = {domain: _least_rel(np.concatenate(found), domain) for domain, found in values.items()}

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        """The domain's constant."""
        depth = _of_domain(self.depth, sample)
        return Prediction(np.full(tuple(sample.target.shape[1:]), depth, dtype=np.float32))


class MeanMapSource:
    """The mean of the training set's depth maps, pixel by pixel: what is learned without looking at the photo."""

    SIZE = (240, 320)

    def __init__(self, training: Iterable[Sample], protocols: dict[str, Protocol]) -> None:
        total: dict[str, np.ndarray] = {}
        count: dict[str, np.ndarray] = {}
        for sample in training:
            protocol = protocols[sample.domain]
            cut = _cut(sample, protocol)
            truth, mask = (F.interpolate(x[None].float(), self.SIZE, mode="nearest")[0, 0].numpy()
                           for x in (cut.target, cut.mask))  # fmt: skip
            known = (mask > 0) & (truth > protocol.min_depth) & (truth < protocol.max_depth)
            total[sample.domain] = total.get(sample.domain, np.zeros(self.SIZE)) + np.where(known, truth, 0)
            count[sample.domain] = count.get(sample.domain, np.zeros(self.SIZE)) + known
        self.depth = {domain: _filled(total[domain], count[domain], domain) for domain in total}

    def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
        """The domain's mean map, at the size of the true depth."""
        mean = torch.from_numpy(_of_domain(self.depth, sample))[None, None]
        size = tuple(sample.target.shape[1:])
        return Prediction(F.interpolate(mean, size, mode="bilinear", align_corners=True)[0, 0].numpy())


Value = TypeVar("Value")


def _of_domain(values: dict[str, Value], sample: Sample) -> Value:
    if sample.domain not in values:
        raise InputError(f"the training data has no domain {sample.domain!r}, only {sorted(values)}")
    return values[sample.domain]


def _cut(sample: Sample, protocol: Protocol) -> Sample:
    return kitti_crop()(sample, np.random.default_rng()) if protocol.kitti_crop else sample


def _known(sample: Sample, protocol: Protocol) -> Float[np.ndarray, " pixels"]:
    truth = sample.target[0].numpy()
    return truth[sample.mask[0].numpy() & (truth > protocol.min_depth) & (truth < protocol.max_depth)]


def _least_rel(truth: Float[np.ndarray, " pixels"], domain: str) -> float:
    """The constant c with the least mean |truth - c| / truth: the median of the truth, weighted by its inverse."""
    if not len(truth):
        raise InputError(f"the training data of the domain {domain!r} has no known depth")
    truth = np.sort(truth.astype(np.float64))
    weight = np.cumsum(1 / truth)
    return float(truth[np.searchsorted(weight, weight[-1] / 2)])


def _filled(total: np.ndarray, count: np.ndarray, domain: str) -> DepthArray:
    """The mean where anything was known, and the mean of its row, or of all, elsewhere."""
    if not count.any():
        raise InputError(f"the training data of the domain {domain!r} has no known depth")
    with np.errstate(invalid="ignore"):
        mean, rows = total / count, total.sum(1) / count.sum(1)
    rows = np.where(np.isfinite(rows), rows, total.sum() / count.sum())
    return np.where(count > 0, mean, rows[:, None]).astype(np.float32)


def _resize_photo(image: Float[torch.Tensor, "3 _ _"], protocol: Protocol) -> Float[torch.Tensor, "3 _ _"]:
    """The photo at the size the protocol's loader gives it."""
    size = protocol.photo_size
    if protocol.photo_short_side is not None:
        height, width = image.shape[1:]
        scale = protocol.photo_short_side / min(height, width)
        size = (round(height * scale), round(width * scale))
    if size is None or tuple(image.shape[1:]) == size:
        return image
    return F.interpolate(image[None], size, mode="bilinear", align_corners=False, antialias=True)[0].clamp(0, 1)
