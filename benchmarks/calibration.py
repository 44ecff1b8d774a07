"""What calibration by a few readings reaches, on photos whose depth was measured, and whether its stated error holds.

    python -m benchmarks.calibration --data kitchen=kitchen/test.csv kitti=kitti/test.csv [--model zoed-lite]

Readings are true depths at pixels drawn evenly from those that the protocol scores. One in ten is made wrong by a
factor of 2, 3.28 (feet for metres) or 10, to either side. Each photo is predicted once. REL is that of a whole photo,
averaged over the draws; "reach" is its fall over that by the factor that makes the medians of prediction and truth
equal.

``python -m benchmarks calibration`` looks for the three lists of the documentation below the folder ``data``.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import tyro

from zoedepth.calibration import Calibration, Point, calibrate
from zoedepth.commands.data import named_paths
from zoedepth.data.pairs import PairDataset
from zoedepth.evaluation.predictions import ModelSource, Prediction, prepare
from zoedepth.evaluation.protocols import Protocol, protocol_of
from zoedepth.evaluation.scoring import aligned_depth, scored_pixels
from zoedepth.metrics import pixel_sums
from zoedepth.weights.load import load_model

NUMBERS = (1, 3, 10)
"""Numbers of readings."""
WRONG = (1 / 10, 1 / 3.28, 1 / 2, 2.0, 3.28, 10.0)
"""Factors of wrong readings."""


@dataclass(frozen=True, eq=False)
class Photo:
    """A predicted photo, its truth, and which pixels count."""

    depth: np.ndarray
    truth: np.ndarray
    scored: np.ndarray
    protocol: Protocol

    def rel(self, depth: np.ndarray) -> float:
        """Return REL of a depth map."""
        clipped = aligned_depth(Prediction(depth), self.truth, self.scored, self.protocol)
        return pixel_sums(clipped[self.scored], self.truth[self.scored]).metrics().rel

    def readings(self, pixels: np.ndarray) -> list[Point]:
        """Return the truth at some of the scored pixels."""
        rows, columns = (places[pixels] for places in np.nonzero(self.scored))
        return [(float(x), float(y), float(self.truth[y, x])) for x, y in zip(columns, rows, strict=True)]


@dataclass
class Draws:
    """The measurements of all draws with as many readings."""

    rel: list[float] = field(default_factory=list)
    elsewhere: list[float] = field(default_factory=list)
    """REL of another photo of the set, with the same calibration."""
    scale_covered: list[bool] = field(default_factory=list)
    scale_error: list[float] = field(default_factory=list)
    pixel_covered: list[bool] = field(default_factory=list)
    expected_error: list[float] = field(default_factory=list)
    n_left_out: list[int] = field(default_factory=list)
    n_wrong_named: int = 0


def main(
    *,
    data: tuple[str, ...] = tuple(f"{name}=data/{name}/test.csv" for name in ("kitchen", "apartment", "kitti")),
    model: str = "zoed-lite",
    draws: int = 200,
    seed: int = 0,
) -> None:
    """Measure, and print Markdown tables: REL, and how often the truth lies within the stated errors.

    Args:
        data: NAME=LIST of photos with depth.
        model: a name of `zoedepth models`, or a file of weights.
        draws: draws of readings for each set.
        seed: of the draws.
    """
    lists = {name: path for name, path in named_paths(data).items() if path.exists()}
    if not lists:
        print(f"none of these lists is there: {', '.join(data)}. Give --data NAME=LIST")
        return
    source = ModelSource(load_model(model))
    tables: dict[str, list[str]] = {"this": [], "other": [], "errors": [], "named": []}
    for name, path in lists.items():
        photos = predict(source, PairDataset(path, split="test"))
        before, aligned, found = measure(photos, draws=draws, generator=np.random.default_rng(seed))
        cells = [f"{before:.3f}", f"{aligned:.3f}"]
        for number in NUMBERS:
            rel = float(np.mean(found[str(number)].rel))
            cells.append(f"{rel:.3f}{_reach(before, aligned, rel)}")
        one, ten, wrong = found["1"], found["10"], found["wrong"]
        change = np.mean(wrong.rel) / np.mean(ten.rel) - 1
        cells += [f"{np.mean(wrong.rel):.3f} ({change:+.1%})", f"{np.mean(found['scale-shift'].rel):.3f}"]
        tables["this"].append(f"| {name} | {' | '.join(cells)} |")
        cells = [f"{np.mean(draw.elsewhere):.3f}" for draw in (one, ten, found["camera"])]
        tables["other"].append(f"| {name} | {before:.3f} | {' | '.join(cells)} |")
        cells = []
        for draw in (*(found[str(number)] for number in NUMBERS), found["camera"]):
            cells.append(f"{np.median(draw.scale_error):.0%}: {np.mean(draw.scale_covered):.0%}")
            cells.append(f"{np.median(draw.expected_error):.0%}: {np.mean(draw.pixel_covered):.0%}")
        tables["errors"].append(f"| {name} | {' | '.join(cells[:6])} | {cells[7]} |")
        cells = [f"{found['wrong'].n_wrong_named / draws:.0%}", f"{np.mean(ten.n_left_out) / 10:.1%}"]
        tables["named"].append(f"| {name} | {' | '.join(cells)} |")
    heads = {
        "this": "REL of the photo | before | median-aligned | 1 reading (reach) | 3 | 10 | 1 of 10 wrong (change) "
        "| 10, scale-shift",
        "other": "REL of another photo | before | 1 reading | 10 | 3 in each of five photos",
        "errors": "stated error: truth within | 1: scale | 1: pixel | 3: scale | 3: pixel | 10: scale | 10: pixel "
        "| five photos: pixel",
        "named": "left out | the wrong one of 10 | each of 10 true ones",
    }
    for kind, head in heads.items():
        print(f"\n| {head} |\n|---|{head.count('|') * '---:|'}", *tables[kind], sep="\n")


def predict(source: ModelSource, data: PairDataset) -> list[Photo]:
    """Predict every photo once, by the protocol of its domain."""
    photos = []
    for index in range(len(data)):
        protocol = protocol_of(data[index].domain)
        sample = prepare(data[index], protocol)
        scored = scored_pixels(sample, protocol)
        if scored.any():
            depth = source.predict(sample, protocol).depth
            photos.append(Photo(depth, sample.target[0].numpy(), scored, protocol))
    return photos


def measure(
    photos: Sequence[Photo], *, draws: int, generator: np.random.Generator
) -> tuple[float, float, Mapping[str, Draws]]:
    """Return REL as it is, with the medians aligned, and what was found by draws of each kind."""
    before = [photo.rel(photo.depth) for photo in photos]
    ratios = [np.median(photo.truth[photo.scored]) / np.median(photo.depth[photo.scored]) for photo in photos]
    aligned = [photo.rel(photo.depth * ratio) for photo, ratio in zip(photos, ratios, strict=True)]
    found = {name: Draws() for name in (*map(str, NUMBERS), "wrong", "scale-shift", "camera")}
    order = [number % len(photos) for number in range(draws)]
    for index in order:
        photo = photos[index]
        other = photos[(index + int(generator.integers(1, len(photos)))) % len(photos)] if len(photos) > 1 else photo
        readings = photo.readings(generator.integers(np.count_nonzero(photo.scored), size=max(NUMBERS)))
        witness = int(generator.integers(np.count_nonzero(photo.scored)))
        for number in NUMBERS:
            calibration = calibrate(photo.depth, readings[:number])
            _note(found[str(number)], calibration, photo, other, witness)
        x, y, metres = readings[0]
        wrong = calibrate(photo.depth, [(x, y, metres * float(generator.choice(WRONG))), *readings[1:]])
        _note(found["wrong"], wrong, photo, other, witness)
        found["wrong"].n_wrong_named += wrong.readings[0].outlier
        _note(found["scale-shift"], calibrate(photo.depth, readings, form="scale-shift"), photo, other, witness)
        _note(found["camera"], camera_of(photos, generator), photo, other, witness)
    return float(np.mean([before[i] for i in order])), float(np.mean([aligned[i] for i in order])), found


def camera_of(photos: Sequence[Photo], generator: np.random.Generator) -> Calibration:
    """Return the calibration by three readings in each of five photos."""
    calibration = None
    for index in generator.permutation(len(photos)).tolist()[:5]:
        readings = photos[index].readings(generator.integers(np.count_nonzero(photos[index].scored), size=3))
        calibration = calibrate(photos[index].depth, readings, photo=str(index), earlier=calibration)
    assert calibration is not None
    return calibration


def _note(draws: Draws, calibration: Calibration, photo: Photo, other: Photo, witness: int) -> None:
    depth = calibration.apply(photo.depth)
    factors = photo.truth[photo.scored].astype(np.float64) / depth[photo.scored]
    draws.rel.append(photo.rel(depth))
    draws.elsewhere.append(other.rel(calibration.apply(other.depth)))
    draws.scale_covered.append(abs(math.log(np.median(factors))) <= math.log1p(calibration.scale_error))
    draws.scale_error.append(calibration.scale_error)
    draws.pixel_covered.append(abs(math.log(factors[witness])) <= math.log1p(calibration.expected_error))
    draws.expected_error.append(calibration.expected_error)
    draws.n_left_out.append(len(calibration.outliers))


def _reach(before: float, aligned: float, after: float) -> str:
    """Return the share of what aligning the medians reaches, where it reaches anything."""
    return f" ({(before - after) / (before - aligned):.0%})" if before - aligned > 0.005 else ""


if __name__ == "__main__":
    tyro.cli(main)
