"""``zoedepth train RECIPE --data NAME=SOURCE ... --out DIR``, and ``zoedepth train finetune``."""

import argparse
import sys
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import tyro
from rich.console import Console
from rich.table import Table

from zoedepth.commands.data import named_sources
from zoedepth.commands.options import WIDTH, call, read
from zoedepth.config import BaselineConfig, ModelConfig
from zoedepth.errors import InputError, no_such
from zoedepth.folders import check_writable
from zoedepth.presets import with_encoder, with_focal_of_size, with_head
from zoedepth.recipes import RECIPES
from zoedepth.train.config import Check, FinetuneOptions, TrainConfig

if TYPE_CHECKING:
    from zoedepth.train.finetune import Plan
    from zoedepth.train.survey import Survey


_Value = TypeVar("_Value")
_Given = Annotated[_Value | None, tyro.conf.DisallowNone, tyro.conf.arg(help_behavior_hint="")]
"""The type of an option that may be left out, without "(default: None)" in the help, which says nothing."""


@dataclass(frozen=True)
class TrainOptions:
    """Train a recipe on data sets; an unfinished run in --out goes on."""

    data: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=SOURCE...")]
    """NAME=SOURCE of each data set: NAME is a source of the recipe; SOURCE is a list, a folder, shards, a published
    data set's folder, hf:OWNER/NAME or synthetic:all (docs/your-data.md)."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder of the run: checkpoints, log.jsonl, TensorBoard. An unfinished run in it goes on."""
    init: _Given[str] = None
    """Starting weights: "imagenet", a model's name, a .safetensors file or the folder of a checkpoint."""
    root: _Given[Path] = None
    """The folder that the paths of the lists in --data are relative to; without it that of each list."""
    devices: _Given[int] = None
    """Processes on this machine: one for each GPU, or on the CPU one for each group of cores. Leave it out under
    torchrun."""
    nodes: int = 1
    """Number of machines. Leave it out under torchrun."""
    head: _Given[str] = None
    """Another metric head than the recipe's: attractor, splitter, pixelbins, dorn, newcrfs, naive, adabins or bts, with
    the settings of the paper's comparison. Change its fields with --config.model.head.FIELD."""
    encoder: _Given[str] = None
    """Another encoder than the recipe's, by its timm name. A baseline takes any encoder with maps at its strides."""
    config: TrainConfig = field(default_factory=RECIPES["zoed_lite"])
    """The recipe. Every field can be overridden."""


_COMMON = ("data", "out", "init", "domain", "depth_scale", "root", "steps")
"""Options of a fine-tuning that its help shows first."""

_USAGE = f"""usage: zoedepth train finetune --data SOURCE --out DIR     your own photos with depth
       zoedepth train RECIPE --data NAME=SOURCE ... --out DIR [--init WEIGHTS] [--head HEAD]
                      [--encoder ENCODER] [--config.FIELD VALUE]

zoedepth train finetune --help and zoedepth train RECIPE --help show all options. The recipes:

{textwrap.fill(", ".join(RECIPES), WIDTH, break_on_hyphens=False)}"""


