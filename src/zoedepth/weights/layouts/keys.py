"""Tables between two layouts of the same weights, and the engine that applies them in both directions."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from zoedepth.errors import InputError


@dataclass(frozen=True)
class Row:
    """Line of a table. In its patterns ``{}`` stands for a number, and ``*`` at the end for the rest of the name."""

    theirs: str | tuple[str, ...]
    """Name in the other layout. Several names: their tensors, joined along dimension 0, make ours."""
    ours: str | None
    """Our name. None: the weight is known, but no model uses it."""


class Table:
    """Rows that translate names both ways. The first row that matches counts; rows without our name drop the weight."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self.rows = tuple(rows)
        self._theirs = [
            (_compile(pattern), row, part)
            for row in self.rows
            for part, pattern in enumerate((row.theirs,) if isinstance(row.theirs, str) else row.theirs)
        ]
        self._ours = [(_compile(row.ours), row) for row in self.rows if row.ours is not None]

    def to_ours(self, weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Rename and join weights. Only joined tensors are copied.

        Raises:
            InputError: no row knows a name, or parts of a joined tensor are missing or do not go together.
        """
        found: dict[str, Tensor] = {}
        parts: dict[str, dict[int, Tensor]] = {}
        rows: dict[str, tuple[Row, tuple[str, ...]]] = {}
        unknown: list[str] = []
        for name, value in weights.items():
            for pattern, row, part in self._theirs:
                if match := pattern.fullmatch(name):
                    if row.ours is not None:
                        target = _fill(row.ours, match.groups())
                        if rows.setdefault(target, (row, match.groups()))[0] is not row:
                            unknown.append(name)  # a second name for a weight that is there already
                        parts.setdefault(target, {})[part] = value
                    break
            else:
                unknown.append(name)
        if unknown:
            raise InputError(f"unknown weights: {shown(unknown)}")
        for target, given in parts.items():
            row, groups = rows[target]
            if isinstance(row.theirs, str):
                found[target] = given[0]
                continue
            if lost := [_fill(row.theirs[i], groups) for i in range(len(row.theirs)) if i not in given]:
                raise InputError(f"missing weights: {shown(lost)}")
            sisters = [given[i] for i in range(len(row.theirs))]
            if len({(sister.shape, sister.dtype) for sister in sisters}) > 1 or not sisters[0].ndim:
                raise InputError(f"{_fill(row.theirs[0], groups)} and its sisters have different shapes or types")
            found[target] = torch.cat(sisters)
        return found

    def to_theirs(self, weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Rename and split weights, the way back. Dropped weights do not come back.

        Raises:
            InputError: no row knows a name, so that the other layout has no place for it.
        """
        found: dict[str, Tensor] = {}
        unknown: list[str] = []
        for name, value in weights.items():
            names = self.theirs(name)
            if not names:
                unknown.append(name)
            if len(names) > 1 and (not value.ndim or value.shape[0] % len(names)):
                raise InputError(f"{name} of shape {tuple(value.shape)} cannot be split in {len(names)}")
            parts = value.chunk(len(names)) if len(names) > 1 else [value] * len(names)
            for target, part in zip(names, parts, strict=True):
                found[target] = part.contiguous()
        if unknown:
            raise InputError(f"the other layout has no place for {shown(unknown)}")
        return found

    def theirs(self, name: str) -> tuple[str, ...]:
        """Return the names of one of our weights in the other layout; () if no row knows it."""
        for pattern, row in self._ours:
            if match := pattern.fullmatch(name):
                patterns = (row.theirs,) if isinstance(row.theirs, str) else row.theirs
                return tuple(_fill(pattern, match.groups()) for pattern in patterns)
        return ()


def unwrapped(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Remove the "module." of a model that was wrapped for several GPUs, if all names begin with it."""
    if all(name.startswith(_WRAPPED) for name in weights):
        return {name.removeprefix(_WRAPPED): value for name, value in weights.items()}
    return dict(weights)


_WRAPPED = "module."
"""Prefix of every name that ``DataParallel`` and ``DistributedDataParallel`` save."""


def shown(names: Sequence[str], *, limit: int = 8) -> str:
    """Format the first names of a list and how many more there are, for messages."""
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    # The names come from a file: long ones are cut.
    return ", ".join(repr(name)[:120] for name in sorted(names)[:limit]) + more


def _compile(pattern: str) -> re.Pattern[str]:
    text = re.escape(pattern).replace(r"\{\}", r"(\d{1,4})")
    return re.compile(text.removesuffix(r"\*") + "(.+)" if pattern.endswith("*") else text)


def _fill(pattern: str, groups: tuple[str, ...]) -> str:
    for group in groups:
        place = "{}" if "{}" in pattern else "*"
        pattern = pattern.replace(place, group, 1)
    return pattern
