"""``zoedepth data shard``: write data as shards."""

from pathlib import Path

import tyro

from zoedepth.errors import InputError
from zoedepth.folders import check_writable

EXIT_FAILED = 1
_SHOWN = 20  # numbers of samples, at most


def shard(
    source: tyro.conf.Positional[str],
    out: tyro.conf.Positional[Path],
    *,
    name: str | None = None,
    split: str = "train",
    shard_size: str = "500MB",
    depth_scale: float | None = None,
    domain: str | None = None,
    root: Path | None = None,
    workers: int | None = None,
) -> int:
    """Write data as WebDataset shards: a few large files in place of many small ones, fast to copy and to read.

    The samples stay the same bit for bit, and photos keep the bytes of their files. Type the command again to go on
    after an interruption. Samples that cannot be read are named and left out.

    Exit codes: 0 all samples are packed, 1 some were left out, 2 wrong input.

    Args:
        source: data in any form, see docs/your-data.md.
        out: folder for NAME-000000.tar ... and index.json.
        name: the beginning of the shards' names; for a published data set, its name. Without it they are called data.
        split: which list, folder or split of the source to take.
        shard_size: how large a shard may become: 500MB, 2GB, or a number of samples.
        depth_scale: the stored value of one metre, where the source does not say it.
        domain: scene type, where the source does not say it; it replaces that of dataset.json.
        root: the folder that the paths of a list are relative to; without it that of the list.
        workers: processes that read and pack samples; without it the one that writes them does it.
    """
    from rich.console import Console

    from zoedepth.commands.progress import track
    from zoedepth.opening import open_dataset
    from zoedepth.shards.index import INDEX_FILE
    from zoedepth.shards.writer import ShardSize, write_shards

    size = ShardSize.parse(shard_size)
    if workers is not None and workers < 0:
        raise InputError(f"--workers must be 1 or more, got {workers}")
    check_writable(out, option="OUT")
    if not (out / INDEX_FILE).exists() and (others := sorted(out.glob(f"{name or 'data'}-*.tar"))):
        raise InputError(
            f"{out} has {others[0].name} without an {INDEX_FILE}: it may be somebody else's, and would be replaced. "
            "Choose another folder or another --name"
        )
    dataset = open_dataset(source, name=name, split=split, depth_scale=depth_scale, domain=domain, root=root)
    console = Console(stderr=True, highlight=False)
    told: list[int] = []

    def tell(number: int, error: InputError) -> None:
        told.append(number)
        console.print(f"failed: sample {number}: {error}", soft_wrap=True, markup=False)

    index = write_shards(
        dataset,
        out,
        name=name or "data",
        size=size,
        workers=workers or 0,
        track=lambda samples, first: track(samples, "shards", total=len(dataset), first=first, console=console),
        on_failure=tell,
    )
    if before := sorted(set(index.skipped) - set(told)):
        console.print(
            f"Left out before, and not tried again: samples {', '.join(map(str, before[:_SHOWN]))}"
            f"{', ...' * (len(before) > _SHOWN)}. When they are mended, remove the shards to have them packed",
            soft_wrap=True,
        )
    left_out = f", {len(index.skipped)} left out" if index.skipped else ""
    n_packed = len(dataset) - len(index.skipped)
    console.print(f"{n_packed} samples in {len(index.shards)} shards{left_out}", markup=False)
    print(out)
    return EXIT_FAILED if index.skipped else 0
