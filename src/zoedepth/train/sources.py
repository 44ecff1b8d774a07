"""The data of a training: which data sets, which pairs are held out, and how samples are augmented."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from torch.utils.data import Dataset, Subset

from zoedepth.checking import doubt_depth
from zoedepth.data import augment
from zoedepth.data.integrity import find_broken
from zoedepth.data.plausible import Doubts
from zoedepth.data.sample import DepthDataset, Sample
from zoedepth.errors import InputError
from zoedepth.opening import open_dataset
from zoedepth.train.config import SourceConfig, TrainConfig
from zoedepth.train.tolerant import Tolerant, explained, readable, too_many


class _Mapped(Dataset[Sample], DepthDataset):
    """A data set for the type checker: torch's ``Subset`` asks for torch's class, and we for our protocol."""


def load_sources(
    config: TrainConfig,
    data: Mapping[str, str | Path],
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[list[tuple[SourceConfig, Tolerant]], dict[str, "Subset[Sample]"]]:
    """Open the data, look at it, and hold out the last pairs of each data set.

    Args:
        config: the configuration of the training.
        data: name of one of its sources → where the data is.
        progress: called while files are looked at, with the number of samples that are done, and of all.

    Returns:
        A list of (config of a source, samples to train on), in the order of the config, and a dict of name → samples to
        validate on.

    Raises:
        InputError: a name is not one of the config's sources, the data does not suit the stage, too much of it is
            broken, or stage 2 is to learn from depth that no photo has.
    """
    known = {source.name: source for source in config.sources}
    if unknown := sorted(set(data) - set(known)):
        raise InputError(f"the recipe has no source {unknown}: --data can name {sorted(known)}")
    if not data:
        raise InputError(f"there is no data to train on: give --data NAME=SOURCE for one or more of {sorted(known)}")
    training, validation = [], {}
    # The order of the config: that of the command line does not count.
    for name in (source.name for source in config.sources if source.name in data):
        dataset = open_source(known[name], data[name])
        if config.stage == "metric" and "disparity" in dataset.kinds:
            raise InputError(f"{data[name]} has disparity; stage 2 needs depth in metres. Use it in stage 1")
        domains = {domain.name for domain in config.model.domains}
        if config.stage == "metric" and len(domains) > 1 and (others := set(dataset.domains) - domains):
            raise InputError(
                f"{data[name]} has photos of {sorted(others)}, but the model has heads for {sorted(domains)} only: "
                "rename the domains of the data, or add a head"
            )
        if config.stage == "metric" and config.model.canonical_camera:
            _check_cameras(known[name], dataset)
        held_out = config.held_out(name)
        n_training = len(dataset) - held_out
        if n_training < 1:
            raise InputError(f"{data[name]} has {len(dataset)} pairs: a holdout of {held_out} leaves none to train on")
        broken = {}
        if config.check != "off":
            broken = find_broken(dataset, full=config.check == "full", progress=progress)
        if too_many(broken, len(dataset)):
            raise InputError(explained(str(data[name]), broken, len(dataset)))
        odd = Doubts() if config.check == "off" or config.stage == "relative" else doubt_depth(dataset)
        if odd.impossible:
            raise InputError(
                f"{data[name]}: {'; '.join(odd.impossible)}. Give the right depth_scale in the data or in its source, "
                "or --config.check off if it is right as it is"
            )
        held = {i: problem for i, problem in broken.items() if i < n_training}
        part = _part(dataset, range(n_training), known[name])
        training.append((known[name], Tolerant(part, name=name, broken=held, doubts=odd.named)))
        if held_out:
            validation[name] = _part(dataset, range(n_training, len(dataset)), known[name])
    return training, validation


class _WithCamera(Subset[Sample]):
    """A part of a data set whose photos without a camera are given one of a focal length in their own pixels."""

    def __init__(self, dataset: Dataset[Sample], indices: Sequence[int], focal_px: float) -> None:
        super().__init__(dataset, indices)
        self._assume = augment.assume_camera(focal_px)

    def __getitem__(self, idx: Any) -> Sample:
        return self._assume(super().__getitem__(idx), np.random.default_rng(0))  # it draws nothing

    def __getitems__(self, indices: list[int]) -> list[Sample]:
        return [self[index] for index in indices]


def _part(dataset: Dataset[Sample], indices: Sequence[int], source: SourceConfig) -> "Subset[Sample]":
    return Subset(dataset, indices) if source.focal_px is None else _WithCamera(dataset, indices, source.focal_px)


def open_source(source: SourceConfig, data: str | Path) -> _Mapped:
    """Open the training split of a source's data. Pairs whose files are missing are kept: see ``Tolerant``."""
    found = open_dataset(
        data,
        name=source.name,
        split="train",
        keep_missing=True,
        domain=source.domain,
        depth_scale=source.depth_scale,
        max_depth=source.max_depth,
        root=source.root,
    )
    return cast(_Mapped, found)


def augmentations(source: SourceConfig, config: TrainConfig) -> list[augment.Augmentation]:
    """Return the augmentations of a source's samples, in order."""
    domains, antialias = config.model.domains, config.model.antialias
    steps = [augment.kitti_crop()] if source.kitti_crop else []
    turned = [augment.flip(), augment.rotate(degrees=source.rotate_degrees)]
    if source.crop == "fit":
        steps.append(
            augment.fit_crop(
                config.model.size,
                min_zoom=source.min_zoom,
                max_zoom=source.max_zoom,
                probability=source.zoom_probability,
                sparse=source.sparse,
                antialias=antialias,
            )
        )
        steps += turned
    elif source.crop == "window":
        steps.append(augment.window(source.window or config.model.size, sparse=source.sparse, antialias=antialias))
        steps += turned
    else:
        # Turned before it is squeezed: after it, one degree tilts verticals by more, and horizontals by less.
        steps += turned
        keep = config.stage == "metric" and config.loss_size == "truth"
        steps.append(augment.squeeze(config.model.size, sparse=source.sparse, antialias=antialias, keep_target=keep))
    steps.append(
        augment.jitter_colors(
            probability=source.color_probability,
            gamma=source.gamma,
            brightness=source.brightness,
            channel_gain=source.channel_gain,
            saturation=source.saturation,
        )
    )
    if config.stage == "relative":
        # No limit on the depth: infinitely far is disparity 0, so the sky teaches too.
        steps.append(augment.to_disparity())
    else:
        focal_px = {domain.name: domain.focal_px for domain in domains if domain.focal_px is not None}
        if config.model.canonical_camera:
            assume = source.without_camera == "assume"
            steps.append(augment.canonical_camera(focal_px, data=source.name, assume=assume))
        nearest = source.min_depth or 0.0
        ranges = {domain.name: (max(nearest, domain.min_depth), domain.max_depth) for domain in domains}
        steps.append(partial(_limit_by_domain, ranges=ranges))
    return steps


def _check_cameras(source: SourceConfig, dataset: DepthDataset) -> None:
    """Check the first photo that can be read: is its camera known? The others are checked when they are read."""
    if source.focal_px is not None or source.without_camera == "assume":
        return
    first = next(iter(readable(dataset)), None)
    if first is not None and first.camera is None:
        raise InputError(augment.no_camera(source.name, first.name))


def _limit_by_domain(sample: Sample, rng: np.random.Generator, *, ranges: dict[str, tuple[float, float]]) -> Sample:
    """Mark depth outside the range of the sample's domain as unknown."""
    low, high = ranges.get(sample.domain) or next(iter(ranges.values()))
    return augment.limit_depth(low, high)(sample, rng)
