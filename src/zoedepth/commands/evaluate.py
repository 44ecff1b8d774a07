"""``zoedepth evaluate --model MODEL --data CSV``."""

import json
import sys
from dataclasses import asdict, replace
from typing import Annotated, Literal

import tyro

from zoedepth.commands.data import named_paths
from zoedepth.errors import InputError


def evaluate(
    *,
    data: tuple[str, ...],
    model: str = "zoed-lite",
    crop: Literal["auto", "none", "eigen", "garg"] = "auto",
    max_depth: float | None = None,
    flip: bool = True,
    compat: tuple[str, ...] = (),
    json_: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Score a model on photos with known depth.

    The protocol follows from the domain in the CSV file: indoor is NYU's (Eigen crop, 10 m), outdoor KITTI's (KB crop,
    then Garg crop, 80 m).

    Args:
        data: CSV files, or folders with a test.csv; PATH or NAME=PATH.
        model: a name of `zoedepth models`, a file or folder of weights, or a Hugging Face id.
        crop: part of the picture that is scored.
        max_depth: cap, metres.
        flip: average with the prediction for the mirror image.
        compat: behaviours of the original code to take over: batch-vote, 10m, squeeze.
        json_: print one JSON object for each data set, and nothing else.
    """
    from rich.console import Console
    from rich.progress import track
    from rich.table import Table

    from zoedepth.data.pairs import PairDataset
    from zoedepth.evaluation.evaluate import evaluate as evaluate_model
    from zoedepth.evaluation.protocols import protocol_of
    from zoedepth.metrics import mean_metrics
    from zoedepth.pretrained import load_model

    network = load_model(model, compat=compat)
    if not network.config.domains:
        raise InputError(f"{model} gives relative depth only, in which there are no metres to score")
    console = Console(stderr=True)
    table = Table("data", "images", "REL", "RMSE", "log10", "delta1", "delta2", "delta3", "router", title=f"{model}")
    for name, path in named_paths(data).items():
        dataset = PairDataset(path, split="test")
        if "disparity" in dataset.kinds:
            raise InputError(f"{dataset.path} has disparity, in which there are no metres to score")
        groups = {}
        for domain in dataset.domains:
            protocol = replace(protocol_of(domain), flip_average=flip)
            if crop != "auto":
                protocol = replace(protocol, crop=crop)
            groups[domain] = protocol if max_depth is None else replace(protocol, max_depth=max_depth)
        scores, right = [], []
        indices = track(range(len(dataset)), description=name, console=console, disable=not console.is_terminal)
        for index in indices:
            sample = dataset[index]
            score = next(evaluate_model(network, [sample], groups[sample.domain]))
            scores.append(score.metrics)
            right.append(score.domain == sample.domain)
        scored = [metrics for metrics in scores if metrics is not None]
        means = asdict(mean_metrics(scored))
        router = sum(right) / len(right) if len(network.config.domains) > 1 else None
        record = {**means, "images": len(scored), "without_truth": len(scores) - len(scored), "router": router}
        if json_:
            print(json.dumps({"data": name, **record} if len(data) > 1 else record))
        cells = [f"{value:.3f}" for value in means.values()]
        table.add_row(name, str(len(scored)), *cells, "-" if router is None else f"{100 * router:.1f} %")
    if not json_:
        Console(file=sys.stdout).print(table)
    return 0
