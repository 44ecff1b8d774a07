"""``--data NAME=PATH``, as several commands read it."""

from collections.abc import Sequence
from pathlib import Path

from zoedepth.errors import InputError


def named_paths(values: Sequence[str]) -> dict[str, Path]:
    """NAME=PATH arguments as a dict; a bare PATH is named after its last folder.

    Raises:
        InputError: a name is empty or given twice.
    """
    named: dict[str, Path] = {}
    for value in values:
        name, separator, path = value.partition("=")
        if not separator:
            file = Path(value)
            name, path = (file.parent.name if file.suffix == ".csv" else file.name) or file.stem, value
        if not name or not path or name in named:
            raise InputError(f"{value!r}: give NAME=PATH, each name once")
        named[name] = Path(path)
    return named
