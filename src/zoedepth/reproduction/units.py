"""The work of a reproduction, in units: a row with a seed, after the pre-training that it starts from."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from zoedepth.config import ModelConfig, to_dict
from zoedepth.data.sample import Samples
from zoedepth.evaluation.identity import said_and_files, settings_fingerprint
from zoedepth.opening import open_dataset
from zoedepth.reproduction.scale import Scale
from zoedepth.reproduction.tables import Row, Table, rows_of
from zoedepth.train.config import TrainConfig
from zoedepth.weights.fingerprint import fingerprint, weights_fingerprint
from zoedepth.weights.load import find

_NO_MATTER = ("n_workers", "log_every", "pictures", "keep_checkpoints", "check")
"""Fields of a configuration that do not change its result."""

_LATER = {"holdouts": (), "accumulate": 1}
"""Fields that did not count when results were published, and their defaults: they count only where they are set."""


@dataclass(frozen=True)
class Training:
    """One training, and what it starts from."""

    name: str
    """Name for people, and for its folder."""
    config: TrainConfig
    data: Mapping[str, str]
    """Source of the configuration → where the data is."""
    start: "Training | str"
    """The training whose result it starts from; or weights, "imagenet" among them."""
    id: str
    """A hash of the configuration, the data, the seed and the start: whose result this is."""

    @property
    def folder(self) -> str:
        """Name of the folder of its run."""
        letters = "".join(c if c.isascii() and c.isalnum() else "-" for c in self.name)
        return f"{'-'.join(filter(None, letters.split('-')))}-seed{self.config.seed}-{self.id}"

    def chain(self) -> "list[Training]":
        """Return the trainings before it, the first one first, and itself."""
        return [*(self.start.chain() if isinstance(self.start, Training) else []), self]


@dataclass(frozen=True)
class Unit:
    """A row of a table with a seed."""

    row: Row
    seed: int
    training: Training | None
    """None where it cannot be trained."""
    missing: tuple[str, ...] = ()
    """Names of data sets that are not there, for want of which it is not run."""


def plan(
    table: Table,
    scale: Scale,
    data: Mapping[str, str],
    *,
    seeds: Sequence[int],
    bases: Mapping[str, str] | None = None,
) -> list[Unit]:
    """List the work of a table: for each seed, every row.

    Args:
        table: the comparison.
        scale: how large it is.
        data: name → where the data is; names are those of the sources that the recipes train on.
        seeds: a training of every row for each of them.
        bases: name of a pre-training → weights that stand for it, in place of one that is trained here.

    Raises:
        InputError: data cannot be opened.
    """
    states: dict[str, str] = {}

    def known(names: Sequence[str]) -> dict[str, str]:
        for name in names:
            if name not in states:
                states[name] = data_content(data[name], name)
        return {name: states[name] for name in names}

    # Each file of weights is read once: it may have a gigabyte, and many rows start from it.
    weights = {source: _weights(source) for source in (bases or {}).values()}
    units = []
    for seed in seeds:
        for row in rows_of(table, small=scale.name == "small"):
            config = replace(scale.adapt(row), seed=seed)
            chain, start = [], "imagenet"
            if row.base != "X" and isinstance(config.model, ModelConfig):
                if bases and row.base in bases:
                    start = bases[row.base]
                else:
                    chain = [replace(each, seed=seed) for each in scale.pretrain(row.base, config.model)]
            wanted = [source.name for each in (*chain, config) for source in each.sources]
            if missing := tuple(dict.fromkeys(name for name in wanted if name not in data)):
                units.append(Unit(row, seed, None, missing))
                continue
            before: Training | str = start
            for i, each in enumerate(chain):
                name = f"base {row.base}" + (f" {i + 1}" if len(chain) > 1 else "")
                before = _training(name, each, data, before, known([source.name for source in each.sources]), weights)
            last = _training(row.name, config, data, before, known([source.name for source in config.sources]), weights)
            units.append(Unit(row, seed, last))
    return units


def share(units: Sequence[Unit], index: int, count: int) -> list[Unit]:
    """Return the part of the work that belongs to one of several commands: neighbours, which share pre-trainings.

    Args:
        units: all of the work.
        index: number of the command, from 0.
        count: number of commands.
    """
    return list(units[len(units) * index // count : len(units) * (index + 1) // count])


def data_content(source: str, name: str) -> str:
    """Return a hash of what a training reads: names and sizes of the files, and what is said of them.

    It is the same for a copy of the data on another machine.

    Raises:
        InputError: there is no such data.
    """
    return content_of(open_dataset(source, name=name, keep_missing=True), source)


def content_of(dataset: Samples, source: str) -> str:
    """Return a hash of an open data set as ``data_content`` does.

    Args:
        dataset: the data set.
        source: where it is, as it was given.
    """
    digest = hashlib.sha256(f"{settings_fingerprint(source, dataset)} {len(dataset)}".encode())
    parts = list(said_and_files(dataset, source))
    for said, files in parts:
        sizes: list[object] = [(file.name, _size(file)) for file in files]
        digest.update(repr([*sizes, *said]).encode("utf-8", "replace"))
    if not parts:
        digest.update(source.encode())
    return digest.hexdigest()[:16]


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError:
        return -1


def _training(
    name: str,
    config: TrainConfig,
    data: Mapping[str, str],
    start: Training | str,
    states: Mapping[str, str],
    weights: Mapping[str, str],
) -> Training:
    fields = to_dict(config)
    unset = [name for name, default in _LATER.items() if fields[name] == default]
    values: dict[str, Any] = {k: v for k, v in fields.items() if k not in _NO_MATTER and k not in unset}
    begin = start.id if isinstance(start, Training) else weights.get(start, start)
    own = {source.name: data[source.name] for source in config.sources}
    return Training(name, config, own, start, fingerprint([values, dict(states), begin]))


def _weights(start: str) -> str:
    """Return a hash of starting weights, and their name where they are no file here: a path may hold others by now."""
    return weights_fingerprint(find(start)) if Path(start).exists() else start


def trained_content(units: Sequence[Unit], data: Mapping[str, str], name: str) -> set[str]:
    """Return the hash of what trainings read of a data set; nothing where none reads it."""
    chains = (unit.training.chain() for unit in units if unit.training is not None)
    read = any(source.name == name for chain in chains for each in chain for source in each.config.sources)
    return {data_content(data[name], name)} if read else set()


def scored_names(table: Table, units: Sequence[Unit], data: Mapping[str, str]) -> list[str]:
    """Return the names of the data sets to score on: those of the table's columns, and those that nothing trains on."""
    columns = {name for name, _ in table.columns}
    trained = {
        source.name
        for unit in units
        if unit.training is not None
        for each in unit.training.chain()
        for source in each.config.sources
    }
    trained |= {name for unit in units for name in unit.missing}
    return [name for name in data if name in columns or name not in trained | _RELATIVE]


_RELATIVE = {"relative", "scenes"}
"""Data that a pre-training may leave out, and that is never scored."""
