"""Check that data is complete, readable and in the right unit: the report and picture of ``zoedepth data check``."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from zoedepth.colors import color_bar, colorize, depth_range, panel, sheet
from zoedepth.data.integrity import find_broken
from zoedepth.data.pairs import PairDataset
from zoedepth.data.plausible import Doubts, doubts, glance
from zoedepth.data.registration import MOST, Edges, Registration, edges, register
from zoedepth.data.sample import Sample, Samples, Target
from zoedepth.datasets.published import PublishedDataset
from zoedepth.errors import InputError
from zoedepth.images import ImageArray
from zoedepth.synthetic import SyntheticScenes

N_READ = 50
"""Pairs that are read unless all are asked for: enough for the range of depth, in seconds rather than hours."""

N_DOUBTED = 16
"""Pairs whose depth is looked at before a data set is trained on, or scored."""

N_SHOWN = 8
"""Pairs in a contact sheet."""

_VALUES_PER_PAIR = 10_000
_PANEL, _WIDE_PANEL = (300, 440), (300, 880)
"""(height, width) of a panel in the sheet; the second is for photos more than twice as wide as high."""
SPARSE = 0.3
"""Share of known pixels below which depth counts as scattered points: lidar has 5 to 20 %, a Kinect 60 to 100 %."""


@dataclass(frozen=True)
class Values:
    """The spread of the known values of a target: metres, or disparity without a unit."""

    least: float
    low: float
    """First percentile."""
    median: float
    high: float
    """99th percentile."""
    greatest: float


@dataclass(frozen=True)
class Report:
    """The findings about a data set."""

    kind: Target | None
    """None where nothing could be read."""
    n_pairs: int
    n_expected: int | None
    """Pairs of a complete download; None where nobody says how many."""
    n_without_truth: int
    """Pairs that have no depth, as the set's own list says."""
    missing: tuple[Path, ...]
    """Files that should be there and are not."""
    n_tried: int
    """Number of pairs whose files were looked at or read."""
    readable: tuple[int, ...]
    """Indices of the pairs that were read, evenly spread over the pairs with all their files."""
    unreadable: tuple[str, ...]
    """A message for each pair that could not be read; it names the file and what is wrong with it."""
    photo_sizes: dict[tuple[int, int], int]
    """(height, width) → number of photos of that size. The most frequent comes first."""
    values: Values | None
    """None where no pixel is known."""
    known: float
    """Mean share of pixels whose target is known."""
    empty: tuple[str, ...]
    """Names of the pairs that were read and have no known pixel."""
    n_cameras: int
    """Number of pairs that were read and whose camera is known."""
    doubts: Doubts = field(default_factory=Doubts)
    """Findings about the depth that are not plausible."""
    unit_known: bool = False
    """True where the reader knows the unit: published data, rendered scenes."""
    registration: Registration | None = None
    """The place where the depth fits the photos best; None where edges do not tell."""

    @property
    def notes(self) -> list[str]:
        """Sentences about things to look at, which may be right."""
        mark = self.doubts.mark
        found = [] if mark is None or (mark.certain and not self.unit_known) else [str(mark)]
        found += self.doubts.unlikely if self.unit_known else []
        return found + ([] if self.registration is None or self.registration.fits else [str(self.registration)])

    @property
    def problems(self) -> list[str]:
        """The reasons why the download is not in order, in words; none where it is."""
        found = []
        if self.n_expected is not None and self.n_pairs < self.n_expected:
            found.append(f"{self.n_pairs:,} of {self.n_expected:,} pairs are here")
        if self.missing:
            found.append(f"{len(self.missing):,} files are missing")
        if self.unreadable:
            found.append(f"{len(self.unreadable):,} of {self.n_tried:,} pairs cannot be read")
        if self.values is None:
            found.append("no pixel of any pair has a known depth")
        return found + self.implausible

    @property
    def implausible(self) -> list[str]:
        """Problems that are about the values of depth."""
        return self.doubts.impossible if self.unit_known else self.doubts.named


def check(
    dataset: Samples,
    *,
    every: bool = False,
    track: Callable[[Sequence[int]], Iterable[int]] = iter,
    looking: Callable[[int, int], None] = lambda done, total: None,
) -> Report:
    """Look at the files of a data set, read some or all of its pairs, and report what there is.

    Args:
        dataset: the data; open it with ``allow_missing`` and ``keep_missing`` to have everything reported that is
            missing.
        every: read every pair, not just ``N_READ`` of them.
        track: gets the indices to read, gives them on, and shows progress.
        looking: called while files are looked at, with the number of pairs that are done, and of all.

    Raises:
        MissingExtraError: a format needs a library that is not installed.
    """
    complete, missing, n_without_truth = _survey(dataset)
    whole = set(complete)
    broken = {} if every else {i: text for i, text in find_broken(dataset, progress=looking).items() if i in whole}
    chosen = complete if every else evenly([i for i in complete if i not in broken], N_READ)
    sizes: Counter[tuple[int, int]] = Counter()
    kinds: set[Target] = set()
    readable, unreadable, empty, shares, spread, glances = [], list(broken.values()), [], [], [], []
    least, greatest, n_cameras = np.inf, -np.inf, 0
    outlines: list[Edges] = []
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
        if sample.kind == "depth":
            glances.append(glance(depth_file(dataset, index, sample), sample.domain, values))
            if len(outlines) < MOST and shares[-1] >= SPARSE and (found_edges := edges_of(sample)) is not None:
                outlines.append(found_edges)
    found = None
    if spread:
        low, median, high = (float(value) for value in np.percentile(np.concatenate(spread), (1, 50, 99)))
        found = Values(least, low, median, high, greatest)
    return Report(
        kind=min(kinds, default=None),
        n_pairs=len(dataset),
        n_expected=dataset.about.splits[dataset.split] if isinstance(dataset, PublishedDataset) else None,
        n_without_truth=n_without_truth,
        missing=tuple(missing),
        n_tried=len(complete) if hasattr(dataset, "pairs") else len(readable) + len(unreadable),
        readable=tuple(readable),
        unreadable=tuple(unreadable),
        photo_sizes=dict(sizes.most_common()),
        values=found,
        known=float(np.mean(shares)) if shares else 0.0,
        empty=tuple(empty),
        n_cameras=n_cameras,
        doubts=doubts(glances, max_depth=getattr(dataset, "max_depth", None)),
        unit_known=_knows_unit(dataset),
        registration=register(outlines),
    )


