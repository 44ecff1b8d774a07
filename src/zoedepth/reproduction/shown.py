"""Show a reproduction as the paper shows its tables: ours with intervals, the best in bold, the paper's beside."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from zoedepth.evaluation.improvement import MRI_METRICS, mri_datasets, mri_metrics
from zoedepth.evaluation.paper_numbers import ALL
from zoedepth.evaluation.tables import NOT_RUN, ReportTable, mri_cell
from zoedepth.metrics import HEADINGS, HIGHER_IS_BETTER
from zoedepth.reproduction.run import FAILED, Result
from zoedepth.reproduction.tables import Column, Row, Table
from zoedepth.reproduction.units import Unit

_STUDENT = (
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228,
    2.201, 2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086,
)  # fmt: skip
"""97.5 % quantile of Student's t for 1, 2, 3 ... degrees of freedom."""


@dataclass(frozen=True)
class Interval:
    """The mean over seeds, and half of its 95 % interval (Student's t)."""

    mean: float
    half: float | None
    """None for a single seed."""
    n: int

    @classmethod
    def of(cls, values: Sequence[float]) -> "Interval":
        """Compute it.

        Args:
            values: one for each seed, at least one.
        """
        n = len(values)
        if n < 2:
            return cls(values[0], None, n)
        quantile = _STUDENT[n - 2] if n - 2 < len(_STUDENT) else 1.96 + 2.5 / (n - 1)
        return cls(fmean(values), quantile * stdev(values) / math.sqrt(n), n)

    def __str__(self) -> str:
        return f"{self.mean:.3f}" if self.half is None else f"{self.mean:.3f} ± {self.half:.3f}"


def shown(
    table: Table,
    units: Sequence[Unit],
    results: Sequence[Result | None],
    *,
    datasets: Sequence[str] = (),
    scale: str = "full",
) -> ReportTable:
    """Set the results of a comparison in the paper's layout.

    Args:
        table: the comparison.
        units: its work, all of it.
        results: the result of each unit; None where it has not run.
        datasets: names of data sets that are scored beside those of the paper's table: REL of each gets a column.
        scale: full or small, for the title.

    Returns:
        A row for each of the comparison. What has not run says so; so does a training that did not converge.
    """
    columns = [*table.columns, *((name, "rel") for name in datasets if name not in {data for data, _ in table.columns})]
    lines = _lines(units, results)
    means = {name: _means(found) for name, found in lines.items()}
    # The small form of a table may have other rows: then its first is what the others are measured by.
    first = table.reference if table.reference in lines else units[0].row.name
    reference = means[first]
    names = list(dict.fromkeys(data for data, _ in columns))
    header = ["method", "seeds"]
    for data, metric in columns:
        header += [f"{data} {HEADINGS[metric]}", "paper"]
    over_all = len(names) > 1
    header += ["mRI_D %", "paper"] if over_all else []
    header += [f"mRI_theta {name} %" for name in names]
    rows: list[tuple[str, ...]] = []
    values: list[dict[int, float]] = []
    for unit in {unit.row.name: unit for unit in units}.values():
        row, found = unit.row, lines[unit.row.name]
        cells, numbers = _numbers(table, row, columns, found)
        mine = means[row.name]
        if over_all:
            cells += [_over_datasets(mine, reference, names), table.printed_mri(row, ALL) or "-"]
        cells += [mri_cell(mri_metrics, mine.get(name), reference.get(name)) for name in names]
        n = sum(result is not None for result in found)
        rows.append((row.name, str(n) if n else NOT_RUN, *cells))
        values.append(numbers)
    best = {
        (i, j)
        for k, (_, metric) in enumerate(columns)
        if (j := 2 + 2 * k) and len(there := [each[j] for each in values if j in each]) > 1
        for i, each in enumerate(values)
        if j in each and each[j] == (max(there) if metric in HIGHER_IS_BETTER else min(there))
    }
    return ReportTable(
        f"{table.title}, {scale}", tuple(header), tuple(rows), frozenset(best), _note(table, units, first)
    )


def _lines(units: Sequence[Unit], results: Sequence[Result | None]) -> dict[str, list[Result | None]]:
    found: dict[str, list[Result | None]] = {}
    for unit, result in zip(units, results, strict=True):
        found.setdefault(unit.row.name, []).append(result)
    return found


def _numbers(
    table: Table, row: Row, columns: Sequence[Column], found: Sequence[Result | None]
) -> tuple[list[str], dict[int, float]]:
    """Return the cells of a row, ours and the paper's in turn, and the means by the number of their cell."""
    cells: list[str] = []
    numbers: dict[int, float] = {}
    for data, metric in columns:
        values = [v for result in found if (v := _value(result, data, metric)) is not None]
        if any(result is not None and result.failure for result in found):
            cells.append(FAILED)
        elif values:
            interval = Interval.of(values)
            numbers[2 + len(cells)] = interval.mean
            cells.append(str(interval))
        else:
            cells.append(NOT_RUN)
        cells.append(table.printed(row, (data, metric)) or "-")
    return cells, numbers


def _value(result: Result | None, data: str, metric: str) -> float | None:
    metrics = None if result is None else result.scores.get(data)
    value = None if metrics is None else metrics.get(metric)
    return value if value is not None and math.isfinite(value) else None


def _means(found: Sequence[Result | None]) -> dict[str, dict[str, float]]:
    """Return data set → metric → mean over the seeds; nothing where a training did not converge."""
    if any(result is not None and result.failure for result in found):
        return {}
    names = {name for result in found if result is not None for name in result.scores}
    means: dict[str, dict[str, float]] = {}
    for name in names:
        for metric in MRI_METRICS:
            values = [v for result in found if (v := _value(result, name, metric)) is not None]
            if values:
                means.setdefault(name, {})[metric] = fmean(values)
    return means


def _over_datasets(
    mine: Mapping[str, Mapping[str, float]], reference: Mapping[str, Mapping[str, float]], names: Sequence[str]
) -> str:
    there = [name for name in names if "rel" in mine.get(name, {}) and "rel" in reference.get(name, {})]
    rel, theirs = ({name: scores[name]["rel"] for name in there} for scores in (mine, reference))
    return mri_cell(mri_datasets, rel, theirs)


def _note(table: Table, units: Sequence[Unit], reference: str) -> str:
    note = (
        f"The rows differ in {table.variable}. Ours: the mean over the seeds ± half of its 95 % interval (Student's "
        f"t). paper: as printed there, at full size on its own data. mRI is relative to {reference}, by the "
        "means: mRI_D over the data sets that were scored, mRI_theta over delta1, REL and RMSE."
    )
    missing = sorted({name for unit in units for name in unit.missing})
    return f"{note} Rows that need {', '.join(missing)} were not run: these data were not there." if missing else note
