"""``zoedepth data``: list the data sets, and check a download. Also reads ``--data NAME=SOURCE`` for other commands."""

import json
import os
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from zoedepth.commands.options import WIDTH, call
from zoedepth.commands.shard import shard
from zoedepth.errors import InputError, no_such
from zoedepth.folders import check_writable

if TYPE_CHECKING:
    from rich.console import Console

    from zoedepth.checking import Report
    from zoedepth.data.sample import DepthDataset
    from zoedepth.datasets.published import About, PublishedDataset

EXIT_NOT_IN_ORDER = 1
_MOST_NAMED = 10
"""Missing files that are named; a whole archive may be missing."""


def data(arguments: Sequence[str]) -> int:
    """Run a command of ``SUBCOMMANDS``."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_usage(), file=sys.stdout if arguments else sys.stderr)
        return 0 if arguments else 2
    name, *rest = arguments
    if name not in SUBCOMMANDS:
        raise no_such("command of zoedepth data", name, SUBCOMMANDS)
    return call(SUBCOMMANDS[name], rest, prog=f"zoedepth data {name}")


def _usage() -> str:
    first = {name: (function.__doc__ or "").partition("\n")[0] for name, function in SUBCOMMANDS.items()}
    lines = [textwrap.fill(f"  {name:<7}{text}", WIDTH, subsequent_indent=" " * 9) for name, text in first.items()]
    return "\n".join([
        "usage: zoedepth data COMMAND [OPTIONS]     (zoedepth data COMMAND --help for the options)",
        "",
        "Photos with depth: what can be read, whether a download is in order, and shards.",
        "",
        *lines,
    ])  # fmt: skip


def list_(*, markdown: bool = False, json_: Annotated[bool, tyro.conf.arg(name="json")] = False) -> int:
    """List the published data sets that can be read: what each is, how many pairs it has, its licence and page.

    Args:
        markdown: print the table and the folders for the documentation.
        json_: print one JSON object for each data set, and nothing else.
    """
    from zoedepth.datasets import DATASETS

    if markdown:
        print(_markdown(DATASETS))
        return 0
    if json_:
        for name, dataset in DATASETS.items():
            print(json.dumps({"name": name, **asdict(dataset.about)}))
        return 0
    for name, dataset in DATASETS.items():
        about = dataset.about
        print(f"{name:<18} {about.title}")
        print(f"    {about.kind}, {about.domain or 'indoor and outdoor'}: {_pairs(about)}")
        print(f"    licence: {about.licence}")
        print(f"    {about.page}")
    return 0


def check(
    what: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="NAME|PATH")]],
    folder: tyro.conf.Positional[Annotated[Path | None, tyro.conf.arg(metavar="[FOLDER]")]] = None,
    *,
    split: str | None = None,
    sheet: Path | None = None,
    full: Annotated[bool, tyro.conf.arg(aliases=["--every"])] = False,
    depth_scale: float | None = None,
    domain: str | None = None,
    root: Path | None = None,
    json_: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Check that data is complete and readable, and that its depth is in the right unit.

    Looks at every file, reads 50 pairs, reports counts, missing and unreadable files, sizes and the range of depth, and
    draws a picture to look at. Exit codes: 0 in order, 1 not in order (it says why), 2 another folder altogether.

    Args:
        what: a name from `zoedepth data list`, followed by its folder; or data of your own in any form, see
            docs/your-data.md: a list, a folder, shards, hf:OWNER/NAME.
        folder: the folder of the published data set.
        split: a split of the data set, or the list in your own folder; without it the first, which is train if there is
            one.
        sheet: write a picture of some pairs to this .jpg, .png or .webp.
        full: read every pair instead of 50, as finetune --check full does.
        depth_scale: the stored value of one metre, where the data does not say it.
        domain: scene type, where the data does not say it; it replaces that of dataset.json.
        root: the folder that the paths of a list are relative to; without it that of the list.
        json_: print one JSON object, and nothing else.
    """
    from rich.console import Console

    from zoedepth.checking import check as check_data
    from zoedepth.checking import contact_sheet
    from zoedepth.commands.progress import track
    from zoedepth.datasets.published import PublishedDataset
    from zoedepth.images import PICTURE_SUFFIXES, write_image
    from zoedepth.outputs.ownership import require_own_mark
    from zoedepth.stored import to_json
    from zoedepth.train.log import Ticker

    if sheet is not None and sheet.suffix.lower() not in PICTURE_SUFFIXES:
        raise InputError(f"--sheet {sheet}: the name must end in one of {', '.join(PICTURE_SUFFIXES)}")
    if sheet is not None:
        check_writable(sheet.parent, option="--sheet")
        require_own_mark(sheet, advice="give another --sheet")
    if folder is not None:
        dataset = _open_published(what, folder, split)
    else:
        dataset = _open_own(what, split, depth_scale=depth_scale, domain=domain, root=root)
    about = dataset.about if isinstance(dataset, PublishedDataset) else None
    console = Console(stderr=True, highlight=False)
    report = check_data(
        dataset,
        every=full,
        track=lambda indices: track(indices, "reading", console=console),
        looking=Ticker("looking at files", console.print),
    )
    path = str(dataset.root if isinstance(dataset, PublishedDataset) else getattr(dataset, "path", what))
    used = dataset.split if isinstance(dataset, PublishedDataset) else None
    if json_:
        print(to_json(_record(report, about, path=path, split=used)))
    else:
        _print(report, about, path=path, split=used)
    if sheet is not None and report.readable:
        write_image(sheet, contact_sheet(dataset, report.readable))
        console.print(f"Picture: {sheet}", soft_wrap=True, markup=False)
    return EXIT_NOT_IN_ORDER if report.problems else 0


