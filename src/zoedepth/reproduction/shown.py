"""Show a reproduction as the paper shows its tables: ours with intervals, the best in bold, the paper's beside."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from zoedepth.errors import InputError
from zoedepth.evaluation.improvement import MRI_METRICS, mri_datasets, mri_metrics
from zoedepth.evaluation.paper_numbers import ALL
from zoedepth.evaluation.tables import NOT_RUN, ReportTable
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
        A row for each of the comparison. What has not run says so; so does a training that did not converge. The best
        value of a column is that of the rows with the most seeds: one lucky seed is no result.
    """
    columns = [*table.columns, *((name, "rel") for name in datasets if name not in {data for data, _ in table.columns})]
    lines = _lines(units, results)
    # The small form of a table may have other rows: then its first is what the others are measured by.
    first = table.reference if table.reference in lines else units[0].row.name
    reference = lines[first]
    names = list(dict.fromkeys(data for data, _ in columns))
    header = ["method", "seeds"]
    for data, metric in columns:
        header += [f"{data} {HEADINGS[metric]}", "paper"]
    over_all = len(names) > 1
    header += ["mRI_D %", "paper"] if over_all else []
    header += [f"mRI_theta {name} %" for name in names]
    rows: list[tuple[str, ...]] = []
    values: list[dict[int, Interval]] = []
    for unit in {unit.row.name: unit for unit in units}.values():
        row, found = unit.row, lines[unit.row.name]
        cells, numbers = _numbers(table, row, columns, tuple(found.values()))
        if over_all:
            compared = _scored({name: (name, "rel") for name in names}, results)
            cells += [_improvement(mri_datasets, found, reference, compared), table.printed_mri(row, ALL) or "-"]
        for name in names:
            compared = _scored({metric: (name, metric) for metric in MRI_METRICS}, results)
            cells.append(_improvement(mri_metrics, found, reference, compared))
        rows.append((row.name, _seeds(columns, tuple(found.values())), *cells))
        values.append(numbers)
    best = {
        (i, 2 + 2 * k)
        for k, (_, metric) in enumerate(columns)
        for i in _best([each.get(2 + 2 * k) for each in values], higher_is_better=metric in HIGHER_IS_BETTER)
    }
    return ReportTable(
        f"{table.title}, {scale}", tuple(header), tuple(rows), frozenset(best), _note(table, units, first)
    )


_Seeds = Mapping[int, Result | None]
"""Seed → the result of a row with it; None where it has not run."""


def _scored(compared: Mapping[str, Column], results: Sequence[Result | None]) -> dict[str, Column]:
    """Return what is compared without that of which no row has a score: all rows are compared over the same."""
    return {
        key: column
        for key, column in compared.items()
        if any(_value(result, *column) is not None for result in results)
    }


def _seeds(columns: Sequence[Column], found: Sequence[Result | None]) -> str:
    """Write how many seeds the cells of a row are of, such as "1-3" where some data are scored for one seed alone."""
    if failed := sum(result is not None and bool(result.failure) for result in found):
        return str(failed)
    counts = {sum(_value(result, *column) is not None for result in found) for column in columns} - {0}
    if not counts:
        return NOT_RUN
    return "-".join(str(n) for n in sorted({min(counts), max(counts)}))


def _lines(units: Sequence[Unit], results: Sequence[Result | None]) -> Mapping[str, _Seeds]:
    found: dict[str, dict[int, Result | None]] = {}
    for unit, result in zip(units, results, strict=True):
        found.setdefault(unit.row.name, {})[unit.seed] = result
    return found


def _best(column: Sequence[Interval | None], *, higher_is_better: bool) -> list[int]:
    """Return the places of the best of those that have the most seeds; none where there is nothing to compare."""
    most = max((each.n for each in column if each is not None), default=0)
    there = {i: each.mean for i, each in enumerate(column) if each is not None and each.n == most}
    if len(there) < 2:
        return []
    best = (max if higher_is_better else min)(there.values())
    return [i for i, mean in there.items() if mean == best]


def _numbers(
    table: Table, row: Row, columns: Sequence[Column], found: Sequence[Result | None]
) -> tuple[list[str], dict[int, Interval]]:
    """Return the cells of a row, ours and the paper's in turn, and what was measured by the number of its cell."""
    cells: list[str] = []
    numbers: dict[int, Interval] = {}
    for data, metric in columns:
        values = [v for result in found if (v := _value(result, data, metric)) is not None]
        if any(result is not None and result.failure for result in found):
            cells.append(FAILED)
        elif values:
            interval = Interval.of(values)
            numbers[2 + len(cells)] = interval
            cells.append(str(interval))
        else:
            cells.append(NOT_RUN)
        cells.append(table.printed(row, (data, metric)) or "-")
    return cells, numbers


def _value(result: Result | None, data: str, metric: str) -> float | None:
    metrics = None if result is None else result.scores.get(data)
    value = None if metrics is None else metrics.get(metric)
    return value if value is not None and math.isfinite(value) else None


def _improvement(
    mri: Callable[[Mapping[str, float], Mapping[str, float]], float],
    mine: _Seeds,
    reference: _Seeds,
    compared: Mapping[str, Column],
) -> str:
    """Write the improvement over the reference, percent: the mean over the seeds that both rows have, and its interval.

    Rows are compared seed by seed: with one seed they start from one pre-training, and see the same photos in the same
    order.

    Args:
        mri: ``mri_datasets`` or ``mri_metrics``.
        mine: the results of the row.
        reference: the results of the row to compare with.
        compared: key of what ``mri`` takes → data set and metric. A seed with a part of them does not count.
    """
    ours, theirs = _scores(mine, compared), _scores(reference, compared)
    gains: list[float] = []
    for seed in ours.keys() & theirs.keys() if compared else ():
        try:
            gains.append(mri(ours[seed], theirs[seed]))
        except InputError:  # of a reference that is 0 there is no percentage, nor of a score that is not finite
            return "-"
    if not gains:
        return NOT_RUN
    gain = Interval.of(gains)
    return f"{gain.mean:+.1f} ± {gain.half:.1f}" if gain.half else f"{gain.mean:+.1f}"


def _scores(found: _Seeds, compared: Mapping[str, Column]) -> dict[int, dict[str, float]]:
    """Return seed → key → score, of seeds that have all of them; nothing where a training did not converge."""
    if any(result is not None and result.failure for result in found.values()):
        return {}
    scores = {
        seed: {key: value for key, column in compared.items() if (value := _value(result, *column)) is not None}
        for seed, result in found.items()
    }
    return {seed: values for seed, values in scores.items() if values.keys() == compared.keys()}


def _note(table: Table, units: Sequence[Unit], reference: str) -> str:
    note = (
        f"The rows differ in {table.variable}. Ours: the mean over the seeds ± half of its 95 % interval (Student's "
        f"t). paper: as printed there, at full size on its own data. mRI is relative to {reference}, seed by "
        "seed where both have run: mRI_D over the data sets that were scored, mRI_theta over delta1, REL and RMSE."
    )
    missing = sorted({name for unit in units for name in unit.missing})
    return f"{note} Rows that need {', '.join(missing)} were not run: these data were not there." if missing else note
