"""The data of a run: which sets, what is held out, and how their samples are augmented."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from torch.utils.data import Dataset, Subset

from zoedepth.data import augment
from zoedepth.data.sample import DepthDataset, Sample
from zoedepth.errors import InputError
from zoedepth.opening import open_dataset
from zoedepth.train.config import SourceConfig, TrainConfig


class _Mapped(Dataset[Sample], DepthDataset):
    """What ``Subset`` takes: torch's class has no more than the protocol."""


def load_sources(
    config: TrainConfig, data: Mapping[str, str | Path]
) -> tuple[list[tuple[SourceConfig, "Subset[Sample]"]], dict[str, "Subset[Sample]"]]:
    """(what to train on with its config, what to validate on by name), from ``--data NAME=SOURCE``.

    Raises:
        InputError: a name is not one of the recipe's sources, or the data does not suit the stage.
    """
    known = {source.name: source for source in config.sources}
    if unknown := sorted(set(data) - set(known)):
        raise InputError(f"unknown data {unknown}: this recipe has the sources {sorted(known)}")
    if not data:
        raise InputError(f"no data: give --data NAME=SOURCE for one or more of {sorted(known)}")
    training, validation = [], {}
    for name in (source.name for source in config.sources if source.name in data):  # not the order of the command line
        dataset = open_source(known[name], data[name])
        if config.stage == "metric" and "disparity" in dataset.kinds:
            raise InputError(f"{data[name]} has disparity; stage 2 needs depth in metres")
        domains = {domain.name for domain in config.model.domains}
        if config.stage == "metric" and len(domains) > 1 and (others := set(dataset.domains) - domains):
            raise InputError(f"{data[name]} has the domains {sorted(others)}, the model {sorted(domains)}")
        n_training = len(dataset) - config.holdout
        if n_training < 1:
            raise InputError(f"{data[name]} has {len(dataset)} pairs: a holdout of {config.holdout} leaves none")
        training.append((known[name], Subset(dataset, range(n_training))))
        if config.holdout:
            validation[name] = Subset(dataset, range(n_training, len(dataset)))
    return training, validation


def open_source(source: SourceConfig, data: str | Path) -> _Mapped:
    """The training split of a source's data."""
    found = open_dataset(data, name=source.name, split="train", domain=source.domain, depth_scale=source.depth_scale)
    return cast(_Mapped, found)


def augmentations(source: SourceConfig, config: TrainConfig) -> list[augment.Augmentation]:
    """The augmentations of a source, in order."""
    domains = config.model.domains
    steps = [augment.kitti_crop()] if source.kitti_crop else []
    if source.crop == "fit":
        steps.append(
            augment.fit_crop(
                config.model.size,
                max_zoom=source.max_zoom,
                probability=source.zoom_probability,
                sparse=source.sparse,
            )
        )
    elif source.crop == "window":
        steps.append(augment.window(source.window or config.model.size, sparse=source.sparse))
    else:
        steps.append(augment.squeeze(config.model.size, sparse=source.sparse))
    steps += [augment.flip(), augment.rotate(degrees=source.rotate_degrees)]
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
        # However far: in disparity the farthest is 0, and the sky is a teacher too.
        steps.append(augment.to_disparity())
    else:
        ranges = {domain.name: (domain.min_depth, domain.max_depth) for domain in domains}
        steps.append(partial(_limit_by_domain, ranges=ranges))
    return steps


def _limit_by_domain(sample: Sample, rng: np.random.Generator, *, ranges: dict[str, tuple[float, float]]) -> Sample:
    """Depth outside the range of the sample's domain counts as unknown."""
    low, high = ranges.get(sample.domain) or next(iter(ranges.values()))
    return augment.limit_depth(low, high)(sample, rng)