SUBCOMMANDS: dict[str, Callable[..., int]] = {"list": list_, "check": check, "shard": shard}
"""Name → function, whose signature is the command's options."""


def named_sources(values: Sequence[str]) -> dict[str, str]:
    """Return NAME=SOURCE arguments as a dict; a bare SOURCE is named after its file's folder, its folder or its scheme.

    The path of a file or folder that is there is a bare SOURCE, also where it has a = in it.

    Raises:
        InputError: a name is empty or given twice.
    """
    named: dict[str, str] = {}
    for value in values:
        found = None if os.path.exists(value) else re.fullmatch(r"([^=:?]*)=(.*)", value)
        name, source = found.groups() if found else (_own_name(value), value)
        if not name or not source or name in named:
            raise InputError(f"{value!r}: give NAME=SOURCE, each name once")
        named[name] = source
    return named


def _own_name(source: str) -> str:
    from zoedepth.opening import LISTS

    scheme, colon, rest = source.partition(":")
    if colon and scheme in ("synthetic", "hf", "http", "https"):
        return scheme if scheme == "synthetic" else Path(re.split(r"[?@:]", rest)[0]).name
    path = Path(source)
    return (path.parent.name if path.suffix.lower() in LISTS else path.name) or path.stem


def named_paths(values: Sequence[str]) -> dict[str, Path]:
    """Return NAME=FOLDER arguments as a dict, with names as in ``named_sources``."""
    return {name: Path(source) for name, source in named_sources(values).items()}


def _open_published(name: str, folder: Path, split: str | None) -> "PublishedDataset":
    from zoedepth.datasets import DATASETS

    if name not in DATASETS:
        raise no_such("published data set", name, DATASETS, see="zoedepth data list")
    dataset = DATASETS[name]
    return dataset(folder, split=split or next(iter(dataset.about.splits)), allow_missing=True)


def _open_own(source: str, split: str | None, **given: Any) -> "DepthDataset":
    from zoedepth.datasets import DATASETS
    from zoedepth.opening import open_dataset

    if source in DATASETS and not Path(source).exists():
        raise InputError(f"say where {source} is: zoedepth data check {source} FOLDER")
    return open_dataset(source, split=split or "train", allow_missing=True, keep_missing=True, **given)


