"""``zoedepth train RECIPE --data NAME=PATH ... --out DIR``."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import tyro

from zoedepth.commands.data import named_sources
from zoedepth.errors import InputError
from zoedepth.recipes import RECIPES
from zoedepth.train.config import TrainConfig


@dataclass(frozen=True)
class Run:
    """What a run needs beside its recipe."""

    data: tuple[str, ...]
    """NAME=SOURCE of each data set: NAME is a source of the recipe; SOURCE is a list, a folder, shards, a published
    data set's folder, hf:OWNER/NAME or synthetic:all (docs/your-data.md)."""
    out: Path
    """The run's folder: checkpoints, log.jsonl, TensorBoard. An unfinished run in it goes on."""
    init: str | None = None
    """Starting weights: "imagenet", a model's name, a .safetensors file or the folder of a checkpoint."""
    devices: int | None = None
    """Processes on this machine, one a GPU (or, on the CPU, one a group of cores); under torchrun, its own number."""
    nodes: int = 1
    """Machines."""
    config: TrainConfig = field(default_factory=RECIPES["zoed_lite"])
    """The recipe; every field can be overridden."""


def train(arguments: Sequence[str]) -> int:
    """Train a recipe; what stands in --out is gone on with."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print("usage: zoedepth train RECIPE --data NAME=PATH ... --out DIR [--init WEIGHTS] [--config.FIELD VALUE]")
        print(f"\nrecipes: {', '.join(RECIPES)}     (zoedepth train RECIPE --help for all fields)")
        return 0 if arguments else 2
    name, *rest = arguments
    if name not in RECIPES:
        raise InputError(f"there is no recipe {name!r}; there are {sorted(RECIPES)}")
    config = RECIPES[name]()
    run = tyro.cli(
        Run,
        args=rest,
        prog=f"zoedepth train {name}",
        default=Run(data=tyro.MISSING, out=tyro.MISSING, config=config),
        config=(tyro.conf.AvoidSubcommands,),
    )
    if run.config.stage == "relative":
        from zoedepth.train.relative import train_relative as run_stage
    else:
        from zoedepth.train.metric import train_metric as run_stage
    last = run_stage(
        run.config, data=named_sources(run.data), out=run.out, init=run.init, devices=run.devices, n_nodes=run.nodes
    )
    print(last)
    return 0
