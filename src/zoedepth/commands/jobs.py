"""``zoedepth jobs``: what the commands of a job have done together, and one manifest made of theirs."""

import shlex
import sys
import textwrap
from collections.abc import Callable, Sequence
from typing import Annotated

import tyro

from zoedepth.commands.options import WIDTH, call
from zoedepth.errors import no_such
from zoedepth.stored import to_json

EXIT_FAILED = 1


def jobs(arguments: Sequence[str]) -> int:
    """Run a command of ``SUBCOMMANDS``."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_usage(), file=sys.stdout if arguments else sys.stderr)
        return 0 if arguments else 2
    name, *rest = arguments
    if name not in SUBCOMMANDS:
        raise no_such("command of zoedepth jobs", name, SUBCOMMANDS)
    return call(SUBCOMMANDS[name], rest, prog=f"zoedepth jobs {name}")


def _usage() -> str:
    first = {name: (function.__doc__ or "").partition("\n")[0] for name, function in SUBCOMMANDS.items()}
    lines = [textwrap.fill(f"  {name:<7}{text}", WIDTH, subsequent_indent=" " * 9) for name, text in first.items()]
    return "\n".join([
        "usage: zoedepth jobs COMMAND [OPTIONS]     (zoedepth jobs COMMAND --help for the options)",
        "",
        "Many photos on many machines: zoedepth predict PHOTOS --out OUT --shard I/N.",
        "",
        *lines,
    ])  # fmt: skip


def status(
    out: tyro.conf.Positional[str],
    *,
    failed: bool = False,
    json_: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Say how many photos each shard of a job has done, how many have failed, and which shards have done nothing.

    Exit codes: 0 nothing has failed, 1 some photos have, 2 there is no job.

    Args:
        out: the --out of the job: a folder, or a prefix of a store.
        failed: print the photos that have failed instead, one in a line, with the error behind a tab.
        json_: print one JSON object a line for each shard, or with --failed for each photo that has failed.
    """
    from zoedepth.jobs.report import missing_shards, read_failures, read_status

    if failed:
        n_failed = 0
        for entry in read_failures(out):
            n_failed += 1
            error = " ".join((entry.error or "").split())
            print(to_json({"input": entry.input, "error": error}) if json_ else f"{entry.input}\t{error}")
        return EXIT_FAILED if n_failed else 0
    found = read_status(out)
    for each in found if json_ else ():
        values = {**vars(each), "shard": str(each.shard)}
        print(to_json(values))
    done, n_failed = sum(each.done for each in found), sum(each.failed for each in found)
    if not json_:
        for each in found:
            state = "" if each.running is None else ", running" if each.running else ", not running"
            name = "all" if each.shard.count == 1 else f"shard {each.shard}"
            print(f"{name}: {each.done:,} done, {each.failed:,} failed{state}; began {each.began} by {each.by}")
        for shard in missing_shards(found):
            print(f"shard {shard}: nothing yet; nobody has begun it, or no photo falls to it")
        if len({each.fingerprint for each in found}) > 1:
            print("The shards have different settings: they are not of one job.")
        print(f"together: {done:,} done, {n_failed:,} failed")
    return EXIT_FAILED if n_failed else 0


def merge(out: tyro.conf.Positional[str]) -> int:
    """Make one manifest of those of all shards, so that a command without --shard, or with other shards, goes on.

    Args:
        out: the --out of the job, a folder.
    """
    from zoedepth.jobs.report import merge_shards, read_status

    done = merge_shards(out)
    n_failed = sum(each.failed for each in read_status(out))
    failed = f", {n_failed:,} failed: zoedepth jobs status {shlex.quote(out)} --failed" if n_failed else ""
    print(f"{done:,} photos are done{failed}")
    return 0


SUBCOMMANDS: dict[str, Callable[..., int]] = {"status": status, "merge": merge}
