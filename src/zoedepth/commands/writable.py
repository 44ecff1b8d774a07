"""Find out before the work begins whether its result can be written."""

import os
import tempfile
from pathlib import Path

from zoedepth.errors import InputError

_TRIED = 1 << 16
"""Bytes that are written for a try; a full disk has no room for them."""


def check_writable(folder: Path, *, option: str = "--out") -> None:
    """Check that files can be written to a folder, or to the one that it would be made in. Nothing is left behind.

    Raises:
        InputError: they cannot; the message says why.
    """
    there = Path(os.path.abspath(folder))
    while not os.path.lexists(there) and there != there.parent:
        there = there.parent
    try:
        with tempfile.TemporaryFile(dir=there) as file:
            file.write(bytes(_TRIED))
            file.flush()
    except OSError as error:
        at = "" if there == Path(os.path.abspath(folder)) else f" in {there}"
        raise InputError(
            f"{option} {folder}: cannot write{at} ({error.strerror}). Choose a folder that can be written to, or make "
            "room"
        ) from error
