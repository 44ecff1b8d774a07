"""What the paper printed: its result tables, and its tables of data sets, models and parameters. No torch here.

``assets/paper.json`` has them row by row as in the paper. Scores are Decimals, which keep the printed digits: ``str``
of one is what the paper shows, ``float`` is for computing.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from types import MappingProxyType
from typing import Any

from zoedepth.errors import InputError
from zoedepth.evaluation.improvement import MRI_METRICS, mri_datasets, mri_metrics
from zoedepth.weights.releases import ASSETS

ALL = "all"
"""Stands for the data sets together: the key of mRI_D."""


@dataclass(frozen=True)
class Metric:
    """A column of the paper's tables."""

    name: str
    """Field of ``zoedepth.metrics.Metrics``, or "mri_datasets" (mRI_D), "mri_metrics" (mRI_theta)."""
    symbol: str
    """As printed."""
    higher_is_better: bool


@dataclass(frozen=True)
class Row:
    """One method's line in a table."""

    method: str
    """As printed, without its mark."""
    note: str
    """Its mark, e.g. "†", or empty; the table's notes say what it means."""
    values: Mapping[tuple[str, str], Decimal | None]
    """(Data set, metric) → score, None where the paper has a dash. RMSE is in metres, deltas are shares of 1."""
    mri: Mapping[str, Decimal | None]
    """Data set → mean relative improvement, percent; of mRI_D the key is ``ALL``. Empty in tables without."""

    @property
    def name(self) -> str:
        """Method and mark: tells apart the models of one name."""
        return self.method + self.note


@dataclass(frozen=True)
class Table:
    """One of the paper's result tables."""

    id: str
    """Of the main text "table-1" to "table-6", of the appendix the label, e.g. "sunrgbd-full"."""
    title: str
    notes: tuple[str, ...]
    """What its footnote marks mean, and what holds for all rows."""
    columns: tuple[tuple[str, str], ...]
    """(Data set, metric) as printed, those of mRI included."""
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class Dataset:
    """A row of the overview of data sets (appendix)."""

    id: str
    name: str
    domain: str
    type: str
    """Real or Synthetic."""
    seen_in_training: bool
    train_samples: str | None
    """As printed, e.g. "24k"."""
    eval_samples: int
    min_depth: float
    """Metres."""
    max_depth: float
    """Metres."""
    crop: str
    note: str
    """Or empty. ‡: the sample is cropped first, and the Garg crop is scaled to what is left."""


@dataclass(frozen=True)
class Model:
    """A row of the table of models (appendix)."""

    name: str
    note: str
    """Or empty. †: a single metric head for both data sets."""
    relative_training: str | None
    """Data sets of the relative pre-training; None: without."""
    metric_training: str
    """Data sets of the metric fine-tuning."""
    heads: int


@dataclass(frozen=True)
class Parameters:
    """A row of the comparison of sizes (appendix)."""

    method: str
    encoder: str | None
    parameters: str | None
    """As printed, e.g. "345M"."""


@dataclass(frozen=True)
class MriEntry:
    """A mean relative improvement as printed, percent, with the printed scores that it is made of."""

    table: str
    dataset: str
    """``ALL`` for mRI_D."""
    method: str
    printed: Decimal
    scores: Mapping[str, Decimal]
    """Data set → REL for mRI_D, metric → score on the data set for mRI_theta."""
    reference: Mapping[str, Decimal]
    """The same of the reference, NeWCRFs."""

    @property
    def recomputed(self) -> float:
        """What our functions make of the printed scores, percent."""
        mean = mri_datasets if self.dataset == ALL else mri_metrics
        return mean(_floats(self.scores), _floats(self.reference))

    @property
    def difference(self) -> float:
        """Printed less recomputed, percent points."""
        return float(self.printed) - self.recomputed


@cache
def metrics() -> Mapping[str, Metric]:
    """Name → metric, of all columns of all tables."""
    return MappingProxyType({row["name"]: Metric(**row) for row in _paper()["metrics"]})


@cache
def tables() -> Mapping[str, Table]:
    """Id → table, in the order of the paper."""
    return MappingProxyType({table["id"]: _table(table) for table in _paper()["tables"]})


