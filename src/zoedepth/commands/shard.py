"""``zoedepth data shard``: write data as shards."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from zoedepth.commands.writable import check_writable
from zoedepth.errors import InputError

if TYPE_CHECKING:
    from zoedepth.shards.writer import Packed


def shard(
    source: tyro.conf.Positional[str],
    out: tyro.conf.Positional[Path],
    *,
    name: str | None = None,
    split: str = "train",
    shard_size: str = "500MB",
    depth_scale: float | None = None,
    domain: str | None = None,
    workers: int = 0,
) -> int:
    """Write data as WebDataset shards: a few large files in place of many small ones, fast to copy and to read.

    The samples stay the same bit for bit, and photos keep the bytes of their files. Type the command again to go on
    after an interruption.

    Args:
        source: data in any form, see docs/your-data.md.
        out: folder for NAME-000000.tar ... and index.json.
        name: the beginning of the shards' names; for a published data set, its name. Without it they are called data.
        split: which list, folder or split of the source to take.
        shard_size: how large a shard may become: 500MB, 2GB, or a number of samples.
        depth_scale: the stored value of one metre, where the source does not say it.
        domain: scene type, where the source does not say it.
        workers: extra processes that read and pack; 0 does everything in one.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from zoedepth.opening import open_dataset
    from zoedepth.shards.index import INDEX_FILE
    from zoedepth.shards.writer import ShardSize, write_shards

    size = ShardSize.parse(shard_size)
    check_writable(out, option="OUT")
    if not (out / INDEX_FILE).exists() and (others := sorted(out.glob(f"{name or 'data'}-*.tar"))):
        raise InputError(
            f"{out} has {others[0].name} without an {INDEX_FILE}: it may be somebody else's, and would be replaced. "
            "Choose another folder or another --name"
        )
    dataset = open_dataset(source, name=name, split=split, depth_scale=depth_scale, domain=domain)
    console = Console(stderr=True, highlight=False)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:

        def track(samples: "Iterable[Packed]", first: int) -> "Iterable[Packed]":
            task = progress.add_task("shards", total=len(dataset), completed=first)
            for sample in samples:
                yield sample
                progress.advance(task)

        index = write_shards(dataset, out, name=name or "data", size=size, workers=workers, track=track)
    console.print(f"{len(dataset)} samples in {len(index.shards)} shards", markup=False)
    print(out)
    return 0
