"""Read the paper's numbers: its tables of results, data sets, models and parameters. Nothing here imports torch.

``assets/paper.json`` has them row by row as in the paper. Scores are Decimals, which keep the printed digits: ``str``
gives what the paper shows, ``float`` is for computing.
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
"""Key of mRI_D, which is a mean over data sets, where other scores have the name of one data set."""


@dataclass(frozen=True)
class PaperMetric:
    """A metric in the paper's tables."""

    name: str
    """Field of ``zoedepth.metrics.Metrics``, or "mri_datasets" (mRI_D), "mri_metrics" (mRI_theta)."""
    symbol: str
    """Its name as printed."""
    higher_is_better: bool


@dataclass(frozen=True)
class PaperRow:
    """A method's row in a table."""

    method: str
    """Name as printed, without its mark."""
    note: str
    """Mark of the method, e.g. "†", or empty; the table's notes say what it means."""
    values: Mapping[tuple[str, str], Decimal | None]
    """(Data set, metric) → score, None where the paper has a dash. RMSE is in metres, deltas are shares of 1."""
    mri: Mapping[str, Decimal | None]
    """Data set, or ``ALL`` for mRI_D → mean relative improvement, percent. Empty where the table has none."""

    @property
    def name(self) -> str:
        """Method and mark, which tell models of one name apart."""
        return self.method + self.note


@dataclass(frozen=True)
class PaperTable:
    """One of the paper's tables of results."""

    id: str
    """"table-1" to "table-6" in the main text; the label in the appendix, e.g. "sunrgbd-full"."""
    title: str
    notes: tuple[str, ...]
    """Meaning of the footnote marks, and statements that hold for all rows."""
    columns: tuple[tuple[str, str], ...]
    """(Data set, metric) of each column in printed order, including mRI."""
    rows: tuple[PaperRow, ...]


@dataclass(frozen=True)
class PaperDataset:
    """A row of the paper's overview of data sets (appendix)."""

    id: str
    name: str
    domain: str
    type: str
    """Real or Synthetic."""
    seen_in_training: bool
    train_samples: str | None
    """Number as printed, e.g. "24k"."""
    eval_samples: int
    min_depth: float
    """Metres."""
    max_depth: float
    """Metres."""
    crop: str
    note: str
    """Mark, or empty. ‡: the sample is cropped first, and the Garg crop is scaled to the rest."""


@dataclass(frozen=True)
class PaperModel:
    """A row of the paper's table of models (appendix)."""

    name: str
    note: str
    """Mark, or empty. †: a single metric head for both data sets."""
    relative_training: str | None
    """Data sets of the relative pre-training; None where there was none."""
    metric_training: str
    """Data sets of the metric fine-tuning."""
    heads: int


@dataclass(frozen=True)
class PaperSize:
    """A row of the paper's comparison of sizes (appendix)."""

    method: str
    encoder: str | None
    parameters: str | None
    """Number as printed, e.g. "345M"."""


@dataclass(frozen=True)
class MriEntry:
    """A mean relative improvement as printed, percent, with the printed scores that it is computed from."""

    table: str
    dataset: str
    """Name of the data set; ``ALL`` for mRI_D."""
    method: str
    printed: Decimal
    scores: Mapping[str, Decimal]
    """Scores of the method. For mRI_D: data set → REL. For mRI_theta: metric → score on the data set."""
    reference: Mapping[str, Decimal]
    """Scores of the reference, NeWCRFs, with the same keys."""

    @property
    def recomputed(self) -> float:
        """Mean relative improvement that our functions compute from the printed scores, percent."""
        mean = mri_datasets if self.dataset == ALL else mri_metrics
        return mean(_floats(self.scores), _floats(self.reference))

    @property
    def difference(self) -> float:
        """Printed minus recomputed, percentage points."""
        return float(self.printed) - self.recomputed


@cache
def metrics() -> Mapping[str, PaperMetric]:
    """Return name → metric, for all columns of all tables."""
    return MappingProxyType({row["name"]: PaperMetric(**row) for row in _paper()["metrics"]})


@cache
def tables() -> Mapping[str, PaperTable]:
    """Return id → table, in the order of the paper."""
    return MappingProxyType({table["id"]: _table(table) for table in _paper()["tables"]})


