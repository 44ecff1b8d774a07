"""The numbers of one source on one data set, and tables of many."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from statistics import fmean
from typing import Any

from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import PROTOCOLS, Protocol
from zoedepth.evaluation.scoring import RANGES, Score
from zoedepth.metrics import HEADINGS, HIGHER_IS_BETTER, Metrics, add_sums, mean_metrics, pooled_metrics

NOT_RUN = "not run"


@dataclass(frozen=True)
class Summary:
    """What is reported of one source on one data set."""

    source: str
    data: str
    protocols: dict[str, str]
    """Domain → name#hash of its protocol."""
    n_images: int
    n_scored: int
    """Images with a known pixel under the protocol; the others are counted, and in no mean."""
    n_failed: int
    metrics: Metrics | None
    """Under the protocol's kind of mean; None where nothing could be scored."""
    other_mean: Metrics | None
    """Under the other kind."""
    mean: str
    """"images" or "pixels": the protocol's kind of mean."""
    domains: dict[str, Metrics]
    """By the domain of the data, where there are several."""
    ranges: dict[str, dict[str, float]]
    """"1-2" (metres of true depth) → share of the scored pixels, and pooled metrics."""
    router: float | None
    """Share of images routed to the head of their own domain, where there is a choice."""
    calibration: dict[str, float]
    """Means over images of AUSE and coverages, where the source says how sure it is."""
    boundary_f1: float | None
    """Mean over images whose truth is dense enough."""
    alignment: str
    """"none", or what the prediction was given of the truth first."""

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def summarise(
    source: str, data: str, scores: Sequence[Score], protocols: Mapping[str, Protocol], *, n_failed: int = 0
) -> Summary:
    """The numbers of one source on one data set. The order of the scores does not matter.

    Raises:
        InputError: the domains' protocols average or align in different ways.
    """
    used = {protocol.mean for protocol in protocols.values()}, {protocol.alignment for protocol in protocols.values()}
    if any(len(kinds) > 1 for kinds in used):
        raise InputError("the protocols of one data set must average and align in one way")
    mean, alignment = used[0].pop(), used[1].pop()
    scored = [score for score in scores if score.sums is not None]
    images, pixels = _means(scored)
    domains = sorted({score.domain for score in scored})
    routed = [score for score in scores if score.routed is not None]
    calibrated = [score.calibration for score in scored if score.calibration is not None]
    edges = [score.boundary_f1 for score in scored if score.boundary_f1 is not None]
    return Summary(
        source=source,
        data=data,
        protocols={domain: protocol.label for domain, protocol in sorted(protocols.items())},
        n_images=len(scores),
        n_scored=len(scored),
        n_failed=n_failed,
        metrics=images if mean == "images" else pixels,
        other_mean=pixels if mean == "images" else images,
        mean=mean,
        domains={
            domain: found
            for domain in domains
            if (found := _means([s for s in scored if s.domain == domain])[mean == "pixels"]) and len(domains) > 1
        },
        ranges=_ranges(scored),
        router=sum(score.routed == score.domain for score in routed) / len(routed) if routed else None,
        calibration={f.name: fmean(getattr(found, f.name) for found in calibrated) for f in fields(calibrated[0])}
        if calibrated
        else {},
        boundary_f1=fmean(edges) if edges else None,
        alignment=alignment,
    )


def _means(scored: Sequence[Score]) -> tuple[Metrics | None, Metrics | None]:
    """Over images, and over pixels."""
    sums = [score.sums for score in scored if score.sums is not None]
    if not sums:
        return None, None
    return mean_metrics([one.metrics() for one in sums]), pooled_metrics(sums)


def _ranges(scored: Sequence[Score]) -> dict[str, dict[str, float]]:
    total = sum(score.sums.n_pixels for score in scored if score.sums is not None)
    found = {}
    for i, (low, high) in enumerate(pairwise(RANGES)):
        sums = add_sums([score.ranges[i] for score in scored if score.ranges])
        if sums.n_pixels:
            found[f"{low:g}-{high:g}"] = {"share": sums.n_pixels / total, **asdict(sums.metrics())}
    return found


# --- tables -----------------------------------------------------------------------------------------------------------

COLUMNS = ("rel", "rmse", "log10", "delta1", "delta2", "delta3", "silog")


