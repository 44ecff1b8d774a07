"""``zoedepth verify DIR``."""

from pathlib import Path
from typing import Annotated

import tyro

from zoedepth.errors import InputError


def verify(
    folder: tyro.conf.Positional[Path],
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    download: bool = False,
    device: str = "auto",
) -> int:
    """Score the released weights on the official data sets, and compare with the numbers that the paper prints.

    Every model is scored on the data sets that the paper scores it on, under the paper's protocol and under that of its
    released code. What is not there is said, and the numbers that need it are "not run". Type the same command again to
    go on where it was interrupted. Exit code 0: everything was there and was scored; 1: something was not.

    Args:
        folder: holds the data sets, each in its official layout in a folder of its name (nyu, kitti, ibims, sunrgbd,
            diode-indoor, hypersim, vkitti2, ddad, diml-outdoor, diode-outdoor; see zoedepth data), and the weights
            ZoeD_M12_N.pt, ZoeD_M12_K.pt, ZoeD_M12_NK.pt, there or in the folder weights.
        out: folder for the scores and the table, verify.md.
        download: fetch weights that are not there, 1.4 GB each.
        device: cpu, cuda, mps, or auto for the best there is.
    """
    from rich.console import Console

    from zoedepth.commands.evaluate import print_table
    from zoedepth.commands.progress import track
    from zoedepth.folders import check_writable
    from zoedepth.images import atomic_path
    from zoedepth.reproduction.verify import TITLE, difference_table, find_files
    from zoedepth.reproduction.verify import verify as score_all

    console = Console(stderr=True, highlight=False)

    def say(text: str) -> None:
        console.print(text, soft_wrap=True, markup=False)

    found = find_files(folder, download=download)
    if not found.weights or not found.data:
        raise InputError(
            "there is nothing to verify: " + "; ".join(f"{name}: {why}" for name, why in found.missing.items())
        )
    check_writable(out, option="--out")
    report = out / "verify.md"
    if report.exists() and not report.read_bytes().startswith(f"**{TITLE}**".encode()):
        raise InputError(f"{report} is not from zoedepth and would be replaced: move it, or give another --out")
    rows = score_all(
        found,
        out=out,
        device=device,
        track=lambda indices, description: track(indices, description, console=console),
        say=lambda text: say(f"failed: {text}"),
    )
    table = difference_table(rows)
    print_table(table)
    lines = [f"- {name}: {why}" for name, why in found.missing.items()]
    with atomic_path(report) as part:
        missing = "\n\nNot there:\n\n" + "\n".join(lines) + "\n" if lines else ""
        part.write_text(table.markdown() + missing, encoding="utf-8")
    for name, why in found.missing.items():
        say(f"not there: {name}: {why}")
    say(f"Written to {report}")
    return 1 if found.missing else 0