def method_rows(dataset: str) -> list[tuple[str, Mapping[str, Decimal]]]:
    """Return the paper's scores on a data set as (method, field of ``Metrics`` → score); empty where it has none.

    Each method is there once, from the table with most metrics on this data set; those tables come first. The variants
    of head and router in Tables 5 and 6 count as methods, too. A score that the paper does not have is left out.
    """
    found: dict[str, tuple[str, Mapping[str, Decimal]]] = {}
    for table in sorted(tables().values(), key=lambda table: -len({m for name, m in table.columns if name == dataset})):
        for row in table.rows:
            scores = {m: value for (name, m), value in row.values.items() if name == dataset and value is not None}
            if scores:
                found.setdefault(_ALIASES.get(row.name, row.name), (row.name, MappingProxyType(scores)))
    return list(found.values())


def numbers(dataset: str, metric: str) -> list[tuple[str, Decimal]]:
    """Return (method, score) for all methods that the paper scores on a data set with a metric.

    Args:
        dataset: id of a data set of the paper, e.g. "nyu".
        metric: field of ``Metrics``, e.g. "rel".

    Raises:
        InputError: the paper has no such data set or metric.
    """
    for name, known in ((dataset, [*datasets()]), (metric, [each for each in metrics() if each not in _MRI])):
        if name not in known:
            raise InputError(f"the paper has no {name!r}; it has {', '.join(known)}")
    return [(method, scores[metric]) for method, scores in method_rows(dataset) if metric in scores]


def mri_entries() -> list[MriEntry]:
    """Return all mean relative improvements that the paper prints (Tables 2, 3 and 4)."""
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
def datasets() -> Mapping[str, PaperDataset]:
    """Return id → data set, for those that the paper fine-tunes or evaluates on, as the appendix describes them."""
    return MappingProxyType({row["id"]: _dataset(row) for row in _paper()["datasets"]})


@cache
def models() -> tuple[PaperModel, ...]:
    """Return the twelve models of the appendix."""
    return tuple(PaperModel(**{"note": "", **row}) for row in _paper()["models"])


@cache
def parameters() -> tuple[PaperSize, ...]:
    """Return the sizes of the models and of prior work, as the appendix compares them."""
    return tuple(PaperSize(**row) for row in _paper()["parameters"])


_MRI = ("mri_datasets", "mri_metrics")

_ALIASES = {"NeWCRF": "NeWCRFs", "ZoeD-M12-N (B-L)": "ZoeD-M12-N"}
"""Names of methods in the appendix → their names in the main tables."""

_REFERENCES = ("NeWCRFs-X-NK†", "NeWCRFs")
"""Methods that mRI is relative to, in Table 2 and in Tables 3 and 4."""


@cache
def _paper() -> dict[str, Any]:
    return json.loads((ASSETS / "paper.json").read_text(encoding="utf-8"), parse_float=Decimal)


def _table(table: dict[str, Any]) -> PaperTable:
    columns = tuple((dataset, metric) for dataset, metric in table["columns"])
    rows = tuple(_row(row, columns) for row in table["rows"])
    return PaperTable(table["id"], table["title"], tuple(table.get("notes", ())), columns, rows)


def _row(row: dict[str, Any], columns: tuple[tuple[str, str], ...]) -> PaperRow:
    cells = dict(zip(columns, row["values"], strict=True))
    return PaperRow(
        row["method"],
        row.get("note", ""),
        MappingProxyType({column: value for column, value in cells.items() if column[1] not in _MRI}),
        MappingProxyType({dataset: value for (dataset, metric), value in cells.items() if metric in _MRI}),
    )


def _dataset(row: dict[str, Any]) -> PaperDataset:
    depths = {"min_depth": float(row["min_depth"]), "max_depth": float(row["max_depth"])}
    return PaperDataset(**{"note": "", **row, **depths})


def _mri_scores(row: PaperRow, dataset: str) -> Mapping[str, Decimal]:
    if dataset == ALL:
        found = {name: value for (name, _), value in row.values.items()}
    else:
        found = {metric: row.values[dataset, metric] for metric in MRI_METRICS}
    return MappingProxyType({key: value for key, value in found.items() if value is not None})


def _floats(numbers: Mapping[str, Decimal]) -> dict[str, float]:
    return {key: float(value) for key, value in numbers.items()}
