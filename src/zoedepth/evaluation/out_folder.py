"""Check the folder that an evaluation writes to: is it an evaluation's, and can anything be written there?"""

import errno
import json
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

from zoedepth.errors import InputError

REPORTS = ("report.md", "report.html", "report.tex", "report.json")
"""The files of a report, the last of them last."""

_PROBE = 1 << 16


def check_folder(folder: Path, names: Iterable[str] = REPORTS) -> None:
    """Check, before any work, that a folder can be written to and has no other files of these names.

    Raises:
        InputError: it cannot, or it has.
    """
    existing = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    if not existing.is_dir():
        raise InputError(f"cannot write to {folder}: {existing} is no folder. Give another --out")
    if not _is_ours(folder) and (others := [name for name in names if os.path.lexists(folder / name)]):
        raise InputError(
            f"{folder / others[0]} is no evaluation's, and would be overwritten: give another --out, or move it"
        )
    probe = existing / f".{uuid4().hex}"
    try:
        with probe.open("xb") as file:
            file.write(bytes(_PROBE))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        advice = "Make room, or give" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "Give"
        raise InputError(f"cannot write to {folder} ({error.strerror}). {advice} another --out") from error
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)


def _is_ours(folder: Path) -> bool:
    """Return True where an evaluation has left its scores or its report."""
    if next(folder.glob("*/*/scores-*-of-*.jsonl"), None) is not None:
        return True
    try:
        return {"zoedepth", "results"} <= json.loads((folder / REPORTS[-1]).read_text(encoding="utf-8")).keys()
    except (OSError, ValueError, AttributeError):
        return False
