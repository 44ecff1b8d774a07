"""Set summaries in tables: metrics, further measures, and errors by depth; as Markdown and LaTeX."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from html import escape
from itertools import pairwise
from typing import NamedTuple

from zoedepth.errors import InputError
from zoedepth.evaluation.improvement import mri_datasets, mri_metrics
from zoedepth.evaluation.protocols import PROTOCOLS
from zoedepth.evaluation.scoring import RANGES
from zoedepth.evaluation.summary import Summary
from zoedepth.metrics import HEADINGS, HIGHER_IS_BETTER

NOT_RUN = "not run"

COLUMNS = ("rel", "rmse", "log10", "delta1", "delta2", "delta3", "silog")
"""Fields of ``Metrics`` that the table of results shows."""


@dataclass(frozen=True)
class ReportTable:
    """Text in rows, to be shown on the console, in Markdown or in LaTeX."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    """Cells, as many a row as the header has."""
    best: frozenset[tuple[int, int]] = frozenset()
    """(row, column) of the cells to set in bold: the best value of a column."""
    note: str = ""
    """A sentence that stands below the table."""
    data: str = ""
    """Name of the data set that it is about."""

    def markdown(self) -> str:
        """Write the table as GitHub's Markdown."""
        body = [
            [f"**{cell}**" if (i, j) in self.best else cell for j, cell in enumerate(row)]
            for i, row in enumerate(self.rows)
        ]
        lines = [self.header, ["---", *["---:"] * (len(self.header) - 1)], *body]
        text = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        note = f"\n\n{self.note}" if self.note else ""
        return f"**{self.title}**\n\n{text}{note}\n"

    def html(self) -> str:
        """Write the table as HTML."""
        head = "".join(f"<th>{escape(cell)}</th>" for cell in self.header)
        body = "\n".join(
            "<tr>"
            + "".join(
                f'<td class="best">{escape(cell)}</td>' if (i, j) in self.best else f"<td>{escape(cell)}</td>"
                for j, cell in enumerate(row)
            )
            + "</tr>"
            for i, row in enumerate(self.rows)
        )
        note = f"<p>{escape(self.note)}</p>\n" if self.note else ""
        return (
            f'<div class="table"><table>\n<caption>{escape(self.title)}</caption>\n<thead><tr>{head}</tr></thead>\n'
            f"<tbody>\n{body}\n</tbody>\n</table></div>\n{note}"
        )

    def latex(self) -> str:
        """Write the table as LaTeX that uses the package booktabs."""
        body = [
            " & ".join(rf"\textbf{{{_tex(cell)}}}" if (i, j) in self.best else _tex(cell) for j, cell in enumerate(row))
            for i, row in enumerate(self.rows)
        ]
        lines = [
            r"\begin{table}[t]",
            r"\centering",
            rf"\begin{{tabular}}{{l{'r' * (len(self.header) - 1)}}}",
            r"\toprule",
            " & ".join(map(_tex, self.header)) + r" \\",
            r"\midrule",
            *(line + r" \\" for line in body),
            r"\bottomrule",
            r"\end{tabular}",
            rf"\caption{{{_tex('. '.join(filter(None, (self.title, self.note))))}}}",
            r"\end{table}",
        ]
        return "\n".join(lines) + "\n"


def _tex(text: str) -> str:
    special = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    return "".join(special.get(c, f"\\{c}" if c in "&%$#_{}" else c) for c in text)


def report_tables(
    summaries: Sequence[Summary],
    paper: Mapping[str, Sequence[tuple[str, Mapping[str, object]]]],
    *,
    best_only: bool = False,
) -> list[ReportTable]:
    """Make three tables for each data set: the metrics, further measures, and REL by true depth.

    Where no image of a data set could be scored, there is the first of them only.

    Args:
        summaries: one for each source on each data set.
        paper: data set → (method, metric → value as printed) of the paper.
        best_only: see ``results_table``.
    """
    found = []
    for data in dict.fromkeys(summary.data for summary in summaries):
        mine = [summary for summary in summaries if summary.data == data]
        found.append(results_table(mine, data, paper=paper.get(data, ()), best_only=best_only))
        if any(summary.metrics is not None for summary in mine):
            found += [extras_table(mine, data), ranges_table(mine, data)]
    return found


