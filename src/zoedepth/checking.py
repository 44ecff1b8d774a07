"""Is a download complete, readable, and what it should be? What ``zoedepth data check`` reports, and shows."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zoedepth.colors import color_bar, colorize, depth_range, panel, sheet
from zoedepth.data.pairs import PairDataset
from zoedepth.data.sample import Sample, Samples, Target
from zoedepth.datasets.published import PublishedDataset
from zoedepth.errors import InputError
from zoedepth.images import ImageArray

N_READ = 50
"""Pairs that are read unless all are: enough for the range of depth, and seconds rather than hours."""

N_SHOWN = 8
"""Pairs in a contact sheet."""

_VALUES_PER_PAIR = 10_000
_PANEL, _WIDE_PANEL = (300, 440), (300, 880)
"""A panel of the sheet fits into this (height, width); the other is for photos more than twice as wide as high."""
SPARSE = 0.3
"""Share of known pixels below which depth counts as scattered points: lidar has 5 to 20 %, a Kinect 60 to 100 %."""


@dataclass(frozen=True)
class Values:
    """How the known values of a target spread: metres, or disparity without a unit."""

    least: float
    low: float
    """First percentile."""
    median: float
    high: float
    """99th percentile."""
    greatest: float


@dataclass(frozen=True)
class Report:
    """What was found."""

    kind: Target | None
    """None where nothing could be read."""
    n_pairs: int
    n_published: int | None
    """Pairs of a complete download; None where there is no such number."""
    n_without_truth: int
    """Pairs of which the set's own list says that there is no depth."""
    missing: tuple[Path, ...]
    """Files that should be there and are not."""
    readable: tuple[int, ...]
    """Indices of the pairs that were read, evenly spread over those that have all their files."""
    unreadable: tuple[str, ...]
    """What is wrong with each of those that could not be read; the message names the file."""
    photo_sizes: dict[tuple[int, int], int]
    """(height, width) → photos that were read. The most frequent comes first."""
    values: Values | None
    """None where nothing is known."""
    known: float
    """Mean share of pixels whose target is known."""
    empty: tuple[str, ...]
    """Pairs that were read and of which no pixel is known."""
    n_cameras: int
    """Pairs that were read and whose camera is known."""

    @property
    def n_tried(self) -> int:
        """Pairs that were read, or could not be."""
        return len(self.readable) + len(self.unreadable)

    @property
    def problems(self) -> list[str]:
        """Why the download is not in order, in words; nothing where it is."""
        found = []
        if self.n_published is not None and self.n_pairs < self.n_published:
            found.append(f"{self.n_pairs:,} of {self.n_published:,} pairs are here")
        if self.missing:
            found.append(f"{len(self.missing):,} files are missing")
        if self.unreadable:
            found.append(f"{len(self.unreadable):,} of {self.n_tried:,} pairs cannot be read")
        if self.values is None:
            found.append("no pixel of any pair has a known depth")
        return found