def train(arguments: Sequence[str]) -> int:
    """Train a recipe, or go on with the run in --out."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_USAGE, file=sys.stdout if arguments else sys.stderr)
        return 0 if arguments else 2
    name, *rest = arguments
    if name == "finetune":
        return call(finetune, rest, prog="zoedepth train finetune", common=_COMMON)
    if name not in RECIPES:
        raise no_such("recipe", name, ["finetune", *RECIPES], see="zoedepth train --help")
    config = _with_parts(RECIPES[name](), rest)
    options = read(
        TrainOptions,
        rest,
        prog=f"zoedepth train {name}",
        default=TrainOptions(data=tyro.MISSING, out=tyro.MISSING, config=config),
        config=(tyro.conf.AvoidSubcommands,),
    )
    if options.config.stage == "relative":
        from zoedepth.train.relative import train_relative as train_stage
    else:
        from zoedepth.train.metric import train_metric as train_stage
    _check_router(options.config)
    check_writable(options.out, option="--out")
    from zoedepth.train.processes import is_first

    checkpoint = train_stage(
        _with_root(_with_focal(options.config, config), options.root),
        data=named_sources(options.data),
        out=options.out,
        init=options.init,
        devices=options.devices,
        n_nodes=options.nodes,
    )
    if is_first():
        print(checkpoint)
    return 0


def _check_router(config: TrainConfig) -> None:
    """Refuse an auto router (R.3) that would be given labels: it would be trained as R.2, or not at all."""
    model = config.model
    auto = isinstance(model, ModelConfig) and model.router.kind == "auto" and len(model.domains) > 1
    if auto and config.stage == "metric" and (config.route_by_label or config.domain_weight > 0):
        raise InputError(
            "an auto router learns from the depth alone, without labels: add --config.no-route-by-label and "
            "--config.domain-weight 0, or take the recipe table_6_auto"
        )


def _with_root(config: TrainConfig, root: Path | None) -> TrainConfig:
    """Return the config with this folder for the paths of all lists; None leaves each what it has."""
    if root is None:
        return config
    return replace(config, sources=tuple(replace(source, root=str(root)) for source in config.sources))


def _with_focal(config: TrainConfig, recipe: TrainConfig) -> TrainConfig:
    """Return the config with the focal lengths that belong to its model's size, where that is not the recipe's."""
    if not isinstance(config.model, ModelConfig) or not isinstance(recipe.model, ModelConfig):
        return config
    return replace(config, model=with_focal_of_size(config.model, recipe.model))


def _with_parts(config: TrainConfig, arguments: Sequence[str]) -> TrainConfig:
    """Return the recipe with the head and the encoder that the command line names.

    They are read before all other options, because the fields that can be overridden depend on them.

    Raises:
        InputError: the head or the encoder does not exist, or the recipe's model cannot have it.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--head")
    parser.add_argument("--encoder")
    chosen, _ = parser.parse_known_args(arguments)
    model = config.model
    if isinstance(model, BaselineConfig):
        if chosen.head is not None:
            raise InputError("a baseline's head cannot be changed: --head is for the recipes of ZoeDepth, leave it out")
        if chosen.encoder is not None:
            model = replace(model, network=replace(model.network, encoder=chosen.encoder))
        return replace(config, model=model)
    if chosen.encoder is not None:
        model = with_encoder(model, chosen.encoder)
    return replace(config, model=model if chosen.head is None else with_head(model, chosen.head))


