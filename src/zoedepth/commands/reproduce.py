"""``zoedepth reproduce TABLE --data NAME=SOURCE ... --out DIR``."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from zoedepth.commands.data import named_sources
from zoedepth.errors import InputError
from zoedepth.folders import check_writable

if TYPE_CHECKING:
    from zoedepth.evaluation.tables import ReportTable
    from zoedepth.reproduction.units import Unit

FIRST_SEED = 43
"""The released code's seed; others follow it."""


def reproduce(
    table: tyro.conf.Positional[str],
    *,
    data: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=SOURCE...")],
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    small: bool = False,
    seeds: int = 1,
    base: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=WEIGHTS...")] = (),
    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ROW...")] = (),
    shard: str = "0/1",
    show: bool = False,
    device: str = "auto",
) -> int:
    """Train and score every row of a table of the paper, and show it as the paper does, its numbers beside.

    TABLE is table-2, table-5, table-6, log-binomial, sum-or-mean, grid, backbones or convergence. The work goes on
    where it was interrupted when the same command is typed again: a finished row is not trained twice, and a result
    belongs to its configuration, data, seed and starting weights. Several commands share the work by --shard, on one
    machine or on many: results/*.json of all of them in one folder, and --show, make the whole table.

    Args:
        table: the comparison.
        data: NAME=SOURCE of the data to train and to score on. A folder with train.csv and test.csv, or a published
            data set, is trained on by one part and scored on by the other. Small: nyu, kitti, relative, scenes
            (synthetic:all, or shards of it). Others that the recipes do not train on are scored only.
        out: folder for runs, results and the table (Markdown, HTML, LaTeX).
        small: the small form, for processors: EfficientNet-Lite encoders, 160x224, 400 steps of 8 photos for each data
            set.
        seeds: trainings of each row; from two on there are intervals.
        base: NAME=WEIGHTS, with N, K, NK or M12 for NAME: weights of this pre-training, in place of training it.
            M12=dpt-beit-large-384 is MiDaS's.
        only: rows to run, by a part of their name; the others are shown as they are.
        shard: i/n: do the share i (from 0) of n.
        show: train nothing, show what there is.
        device: cpu, cuda, mps, or auto for the best there is, where models are scored.
    """
    from rich.console import Console

    from zoedepth.commands.evaluate import print_table
    from zoedepth.commands.progress import track
    from zoedepth.jobs.shard import JobShard
    from zoedepth.reproduction.backbones import plot_backbones
    from zoedepth.reproduction.run import open_scored, read_result, run_unit
    from zoedepth.reproduction.scale import FULL, SMALL
    from zoedepth.reproduction.shown import shown
    from zoedepth.reproduction.tables import find_table, require_known_bases
    from zoedepth.reproduction.units import plan, scored_names, share, trained_content
    from zoedepth.train.processes import require_libraries

    console = Console(stderr=True, highlight=False)

    def say(text: str) -> None:
        console.print(text, soft_wrap=True, markup=False)

    chosen, scale, part = find_table(table), SMALL if small else FULL, JobShard.parse(shard)
    if seeds < 1:
        raise InputError(f"--seeds is {seeds}: give at least 1")
    bases = {name: _absolute(source) for name, source in named_sources(base).items()}
    require_known_bases(bases)
    if not show:
        require_libraries()  # said before data are opened
    out = out.absolute()
    check_writable(out, option="--out")
    reports = [f"{table}-{scale.name}.{suffix}" for suffix in ("md", "html", "tex", "png")]
    if not (out / "results").is_dir() and (others := [name for name in reports if (out / name).exists()]):
        raise InputError(
            f"{out / others[0]} is not of a reproduction, and would be replaced: give another --out, or move it"
        )
    given = {name: _absolute(source) for name, source in named_sources(data).items()}
    units = plan(chosen, scale, given, seeds=range(FIRST_SEED, FIRST_SEED + seeds), bases=bases)
    names = scored_names(chosen, units, given)
    scored = open_scored({name: given[name] for name in names})
    if same := [name for name in scored if scored[name].content in trained_content(units, given, name)]:
        raise InputError(
            f"{same[0]}={given[same[0]]} would be trained on and scored on the same pairs: give a folder with "
            "train.csv and test.csv, or a published data set"
        )
    if all(unit.training is None for unit in units):
        missing = sorted({name for unit in units for name in unit.missing})
        raise InputError(
            f"no row of {table} can be trained without {', '.join(missing)}: add NAME=SOURCE for them to --data"
        )
    if not scored:
        raise InputError(f"--data has nothing to score {table} on: add {chosen.columns[0][0]}=SOURCE")
    wanted = [unit for unit in units if not only or any(part in unit.row.name for part in only)]
    if not wanted:
        raise InputError(f"no row of {table} has {' or '.join(only)} in its name: they are {_names(units)}")
    mine = [] if show else share(wanted, part.index, part.count)
    for i, unit in enumerate(mine, start=1):
        say(f"{i} of {len(mine)}: {unit.row.name}, seed {unit.seed}")
        if unit.missing:
            say(f"not run: there is no {', '.join(unit.missing)} in --data")
            continue
        run_unit(
            out,
            unit,
            scored,
            device=device,
            say=say,
            track=lambda indices, description: track(indices, description, console=console),
        )
    results = [read_result(out, unit, scored) for unit in units]
    found = shown(chosen, units, results, datasets=names, scale=scale.name)
    print_table(found)
    if table == "backbones" and plot_backbones(units, results, out / f"{table}-{scale.name}.png"):
        say(f"Plotted: {out / f'{table}-{scale.name}.png'}")
    say(f"Written to {_write(out, f'{table}-{scale.name}', found)}, .html, .tex")
    return 0


def _absolute(source: str) -> str:
    """Return a path that is there as an absolute one: a run belongs to its data, from wherever it is started."""
    return str(Path(source).absolute()) if Path(source).exists() else source


def _names(units: "Iterable[Unit]") -> str:
    return ", ".join(dict.fromkeys(unit.row.name for unit in units))


def _write(out: Path, name: str, table: "ReportTable") -> Path:
    """Write the table in three formats; return the first."""
    from zoedepth.images import atomic_path

    (out / "results").mkdir(parents=True, exist_ok=True)  # by which the folder is known to be ours
    for suffix, text in (("md", table.markdown()), ("html", table.html()), ("tex", table.latex())):
        with atomic_path(out / f"{name}.{suffix}") as part:
            part.write_text(text, encoding="utf-8")
    return out / f"{name}.md"
