"""``zoedepth demo-train``: train both stages on rendered scenes; a model and a picture after minutes."""

import json
import shutil
import time
from pathlib import Path
from statistics import fmean
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from zoedepth.commands.progress import track
from zoedepth.folders import check_writable
from zoedepth.images import atomic_path
from zoedepth.outputs.ownership import require_own_mark
from zoedepth.recipes import demo


def demo_train(
    *, out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("demo-train"), scenes: int = 160, seed: int = 0
) -> int:
    """Train a tiny model in both stages on rendered rooms and streets, without data and without a download.

    Type the same command again to go on after an interruption.

    Args:
        out: folder for the scenes, both runs, and predictions.jpg.
        scenes: number of scenes to render; the last twelve are held out.
        seed: seed of the scenes.
    """
    from zoedepth.opening import open_dataset
    from zoedepth.shards.writer import ShardSize, write_shards
    from zoedepth.train.metric import train_metric
    from zoedepth.train.processes import require_libraries
    from zoedepth.train.relative import train_relative

    require_libraries()  # said before scenes are rendered
    check_writable(out, option="--out")
    picture = out / "predictions.jpg"
    require_own_mark(picture, advice="move it, or give another --out")
    console = Console(stderr=True, highlight=False)
    began = time.monotonic()
    console.print(f"Rendering {scenes} scenes")
    height, width = demo.relative().model.size
    rendered = open_dataset(f"synthetic:all?n={scenes}&seed={seed}&size={height}x{width}")
    write_shards(
        rendered,
        out / "scenes",
        name="scenes",
        size=ShardSize(samples=40),
        workers=2,
        track=lambda samples, first: track(samples, "scenes", total=scenes, first=first, console=console),
    )
    data = {"scenes": out / "scenes"}
    console.print("Stage 1: relative depth")
    first = train_relative(demo.relative(), data=data, out=out / "relative", init="imagenet")
    console.print("Stage 2: metric depth")
    last = train_metric(demo.metric(), data=data, out=out / "metric", init=str(first))

    table = Table("stage", "loss, first steps", "loss, last steps", "held-out scenes", title="Two stages")
    for stage, loss, measure in (("relative", "ssi", "disparity_rmse"), ("metric", "silog", "rel")):
        lines = [json.loads(line) for line in (out / stage / "log.jsonl").read_text(encoding="utf-8").splitlines()]
        losses = [line[f"train/{loss}"] for line in lines if f"train/{loss}" in line]
        held_out = [line[f"validation/scenes/{measure}"] for line in lines if f"validation/scenes/{measure}" in line]
        label = "disparity RMSE" if measure == "disparity_rmse" else "REL"
        change = f"{label} {held_out[0]:.3f} → {held_out[-1]:.3f}"
        table.add_row(stage, f"{fmean(losses[:3]):.3f}", f"{fmean(losses[-3:]):.3f}", change)
    Console(highlight=False).print(table)
    with atomic_path(picture) as part:
        shutil.copyfile(sorted((out / "metric/pictures").glob("*.jpg"))[-1], part)
    console.print(f"{time.monotonic() - began:.0f} s. Pictures: {picture}; the model: {last}")
    return 0