def finetune(
    *,
    data: Annotated[tuple[str, ...], tyro.conf.arg(metavar="SOURCE...")],
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    init: str = FinetuneOptions.init,
    domain: str | None = None,
    depth_scale: float | None = None,
    root: Path | None = None,
    check: Check = FinetuneOptions.check,
    holdout: int | None = None,
    steps: int | None = None,
    batch_size: int | None = None,
    learning_rate: float | None = None,
    seed: int = FinetuneOptions.seed,
    devices: int | None = None,
    nodes: int = 1,
) -> int:
    """Fine-tune a model on photos with depth of your own, with defaults that fit them.

    The command looks at the data first, and says what it found and chose; out/data.jpg shows some of it. The last pairs
    are held out, and the model is measured on them before and after. A domain that the model does not have gets a head
    of its own. Scattered depth, such as lidar's, is fine. Type the same command again to go on after an interruption.

    Args:
        data: SOURCE or NAME=SOURCE: lists, folders, shards, hf:OWNER/NAME (docs/your-data.md); several are mixed.
        out: folder for model.safetensors, its card README.md, metrics.json, data.jpg, and the run itself.
        init: model to start from: a name of `zoedepth models`, a file or folder of weights, a Hugging Face id.
        domain: scene type of the photos, indoor, outdoor or a name of your own: where the data names none, and in place
            of that of dataset.json.
        depth_scale: stored value of one metre in PNGs and other whole numbers, for data that does not name one.
        root: the folder that the paths of the lists in --data are relative to; without it that of each list.
        check: look at the data first. quick: headers, sizes and ends of all files, and the depth of up to 200 pairs.
            full: every pair is read. off: the depth is believed, however implausible; use it for data beyond a
            kilometre or below a centimetre.
        holdout: pairs held out for the comparison, the last of each data set; without it a seventh, at least 1 and at
            most 50.
        steps: optimizer steps; without it, chosen by the number of pairs.
        batch_size: samples in a step; without it 4.
        learning_rate: highest rate; without it, chosen by the kind of encoder.
        seed: seed of the order of the data and the augmentations.
        devices: processes on this machine. Leave it out under torchrun.
        nodes: number of machines. Leave it out under torchrun.
    """
    from zoedepth.train import finetune as finetuning
    from zoedepth.train.log import Ticker, say
    from zoedepth.train.processes import is_first, require_libraries

    require_libraries()  # said before the data is looked at
    console = Console(stderr=True, highlight=False)
    check_writable(out, option="--out")
    options = FinetuneOptions(
        init, domain, depth_scale, check, holdout, steps, batch_size, learning_rate, seed,
        root=None if root is None else str(root),
    )  # fmt: skip
    ticker = Ticker("looking at the data", say)
    plan = finetuning.plan(named_sources(data), options, out=out, progress=ticker)
    for line in _described(plan, out):
        console.print(line, soft_wrap=True, markup=False)
    measured = finetuning.finetune(plan, out=out, devices=devices, n_nodes=nodes)
    if not is_first():
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


def _lenses(found: "Survey") -> str:
    """Say what becomes of the cameras of a data set where the model has a canonical one."""
    degrees = [camera.fov_x for cameras in found.cameras.values() for camera in cameras]
    if not degrees:
        return "no camera is known: all photos are taken to come from the canonical one, and their depth stays."
    low, high = round(min(degrees)), round(max(degrees))
    fields = f"{low}" if low == high else f"{low} to {high}"
    return f"cameras of {fields} degrees from left to right; depth is scaled to the canonical one."


def _described(plan: "Plan", out: Path) -> Iterator[str]:
    """Describe what was found in the data, and what was chosen for it, a line at a time."""
    config = plan.config
    for name, found in plan.surveys.items():
        height, width = found.sizes[0]
        others = f" and {len(found.sizes) - 1} other sizes" if len(found.sizes) > 1 else ""
        kind = "scattered points" if found.sparse else "dense"
        ranges = ", ".join(f"{domain} {found.near[domain]:.2f} to {found.far[domain]:.1f} m" for domain in found.near)
        yield (
            f"{name}: {found.n} pairs, {width}x{height}{others}; depth known at {found.known:.0%} ({kind}); {ranges}. "
            f"The last {config.held_out(name)} are held out."
        )
        if config.model.canonical_camera:
            yield f"{name}: {_lenses(found)}"
        doubts = found.doubts
        if doubts.mark is not None:
            taken = f" It is taken for unknown from {found.max_depth:g} m on." if found.max_depth else ""
            yield f"{name}: warning: {doubts.mark}.{taken}"
        for doubt in doubts.unlikely:
            yield f"{name}: warning: {doubt}"
        for problem in plan.broken[name].values():
            yield f"{name}: skipped: {problem}"
    heads = ", ".join(f"{domain.name} (to {domain.max_depth:g} m)" for domain in config.model.domains)
    yield (
        f"From {plan.init}, heads {heads}: {config.steps} steps of {config.batch_size}, at "
        f"{config.model.size[1]}x{config.model.size[0]}, learning rate {config.optim.learning_rate:g}."
    )
    if plan.new_domains and plan.unseen_domains:
        yield (
            f"There is no photo of {', '.join(plan.unseen_domains)} in the data: the router will learn to send all "
            f"photos to {', '.join(plan.new_domains)}. Add photos of the others with another NAME=SOURCE, or name the "
            "domain when predicting."
        )
    yield f"A picture of the data: {out / 'data.jpg'}"