def method_rows(dataset: str) -> list[tuple[str, Mapping[str, Decimal]]]:
    """What the paper has on a data set: (method, field of ``Metrics`` → score); nothing for one it does not have.

    Each method is there once, from the table with most metrics on this data set; those tables come first. The variants
    of head and router in Tables 5 and 6 are methods too. A score that the paper does not have is left out.
    """
    found: dict[str, tuple[str, Mapping[str, Decimal]]] = {}
    for table in sorted(tables().values(), key=lambda table: -len({m for name, m in table.columns if name == dataset})):
        for row in table.rows:
            scores = {m: value for (name, m), value in row.values.items() if name == dataset and value is not None}
            if scores:
                found.setdefault(_ALIASES.get(row.name, row.name), (row.name, MappingProxyType(scores)))
    return list(found.values())


def numbers(dataset: str, metric: str) -> list[tuple[str, Decimal]]:
    """(Method, score) of all methods that the paper scores on a data set with a metric, a field of ``Metrics``.

    Raises:
        InputError: the paper has no such data set or metric.
    """
    for name, known in ((dataset, [*datasets()]), (metric, [each for each in metrics() if each not in _MRI])):
        if name not in known:
            raise InputError(f"the paper has no {name!r}; it has {', '.join(known)}")
    return [(method, scores[metric]) for method, scores in method_rows(dataset) if metric in scores]


def mri_entries() -> list[MriEntry]:
    """All mean relative improvements that the paper prints (Tables 2, 3 and 4)."""
    entries = []
    for table in tables().values():
        for row in table.rows:
            for dataset, printed in row.mri.items():
                if printed is not None:
                    reference = next(each for each in table.rows if each.name in _REFERENCES)
                    scores = _mri_scores(row, dataset), _mri_scores(reference, dataset)
                    entries.append(MriEntry(table.id, dataset, row.name, printed, *scores))
    return entries


@cache
def datasets() -> Mapping[str, Dataset]:
    """Id → data set: fine-tuned on or evaluated on, as the appendix describes them."""
    return MappingProxyType({row["id"]: _dataset(row) for row in _paper()["datasets"]})


@cache
def models() -> tuple[Model, ...]:
    """The twelve models of the appendix."""
    return tuple(Model(**{"note": "", **row}) for row in _paper()["models"])


@cache
def parameters() -> tuple[Parameters, ...]:
    """Sizes of the models and of prior work, as the appendix compares them."""
    return tuple(Parameters(**row) for row in _paper()["parameters"])


_MRI = ("mri_datasets", "mri_metrics")

_ALIASES = {"NeWCRF": "NeWCRFs", "ZoeD-M12-N (B-L)": "ZoeD-M12-N"}
"""The appendix's names of methods that the main tables call otherwise."""

_REFERENCES = ("NeWCRFs-X-NK†", "NeWCRFs")
"""What mRI is relative to, in Table 2 and in Tables 3 and 4."""


@cache
def _paper() -> dict[str, Any]:
    return json.loads((ASSETS / "paper.json").read_text(encoding="utf-8"), parse_float=Decimal)


def _table(table: dict[str, Any]) -> Table:
    columns = tuple((dataset, metric) for dataset, metric in table["columns"])
    rows = tuple(_row(row, columns) for row in table["rows"])
    return Table(table["id"], table["title"], tuple(table.get("notes", ())), columns, rows)


def _row(row: dict[str, Any], columns: tuple[tuple[str, str], ...]) -> Row:
    cells = dict(zip(columns, row["values"], strict=True))
    return Row(
        row["method"],
        row.get("note", ""),
        MappingProxyType({column: value for column, value in cells.items() if column[1] not in _MRI}),
        MappingProxyType({dataset: value for (dataset, metric), value in cells.items() if metric in _MRI}),
    )


def _dataset(row: dict[str, Any]) -> Dataset:
    depths = {"min_depth": float(row["min_depth"]), "max_depth": float(row["max_depth"])}
    return Dataset(**{"note": "", **row, **depths})


def _mri_scores(row: Row, dataset: str) -> Mapping[str, Decimal]:
    if dataset == ALL:
        found = {name: value for (name, _), value in row.values.items()}
    else:
        found = {metric: row.values[dataset, metric] for metric in MRI_METRICS}
    return MappingProxyType({key: value for key, value in found.items() if value is not None})


def _floats(numbers: Mapping[str, Decimal]) -> dict[str, float]:
    return {key: float(value) for key, value in numbers.items()}