def doubt_depth(dataset: Samples) -> Doubts:
    """Judge the depth of a data set by ``N_DOUBTED`` of its maps; it is believed where the reader knows the unit."""
    if _knows_unit(dataset):
        return Doubts()
    glances = []
    for index in evenly(range(len(dataset)), N_DOUBTED):
        try:
            sample = dataset[index]
        except InputError:
            continue  # whoever uses it says why
        if sample.kind == "depth" and sample.mask.any():
            values = sample.target[sample.mask].numpy()
            glances.append(glance(depth_file(dataset, index, sample), sample.domain, values))
    return doubts(glances, max_depth=getattr(dataset, "max_depth", None))


def _knows_unit(dataset: Samples) -> bool:
    return isinstance(dataset, PublishedDataset | SyntheticScenes)


def edges_of(sample: Sample) -> Edges | None:
    """Find the edges of a sample with depth, see ``registration.edges``."""
    return edges(sample.image.numpy(), torch.where(sample.mask, sample.target, 0)[0].numpy())


def contact_sheet(dataset: Samples, indices: Sequence[int]) -> ImageArray:
    """Draw each photo beside its depth, with a bar of its own. Unknown is grey; disparity is in percent of its range.

    Args:
        dataset: has at least one readable pair.
        indices: pairs that can be read, from ``Report.readable``; ``N_SHOWN`` of them are drawn, evenly spread.
    """
    pairs = [_panels(dataset[index]) for index in evenly(indices, N_SHOWN)]
    # Two pairs beside each other; pairs of wide photos below each other.
    per_row = 1 if any(photo.shape[1] > 2 * photo.shape[0] for photo, _ in pairs) else 2
    return sheet([[item for pair in pairs[i : i + per_row] for item in pair] for i in range(0, len(pairs), per_row)])


def evenly(indices: Sequence[int], n: int) -> list[int]:
    """Return ``n`` of the indices, evenly spread, with the first and the last; all where there are no more."""
    if len(indices) <= n:
        return list(indices)
    return [indices[round(i * (len(indices) - 1) / max(n - 1, 1))] for i in range(n)]


def _survey(dataset: Samples) -> tuple[list[int], list[Path], int]:
    """Return (pairs that have all their files and a truth, missing files, number of pairs without truth)."""
    if not isinstance(dataset, PublishedDataset | PairDataset):
        return list(range(len(dataset))), [], 0
    missing = list(dict.fromkeys(dataset.missing_files()))
    gone = set(missing)
    bare = sum(pair.target is None for pair in dataset.pairs)
    complete = [i for i, pair in enumerate(dataset.pairs) if pair.target is not None and gone.isdisjoint(pair.files)]
    return complete, missing, bare


def depth_file(dataset: Samples, index: int, sample: Sample) -> str:
    """Return the file of a pair's depth, or the name of the sample where it has none of its own."""
    if isinstance(dataset, PublishedDataset | PairDataset):
        return str(dataset.pairs[index].target)
    return sample.name


def _photo_size(dataset: Samples, index: int, sample: Sample) -> tuple[int, int]:
    """Return the size of the photo in its file; the sample has the size of the depth."""
    if isinstance(dataset, PublishedDataset):
        photo = dataset.read_photo(dataset.pairs[index])
        return photo.shape[0], photo.shape[1]
    return sample.image.shape[1], sample.image.shape[2]


def _panels(sample: Sample) -> tuple[ImageArray, ImageArray]:
    """Draw the photo and the target of a pair, at one size."""
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
    """Gather scattered points on a grid so coarse that each cell has about one; single pixels could not be seen."""
    share = float(np.isfinite(target).mean())
    size = tuple(max(1, round(side * share**0.5)) for side in target.shape)
    coarse = np.full(size, np.nan, np.float32)
    rows, columns = np.nonzero(np.isfinite(target))
    coarse[rows * size[0] // target.shape[0], columns * size[1] // target.shape[1]] = target[rows, columns]
    return coarse


def _shortened(name: str, width: int) -> str:
    """Shorten a name to fit above a picture ``width`` pixels wide, keeping its end, which says more."""
    most = max(8, width // 8)
    return name if len(name) <= most else f"...{name[3 - most :]}"