def results_table(
    summaries: Sequence[Summary],
    data: str,
    *,
    paper: Sequence[tuple[str, Mapping[str, object]]] = (),
    best_only: bool = False,
) -> ReportTable:
    """Set the metrics of all sources on one data set, best values in bold; with the paper's rows, all sorted by REL.

    Args:
        summaries: the summaries of all sources on this data set.
        data: its name.
        paper: (method, metric → value as printed) of the paper; they are not compared with ours.
        best_only: show the sources' own rows, and the one with the lowest REL, alone from the paper.
    """
    lines = [_our_line(summary) for summary in summaries]
    notes = [_holes(summary) for summary in summaries if summary.holes > 0]
    if paper:
        sources = {summary.source.lower() for summary in summaries}
        shown = _best_rows(paper, sources) if best_only else paper
        lines += [_paper_line(method, numbers, run=method.lower() in sources) for method, numbers in shown]
        lines.sort(key=lambda line: (line.aligned, line.rel))
        theirs = f"{data}#{PROTOCOLS[data].hash}" if data in PROTOCOLS else "its own"
        notes += [f"(paper): as printed there, on its own images under its protocol, {theirs}; {NOT_RUN}: by us, here."]
        if len(shown) < len(paper):
            notes += [f"The paper has {len(paper)} rows: --with-paper all."]
    comparable = [i for i, line in enumerate(lines) if line.metrics is not None and not line.aligned]
    best = set()
    for j, name in enumerate(COLUMNS, start=2):
        values = [line.metrics[name] for i, line in enumerate(lines) if i in comparable and line.metrics is not None]
        if len(values) > 1:
            top = max(values) if name in HIGHER_IS_BETTER else min(values)
            best |= {(i, j) for i in comparable if lines[i].cells[j] == _number(name, top)}
    labels = sorted({label for summary in summaries for label in summary.protocols.values()})
    kind = {summary.mean for summary in summaries}
    title = f"{data}: protocol {', '.join(labels)}; mean over {' and '.join(sorted(kind))}"
    header = ("source", "images", *(HEADINGS[name] for name in COLUMNS), "router")
    return ReportTable(title, header, tuple(line.cells for line in lines), frozenset(best), " ".join(notes), data)


def _holes(summary: Summary) -> str:
    share = f"{100 * summary.holes:.1f} %" if summary.holes >= 0.001 else "less than 0.1 %"
    return (
        f"{summary.source} has no depth at {share} of the scored pixels: each of them counts as the nearest depth, or, "
        "where it is infinite, as the farthest."
    )


class _Line(NamedTuple):
    """A row of the table of results, and what it is sorted and compared by."""

    cells: tuple[str, ...]
    rel: float
    metrics: dict[str, float] | None = None
    aligned: bool = False


def _our_line(summary: Summary) -> _Line:
    metrics = None if summary.metrics is None else asdict(summary.metrics)
    numbers = [NOT_RUN if metrics is None else _number(name, metrics[name]) for name in COLUMNS]
    aligned = "" if summary.alignment == "none" else f" ({summary.alignment}-aligned)"
    camera = "" if summary.camera == "none" else f" (camera of the {summary.camera})"
    router = "" if summary.router is None else f"{100 * summary.router:.1f} %"
    fast = f" ({summary.fast})" if summary.fast else ""
    cells = (f"{summary.source}{fast}{camera}{aligned}", str(summary.n_scored), *numbers, router)
    return _Line(cells, math.inf if metrics is None else metrics["rel"], metrics, bool(aligned))


def _paper_line(method: str, numbers: Mapping[str, object], *, run: bool) -> _Line:
    shown = ["-" if numbers.get(name) is None else str(numbers[name]) for name in COLUMNS]  # as printed
    return _Line((f"{method} (paper)", "" if run else NOT_RUN, *shown, ""), _paper_rel(numbers))


def _paper_rel(numbers: Mapping[str, object]) -> float:
    return math.inf if numbers.get("rel") is None else float(str(numbers["rel"]))


def _best_rows(
    paper: Sequence[tuple[str, Mapping[str, object]]], sources: set[str]
) -> list[tuple[str, Mapping[str, object]]]:
    best, _ = min(paper, key=lambda row: _paper_rel(row[1]))
    return [row for row in paper if row[0] == best or row[0].lower() in sources]


