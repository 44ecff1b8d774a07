"""Check the folder that an evaluation writes to: is it an evaluation's, and can anything be written there?"""

import json
import os
from collections.abc import Iterable
from pathlib import Path

from zoedepth.errors import InputError
from zoedepth.folders import check_writable

REPORTS = ("report.md", "report.html", "report.tex", "report.json")
"""The files of a report, the last of them last."""


def check_folder(folder: Path, names: Iterable[str] = REPORTS) -> None:
    """Check, before any work, that a folder can be written to and has no other files of these names.

    Raises:
        InputError: it cannot, or it has.
    """
    check_writable(folder, option="--out")
    if not _is_ours(folder) and (others := [name for name in names if os.path.lexists(folder / name)]):
        raise InputError(
            f"{folder / others[0]} is no evaluation's, and would be overwritten: give another --out, or move it"
        )


def _is_ours(folder: Path) -> bool:
    """Return True where an evaluation has left its scores or its report."""
    if next(folder.glob("*/*/scores-*-of-*.jsonl"), None) is not None:
        return True
    try:
        return {"zoedepth", "results"} <= json.loads((folder / REPORTS[-1]).read_text(encoding="utf-8")).keys()
    except (OSError, ValueError, AttributeError):
        return False
