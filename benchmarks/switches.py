"""What each switch of the protocol does to the numbers of one model, on the same images, in one run.

    python -m benchmarks.switches --data nyu=nyu/test.csv kitti=kitti/test.csv [--model zoed-lite] [--processes 2]

``--every 6`` takes every sixth image of each set only.

Prints one Markdown table a metric: a row a switch, a column a data set. Predictions that differ only in how they are
scored are made once.
"""

from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import torch
import tyro

from zoedepth.commands.data import named_paths
from zoedepth.data.pairs import PairDataset
from zoedepth.evaluation.predictions import ModelSource, prepare
from zoedepth.evaluation.protocols import protocol_of
from zoedepth.evaluation.scoring import aligned_depth, scored_pixels
from zoedepth.metrics import Sums, mean_metrics, pixel_sums, pooled_metrics
from zoedepth.weights.load import load_model

SWITCHES: dict[str, Mapping[str, object]] = {
    "as is": {},
    "no mirror average": {"flip_average": False},
    "padded": {"pad": True},
    "squeezed to the trained size": {"resize": "squeeze"},
    "no crop": {"crop": "none"},
    "cap 5 m (indoor), 50 m (outdoor)": {"max_depth": (5.0, 50.0)},
    "mean over pixels": {"mean": "pixels"},
    "median-aligned (not metric)": {"alignment": "median"},
}
PREDICTED_ANEW = {"flip_average", "pad", "resize"}


def main(*, data: tuple[str, ...], model: str = "zoed-lite", processes: int = 2, every: int = 1) -> None:
    """Score every switch on every data set."""
    columns = {name: _column(path, model, processes, every) for name, path in named_paths(data).items()}
    for metric in ("rel", "rmse", "delta1"):
        print(f"\n| {metric} | {' | '.join(columns)} |\n|---|{'---:|' * len(columns)}")
        for switch in SWITCHES:
            cells = (f"{getattr(column[switch], metric):.3f}" for column in columns.values())
            print(f"| {switch} | {' | '.join(cells)} |", flush=True)


def _column(path: Path, model: str, processes: int, every: int) -> dict:
    indices = range(0, len(PairDataset(path, split="test")), every)
    with ProcessPoolExecutor(
        processes, mp_context=get_context("spawn"), initializer=_start, initargs=(path, model)
    ) as pool:
        images = list(pool.map(_one, indices, chunksize=4))
    found = {}
    for switch, values in SWITCHES.items():
        sums = [Sums(**image[switch]) for image in images if image[switch] is not None]
        if values.get("mean") == "pixels":
            found[switch] = pooled_metrics(sums)
        else:
            found[switch] = mean_metrics([one.metrics() for one in sums])
    return found


def _start(path: Path, model: str) -> None:
    global _dataset, _source
    torch.set_num_threads(1)
    _dataset, _source = PairDataset(path, split="test"), ModelSource(load_model(model))


def _one(index: int) -> dict[str, dict | None]:
    """The sums of one image under every switch."""
    sample = _dataset[index]
    base = protocol_of(sample.domain)
    shown = prepare(sample, base)
    predictions, found = {}, {}
    for switch, values in SWITCHES.items():
        changes = {name: value[sample.domain != "indoor"] if isinstance(value, tuple) else value
                   for name, value in values.items()}  # fmt: skip
        protocol = replace(base, **changes)
        key = tuple(getattr(protocol, name) for name in sorted(PREDICTED_ANEW))
        if key not in predictions:
            predictions[key] = _source.predict(shown, protocol)
        truth, scored = shown.target[0].numpy(), scored_pixels(shown, protocol)
        if not scored.any():
            found[switch] = None
            continue
        depth = aligned_depth(predictions[key], truth, scored, protocol)
        found[switch] = vars(pixel_sums(depth[scored], truth[scored]))
    return found


if __name__ == "__main__":
    tyro.cli(main)