def extras_table(summaries: Sequence[Summary], data: str) -> ReportTable:
    """Set the measures that the paper does not have: the other kind of mean, sharp edges, and uncertainty."""
    rows = []
    for summary in summaries:
        other, found = summary.other_mean, summary.uncertainty
        rows.append((
            summary.source,
            "-" if other is None else _number("rel", other.rel),
            "-" if other is None else _number("rmse", other.rmse),
            "-" if summary.metrics is None else _number("sq_rel", summary.metrics.sq_rel),
            "-" if summary.metrics is None else _number("rmse_log", summary.metrics.rmse_log),
            "-" if summary.boundary_f1 is None else f"{summary.boundary_f1:.3f}",
            f"{found['ause']:.3f}" if found else "-",
            f"{100 * found['coverage1']:.0f} %" if found else "-",
            f"{100 * found['coverage2']:.0f} %" if found else "-",
        ))  # fmt: skip
    other = "pixels" if all(summary.mean == "images" for summary in summaries) else "images"
    header = ("source", f"REL over {other}", f"RMSE over {other}", "SqRel", "RMSE log", "edge F1", "AUSE",
              "within 1 std", "within 2 std")  # fmt: skip
    return ReportTable(f"{data}: further measures", header, tuple(rows), data=data)


def ranges_table(summaries: Sequence[Summary], data: str) -> ReportTable:
    """Set REL by true depth, over all pixels of all images at once."""
    names = [f"{low:g}-{high:g}" for low, high in pairwise(RANGES)]
    names = [name for name in names if any(name in summary.ranges for summary in summaries)]
    shares = next((summary.ranges for summary in summaries if summary.ranges), {})
    rows = [("share of pixels", *(f"{100 * shares[name]['share']:.1f} %" if name in shares else "-" for name in names))]
    for summary in summaries:
        cells = (f"{summary.ranges[name]['rel']:.3f}" if name in summary.ranges else "-" for name in names)
        rows.append((summary.source, *cells))
    return ReportTable(f"{data}: REL by true depth, pooled over pixels", ("metres", *names), tuple(rows), data=data)


def mri_table(summaries: Sequence[Summary], reference: str) -> ReportTable:
    """Set the mean relative improvements over a source, percent: mRI_theta on each data set, mRI_D over all of them.

    mRI_theta is over delta1, REL and RMSE of a data set, mRI_D over the REL of the data sets (paper section 4.3).

    Args:
        summaries: one for each source on each data set.
        reference: label of the source that the others are compared with.

    Raises:
        InputError: no source has that label.
    """
    labels = list(dict.fromkeys(summary.source for summary in summaries))
    if reference not in labels:
        raise InputError(f"the reference of mRI is {reference!r}, which is not scored: give one of {labels}")
    names = list(dict.fromkeys(summary.data for summary in summaries))
    # What has no prediction for some photos has the metrics of others.
    metrics = {(s.source, s.data): asdict(s.metrics) for s in summaries if s.metrics is not None and not s.n_failed}
    rows = []
    for label in labels:
        cells = [mri_cell(mri_metrics, metrics.get((label, name)), metrics.get((reference, name))) for name in names]
        mine, theirs = (
            {name: metrics[source, name]["rel"] for name in names if (source, name) in metrics}
            for source in (label, reference)
        )
        complete = len(mine) == len(theirs) == len(names)
        rows.append((label, *cells, mri_cell(mri_datasets, mine, theirs) if complete else NOT_RUN))
    header = ("source", *(f"mRI_theta {name}" for name in names), "mRI_D")
    note = (
        "mRI_theta: mean improvement of delta1, REL and RMSE on a data set; mRI_D: of REL, mean over the data sets. "
        "Both are in percent of the reference; more is better."
    )
    if any(summary.n_failed for summary in summaries):
        note += f" {NOT_RUN}: where photos failed, since the others would be compared with all."
    return ReportTable(f"Mean relative improvement over {reference}, %", header, tuple(rows), note=note)


def mri_cell(
    mean: Callable[[Mapping[str, float], Mapping[str, float]], float],
    mine: Mapping[str, float] | None,
    reference: Mapping[str, float] | None,
) -> str:
    """Write a mean relative improvement; a dash where the reference's score is 0, so that it has no percentage.

    Args:
        mean: ``mri_datasets`` or ``mri_metrics``.
        mine: the scores of which it is; None where this was not run.
        reference: the scores that they are compared with; None where this was not run.
    """
    if not mine or not reference:
        return NOT_RUN
    try:
        return f"{mean(mine, reference):+.1f}"
    except InputError:
        return "-"


def _number(name: str, value: float) -> str:
    return f"{value:.2f}" if name == "silog" else f"{value:.3f}"
