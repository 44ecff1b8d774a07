"""``zoedepth train RECIPE --data NAME=SOURCE ... --out DIR``, and ``zoedepth train finetune``."""

import argparse
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.table import Table

from zoedepth.commands.data import named_sources
from zoedepth.config import BaselineConfig
from zoedepth.errors import InputError
from zoedepth.presets import with_encoder, with_head
from zoedepth.recipes import RECIPES
from zoedepth.train.config import TrainConfig

if TYPE_CHECKING:
    from zoedepth.train.finetune import Plan


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
    head: str | None = None
    """Another metric head than the recipe's: attractor, splitter, pixelbins, dorn, newcrfs, naive, adabins or bts, as
    the paper compares it; its own fields are then under --config.model.head."""
    encoder: str | None = None
    """Another encoder than the recipe's, by its timm name; of a baseline, any that gives maps at its strides."""
    config: TrainConfig = field(default_factory=RECIPES["zoed_lite"])
    """The recipe; every field can be overridden."""


_USAGE = f"""usage: zoedepth train finetune --data SOURCE --out DIR     your own photos with depth
       zoedepth train RECIPE --data NAME=SOURCE ... --out DIR [--init WEIGHTS] [--head HEAD] [--encoder ENCODER]
                      [--config.FIELD VALUE]

recipes: {", ".join(RECIPES)}     (zoedepth train RECIPE --help for all fields)"""


def train(arguments: Sequence[str]) -> int:
    """Train a recipe; what stands in --out is gone on with."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_USAGE)
        return 0 if arguments else 2
    name, *rest = arguments
    if name == "finetune":
        return tyro.cli(finetune, args=rest, prog="zoedepth train finetune")
    if name not in RECIPES:
        raise InputError(f"there is no recipe {name!r}; there are {sorted(RECIPES)}")
    config = _with_parts(RECIPES[name](), rest)
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


def _with_parts(config: TrainConfig, arguments: Sequence[str]) -> TrainConfig:
    """The recipe with the head and the encoder that the command line names: the fields that can be set depend on them.

    Raises:
        InputError: there are no such, or the recipe's model cannot have them.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--head")
    parser.add_argument("--encoder")
    chosen, _ = parser.parse_known_args(arguments)
    model = config.model
    if isinstance(model, BaselineConfig):
        if chosen.head is not None:
            raise InputError("a baseline has the head it has; --head is for the recipes of ZoeDepth")
        if chosen.encoder is not None:
            model = replace(model, network=replace(model.network, encoder=chosen.encoder))
        return replace(config, model=model)
    if chosen.encoder is not None:
        model = with_encoder(model, chosen.encoder)
    return replace(config, model=model if chosen.head is None else with_head(model, chosen.head))


def finetune(
    *,
    data: tuple[str, ...],
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    init: str = "zoed-lite",
    domain: str | None = None,
    depth_scale: float | None = None,
    holdout: int | None = None,
    steps: int | None = None,
    batch_size: int | None = None,
    learning_rate: float | None = None,
    seed: int = 43,
    devices: int | None = None,
    nodes: int = 1,
) -> int:
    """Go on training a model on photos with depth of your own, with defaults that fit them.

    It looks at the data first and says what it found and chose; out/data.jpg shows some of it. The last pairs are held
    out: the model is measured on them before and after. A domain the model does not have gets a head of its own.
    Scattered depth, as lidar's, is fine. An interrupted run goes on when the command is typed again.

    Args:
        data: SOURCE or NAME=SOURCE: lists, folders, shards, hf:OWNER/NAME (docs/your-data.md); several are mixed.
        out: folder for model.safetensors, its card README.md, metrics.json, data.jpg, and the run itself.
        init: model to start from: a name of `zoedepth models`, a file or folder of weights, a Hugging Face id.
        domain: scene type of photos whose data says none: indoor, outdoor or your own.
        depth_scale: stored value of one metre in PNGs, where the data says none.
        holdout: pairs held out, the last of each set; None: a seventh, at most 50.
        steps: optimizer steps; None: by the number of pairs.
        batch_size: samples a step; None: 4.
        learning_rate: highest rate; None: by the kind of encoder.
        seed: of the order of the data and the augmentations.
        devices: processes on this machine; under torchrun, its own number.
        nodes: machines.
    """
    from zoedepth.train.finetune import finetune as run
    from zoedepth.train.finetune import plan as make_plan

    console = Console(stderr=True, highlight=False)
    plan = make_plan(
        named_sources(data), init=init, out=out, domain=domain, depth_scale=depth_scale, holdout=holdout, steps=steps,
        batch_size=batch_size, learning_rate=learning_rate, seed=seed,
    )  # fmt: skip
    for line in _described(plan, out):
        console.print(line, soft_wrap=True, markup=False)
    measured = run(plan, out=out, devices=devices, n_nodes=nodes)
    if int(os.environ.get("RANK", "0")):
        return 0
    table = Table("held out", "pairs", "model", "REL", "RMSE (m)", "delta1", title="Before and after")
    for name, pair in measured.items():
        for summary in pair:
            found = summary.metrics
            cells = (
                ("not run",) * 3 if found is None else (f"{found.rel:.3f}", f"{found.rmse:.3f}", f"{found.delta1:.3f}")
            )
            table.add_row(name, str(summary.n_scored), summary.source, *cells)
    Console(highlight=False).print(table)
    print(out / "model.safetensors")
    return 0


def _described(plan: "Plan", out: Path) -> Iterator[str]:
    """What was found and chosen, in words."""
    config = plan.config
    for name, found in plan.surveys.items():
        height, width = found.sizes[0]
        others = f" and {len(found.sizes) - 1} other sizes" if len(found.sizes) > 1 else ""
        kind = "scattered points" if found.sparse else "dense"
        ranges = ", ".join(f"{domain} {found.near[domain]:.2f} to {found.far[domain]:.1f} m" for domain in found.near)
        yield (
            f"{name}: {found.n} pairs, {width}x{height}{others}; depth known at {found.known:.0%} ({kind}); {ranges}. "
            f"The last {config.holdout} are held out."
        )
    heads = ", ".join(f"{domain.name} (to {domain.max_depth:g} m)" for domain in config.model.domains)
    yield (
        f"From {plan.init}, heads {heads}: {config.steps} steps of {config.batch_size}, at "
        f"{config.model.size[1]}x{config.model.size[0]}, learning rate {config.optim.learning_rate:g}."
    )
    if plan.new_domains and plan.unseen_domains:
        yield (
            f"There is no photo of {', '.join(plan.unseen_domains)} in the data: the router will learn to send all to "
            f"{', '.join(plan.new_domains)}. Add some with another NAME=SOURCE, or say the domain when predicting."
        )
    yield f"A picture of the data: {out / 'data.jpg'}"