def check(dataset: Samples, *, every: bool = False, track: Callable[[Sequence[int]], Iterable[int]] = iter) -> Report:
    """Read a sample of a data set's pairs, or all, and say what there is.

    Args:
        dataset: a published one is opened with ``allow_missing``, so that all that is missing can be reported.
        every: read every pair, not just ``N_READ`` of them.
        track: what shows progress over the pairs.

    Raises:
        MissingExtraError: its files need a library that is not installed.
    """
    complete, missing, n_without_truth = _survey(dataset)
    chosen = complete if every else evenly(complete, N_READ)
    sizes: Counter[tuple[int, int]] = Counter()
    kinds: set[Target] = set()
    readable, unreadable, empty, shares, spread = [], [], [], [], []
    least, greatest, n_cameras = np.inf, -np.inf, 0
    for index in track(chosen):
        try:
            sample = dataset[index]
            size = _photo_size(dataset, index, sample)
        except InputError as error:
            unreadable.append(str(error))
            continue
        readable.append(index)
        sizes[size] += 1
        kinds.add(sample.kind)
        n_cameras += sample.camera is not None
        values = sample.target[sample.mask].numpy()
        shares.append(values.size / sample.mask.numel())
        if not values.size:
            empty.append(sample.name)
            continue
        least, greatest = min(least, float(values.min())), max(greatest, float(values.max()))
        spread.append(values[:: max(1, values.size // _VALUES_PER_PAIR)])
    found = None
    if spread:
        low, median, high = (float(value) for value in np.percentile(np.concatenate(spread), (1, 50, 99)))
        found = Values(least, low, median, high, greatest)
    return Report(
        kind=min(kinds, default=None),
        n_pairs=len(dataset),
        n_published=dataset.about.splits[dataset.split] if isinstance(dataset, PublishedDataset) else None,
        n_without_truth=n_without_truth,
        missing=tuple(missing),
        readable=tuple(readable),
        unreadable=tuple(unreadable),
        photo_sizes=dict(sizes.most_common()),
        values=found,
        known=float(np.mean(shares)) if shares else 0.0,
        empty=tuple(empty),
        n_cameras=n_cameras,
    )


def contact_sheet(dataset: Samples, indices: Sequence[int]) -> ImageArray:
    """Each photo beside its depth, with a bar of its own; unknown is grey, disparity in percent of the picture's range.

    Args:
        dataset: has at least one readable pair.
        indices: pairs that can be read, as ``check`` found; ``N_SHOWN`` of them are taken, evenly spread.
    """
    pairs = [_panels(dataset[index]) for index in evenly(indices, N_SHOWN)]
    # Two pairs beside each other, but those of wide photos below each other.
    per_row = 1 if any(photo.shape[1] > 2 * photo.shape[0] for photo, _ in pairs) else 2
    return sheet([[item for pair in pairs[i : i + per_row] for item in pair] for i in range(0, len(pairs), per_row)])


def evenly(indices: Sequence[int], n: int) -> list[int]:
    """``n`` of them evenly spread, with the first and the last; all where there are no more."""
    if len(indices) <= n:
        return list(indices)
    return [indices[round(i * (len(indices) - 1) / max(n - 1, 1))] for i in range(n)]


def _survey(dataset: Samples) -> tuple[list[int], list[Path], int]:
    """(pairs that have all their files and a truth, missing files, number of pairs without truth)"""
    if isinstance(dataset, PublishedDataset):
        missing = dataset.missing_files()
        gone = set(missing)
        bare = sum(frame.target is None for frame in dataset.frames)
        complete = [i for i, f in enumerate(dataset.frames) if f.target is not None and gone.isdisjoint(f.files)]
        return complete, missing, bare
    if isinstance(dataset, PairDataset):
        complete = [i for i, pair in enumerate(dataset.pairs) if pair.target is not None]
        return complete, [], len(dataset) - len(complete)
    return list(range(len(dataset))), [], 0


def _photo_size(dataset: Samples, index: int, sample: Sample) -> tuple[int, int]:
    """Of the photo as it is in its file: the sample has the size of the depth."""
    if isinstance(dataset, PublishedDataset):
        photo = dataset.read_photo(dataset.frames[index])
        return photo.shape[0], photo.shape[1]
    return sample.image.shape[1], sample.image.shape[2]


def _panels(sample: Sample) -> tuple[ImageArray, ImageArray]:
    """Photo and target of a pair, at one size."""
    photo = (sample.image.permute(1, 2, 0).numpy() * 255).round().astype(np.uint8)
    height, width = photo.shape[:2]
    limit = _WIDE_PANEL if width > 2 * height else _PANEL
    scale = min(limit[0] / height, limit[1] / width)
    size = (max(1, round(height * scale)), max(1, round(width * scale)))
    target, known = sample.target[0].numpy(), sample.mask[0].numpy()
    low, high = (float(target[known].min()), float(target[known].max())) if known.any() else (0.0, 0.0)
    target = np.where(known, target, np.nan)
    if sample.kind == "disparity":
        # 0 would be drawn as unknown.
        target = (100 * (target - low) / max(high - low, 1e-12)).clip(1e-3)
        vmin, vmax, colormap, unit, what = 0.0, 100.0, "magma", "%", "disparity"
    else:
        vmin, vmax = depth_range(target, percentiles=(1.0, 99.0))
        colormap, unit, what = "magma_r", "m", f"{low:.2f} to {high:.2f} m"
    caption = f"{what}, {known.mean():.0%} known"
    if known.mean() < SPARSE:
        target = _gathered(target)
    colors = colorize(target, vmin=vmin, vmax=vmax, colormap=colormap)
    bar = color_bar(size[0], vmin=vmin, vmax=vmax, colormap=colormap, unit=unit)
    return (
        panel(photo, size=size, caption=_shortened(sample.name, size[1])),
        panel(colors, size=size, bar=bar, caption=caption),
    )


def _gathered(target: np.ndarray) -> np.ndarray:
    """Scattered points on a grid coarse enough for about one in each cell: as they are there is nothing to see."""
    share = float(np.isfinite(target).mean())
    size = tuple(max(1, round(side * share**0.5)) for side in target.shape)
    coarse = np.full(size, np.nan, np.float32)
    rows, columns = np.nonzero(np.isfinite(target))
    coarse[rows * size[0] // target.shape[0], columns * size[1] // target.shape[1]] = target[rows, columns]
    return coarse


def _shortened(name: str, width: int) -> str:
    """A name that fits above a picture ``width`` pixels wide; its end says more than its beginning."""
    most = max(8, width // 8)
    return name if len(name) <= most else f"...{name[3 - most :]}"