def _print(report: "Report", about: "About | None", *, path: str, split: str | None) -> None:
    """Print the report as a table, then name everything that is wrong."""
    from rich.console import Console

    console = Console(highlight=False)
    _say(console, f"{about.title}, split {split}, in {path}" if about else path)
    for key, value in _rows(report, about):
        _say(console, f"  {key:<27} {value}")
    for file in report.missing[:_MOST_NAMED]:
        _say(console, f"missing: {file}")
    if len(report.missing) > _MOST_NAMED:
        _say(console, f"missing: and {len(report.missing) - _MOST_NAMED:,} more, which --json lists")
    for problem in report.unreadable:
        _say(console, f"unreadable: {problem}")
    for name in report.empty[:_MOST_NAMED]:
        _say(console, f"nothing known: {name}")
    for problem in report.implausible:
        _say(console, f"implausible: {problem}")
    for note in report.notes:
        _say(console, f"look at this: {note}")
    if not report.problems:
        _say(console, "In order.")
        return
    counts = [problem for problem in report.problems if problem not in report.implausible]
    wrong = counts + (["its depth is not plausible"] if report.implausible else [])
    _say(console, f"Not in order: {'; '.join(wrong)}.")
    if about:
        _say(console, f"Get it at {about.page}")


def _say(console: "Console", text: str) -> None:
    console.print(text, soft_wrap=True, markup=False)


def _rows(report: "Report", about: "About | None") -> Iterator[tuple[str, str]]:
    published = "" if report.n_expected is None else f" of {report.n_expected:,} published"
    yield "pairs", f"{report.n_pairs:,}{published}"
    if report.n_without_truth:
        yield "without depth", f"{report.n_without_truth:,}, by its own list"
    yield "missing files", f"{len(report.missing):,}"
    yield "pairs read", f"{len(report.readable):,}"
    yield "unreadable", f"{len(report.unreadable):,}"
    sizes = [f"{width} x {height} ({n:,})" for (height, width), n in report.photo_sizes.items()]
    more = f" and {len(sizes) - 5:,} more" if len(sizes) > 5 else ""
    yield "photo sizes", (", ".join(sizes[:5]) + more) or "-"
    if report.values is not None:
        values, unit = report.values, " m" if report.kind == "depth" else ""
        yield str(report.kind), f"{values.least:.4g} to {values.greatest:.4g}{unit}"
        spread = f"{values.low:.4g}, {values.median:.4g}, {values.high:.4g}{unit}"
        yield "1st, 50th, 99th percentile", spread
    yield "known pixels", f"{report.known:.1%}"
    if report.empty:
        yield "pairs with nothing known", f"{len(report.empty):,}"
    yield "camera known", f"{report.n_cameras:,} of {len(report.readable):,}"
    if about:
        yield "stored as", about.unit
        yield "licence", about.licence
        yield "page", about.page


def _record(report: "Report", about: "About | None", *, path: str, split: str | None) -> dict:
    facts = {} if about is None else {"title": about.title, "licence": about.licence, "page": about.page}
    return {
        **facts,
        "path": path,
        "split": split,
        "kind": report.kind,
        "pairs": report.n_pairs,
        "published": report.n_expected,
        "without_truth": report.n_without_truth,
        "missing": len(report.missing),
        "missing_files": [str(file) for file in report.missing],
        "read": len(report.readable),
        "unreadable": list(report.unreadable),
        "photo_sizes": [{"height": h, "width": w, "photos": n} for (h, w), n in report.photo_sizes.items()],
        "values": None if report.values is None else asdict(report.values),
        "known": report.known,
        "nothing_known": list(report.empty),
        "cameras": report.n_cameras,
        "notes": report.notes,
        "problems": report.problems,
    }


def _pairs(about: "About") -> str:
    """Return the pairs of each split: "24,231 train, 654 test"."""
    return ", ".join(f"{'?' if n is None else f'{n:,}'} {split}" for split, n in about.splits.items())


def _markdown(datasets: "dict[str, type[PublishedDataset]]") -> str:
    """Return the table of the documentation, and below it the folder of each data set."""
    lines = ["| name | what | target | domain | stored as | pairs | licence |", "| --- " * 7 + "|"]
    sections = []
    for name, dataset in datasets.items():
        about = dataset.about
        cells = (about.kind, about.domain or "both", about.unit, _pairs(about), about.licence)
        lines.append(f"| [`{name}`](#{name}) | [{about.title}]({about.page}) | {' | '.join(cells)} |")
        sections.append(f"### {name}\n\n{_prose(dataset)}\n\n```text\n{about.layout.strip()}\n```")
    return "\n\n".join(["\n".join(lines), *sections])


def _prose(dataset: "type[PublishedDataset]") -> str:
    from inspect import cleandoc

    return cleandoc(dataset.__doc__ or "").replace("``", "`")