@dataclass(frozen=True)
class Table:
    """Text in rows, for the console, Markdown and LaTeX."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    best: frozenset[tuple[int, int]] = frozenset()
    """(row, column) of the best value of its group, set in bold."""
    note: str = ""
    """A sentence below."""

    def markdown(self) -> str:
        """GitHub's tables."""
        body = [
            [f"**{cell}**" if (i, j) in self.best else cell for j, cell in enumerate(row)]
            for i, row in enumerate(self.rows)
        ]
        lines = [self.header, ["---", *["---:"] * (len(self.header) - 1)], *body]
        text = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        note = f"\n\n{self.note}" if self.note else ""
        return f"**{self.title}**\n\n{text}{note}\n"

    def latex(self) -> str:
        """For booktabs."""
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


def results_table(
    summaries: Sequence[Summary], data: str, *, published: Sequence[tuple[str, Mapping[str, object]]] = ()
) -> Table:
    """All sources on one data set, best values in bold; below them what was published on it.

    Args:
        summaries: of this data set.
        data: its name.
        published: (method, metric → value as printed) of the paper; they take no part in what is best.
    """
    rows, values = [], []
    for summary in summaries:
        metrics = None if summary.metrics is None else asdict(summary.metrics)
        values.append(metrics)
        cells = [NOT_RUN if metrics is None else _number(name, metrics[name]) for name in COLUMNS]
        aligned = "" if summary.alignment == "none" else f" ({summary.alignment}-aligned)"
        router = "" if summary.router is None else f"{100 * summary.router:.1f} %"
        rows.append((f"{summary.source}{aligned}", str(summary.n_scored), *cells, router))
    for method, numbers in published:
        cells = ["-" if numbers.get(name) is None else str(numbers[name]) for name in COLUMNS]  # as printed
        run = any(summary.source.lower() == method.lower() for summary in summaries)
        rows.append((f"{method} (paper)", "" if run else NOT_RUN, *cells, ""))
    best = set()
    comparable = [i for i, summary in enumerate(summaries) if values[i] is not None and summary.alignment == "none"]
    if len(comparable) > 1:
        for j, name in enumerate(COLUMNS, start=2):
            shown = {i: values[i][name] for i in comparable}
            top = max(shown.values()) if name in HIGHER_IS_BETTER else min(shown.values())
            best |= {(i, j) for i in comparable if rows[i][j] == _number(name, top)}
    labels = sorted({label for summary in summaries for label in summary.protocols.values()})
    kind = {summary.mean for summary in summaries}
    title = f"{data}: protocol {', '.join(labels)}; mean over {' and '.join(sorted(kind))}"
    header = ("source", "images", *(HEADINGS[name] for name in COLUMNS), "router")
    note = ""
    if published:
        theirs = f"{data}#{PROTOCOLS[data].hash}" if data in PROTOCOLS else "its own"
        note = f"(paper): as printed there, on its own images under its protocol, {theirs}; {NOT_RUN}: by us, here."
    return Table(title, header, tuple(rows), frozenset(best), note)


def extras_table(summaries: Sequence[Summary], data: str) -> Table:
    """What is beyond the paper's metrics: the other mean, sharpness, and whether the model knows its errors."""
    rows = []
    for summary in summaries:
        other, found = summary.other_mean, summary.calibration
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
    return Table(f"{data}: more of the same images", header, tuple(rows))


def ranges_table(summaries: Sequence[Summary], data: str) -> Table:
    """REL by true depth, pooled over pixels."""
    names = [f"{low:g}-{high:g}" for low, high in pairwise(RANGES)]
    names = [name for name in names if any(name in summary.ranges for summary in summaries)]
    shares = next((summary.ranges for summary in summaries if summary.ranges), {})
    rows = [("share of pixels", *(f"{100 * shares[name]['share']:.1f} %" if name in shares else "-" for name in names))]
    for summary in summaries:
        cells = (f"{summary.ranges[name]['rel']:.3f}" if name in summary.ranges else "-" for name in names)
        rows.append((summary.source, *cells))
    return Table(f"{data}: REL by true depth, pooled over pixels", ("metres", *names), tuple(rows))


def _number(name: str, value: float) -> str:
    return f"{value:.2f}" if name == "silog" else f"{value:.3f}"
