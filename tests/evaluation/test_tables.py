"""Tables of the numbers of many sources, as Markdown and LaTeX."""

import dataclasses
from dataclasses import replace
from decimal import Decimal

import pytest

from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import INDOOR, OUTDOOR, find_protocol
from zoedepth.evaluation.summary import Summary
from zoedepth.evaluation.tables import (
    COLUMNS,
    NOT_RUN,
    ReportTable,
    extras_table,
    mri_table,
    ranges_table,
    report_tables,
    results_table,
)
from zoedepth.metrics import HEADINGS, Metrics

SUMMARY = Summary(
    source="ours",
    data="rooms",
    protocols={"indoor": INDOOR.label, "outdoor": OUTDOOR.label},
    n_images=1,
    n_scored=1,
    n_failed=0,
    metrics=None,
    other_mean=None,
    mean="images",
    domains={},
    ranges={},
    router=1.0,
    uncertainty={},
    boundary_f1=None,
    alignment="none",
)

# ---------------------------------------------------------------------------------------------------- results


def metrics_of(**values: float) -> Metrics:
    return Metrics(**{**dict.fromkeys((f.name for f in dataclasses.fields(Metrics)), 0.5), **values})


def row_of(source: str, metrics: Metrics | None, **fields: object) -> Summary:
    """Make a summary of these metrics."""
    return replace(SUMMARY, source=source, metrics=metrics, **fields)


def bold(table: ReportTable, column: str) -> list[str]:
    """Return the sources whose value in a column is bold."""
    return [row[0] for i, row in enumerate(table.rows) if (i, table.header.index(column)) in table.best]


def test_results_are_a_row_a_source_under_the_protocol_and_kind_of_mean() -> None:
    metrics = Metrics(0.0754, 0.27049, 0.0324, 0.9546, 0.9951, 0.9994, 8.126, 0.1, 0.2)
    table = results_table([row_of("ours", metrics), row_of("theirs", metrics, router=None)], "rooms")
    assert table.title == f"rooms: protocol {INDOOR.label}, {OUTDOOR.label}; mean over images"
    assert table.header == (
        "source", "images", "REL", "RMSE (m)", "log10", "delta1", "delta2", "delta3", "SILog", "router",
    )  # fmt: skip
    numbers = ("1", "0.075", "0.270", "0.032", "0.955", "0.995", "0.999", "8.13")
    assert table.rows == (("ours", *numbers, "100.0 %"), ("theirs", *numbers, ""))


@pytest.mark.parametrize("name", COLUMNS)
def test_best_is_the_highest_of_agreements_and_the_lowest_of_errors(name: str) -> None:
    rows = [row_of(f"{value}", metrics_of(**{name: value})) for value in (0.5, 0.25, 0.75)]
    table = results_table(rows, "rooms")
    assert bold(table, HEADINGS[name]) == ["0.75" if name.startswith("delta") else "0.25"]


def test_values_that_print_the_same_share_the_best() -> None:
    rows = [row_of(f"{i}", metrics_of(rel=rel)) for i, rel in enumerate((0.1001, 0.0999, 0.2))]
    assert bold(results_table(rows, "rooms"), "REL") == ["0", "1"]


def test_single_source_is_not_its_own_best() -> None:
    assert not results_table([row_of("ours", metrics_of())], "rooms").best


def test_source_without_a_scored_image_was_not_run_and_is_no_best() -> None:
    rows = [row_of("none", None, router=None), row_of("ours", metrics_of()), row_of("theirs", metrics_of(rel=0.75))]
    table = results_table(rows, "rooms")
    assert table.rows[0][2:] == (*[NOT_RUN] * len(COLUMNS), "")
    assert bold(table, "REL") == ["ours"]


def test_data_without_a_scored_image_has_one_table() -> None:
    rows = [row_of("none", None, data="rooms"), row_of("none", metrics_of(), data="streets")]
    titles = [table.title.partition(":")[0] for table in report_tables(rows, {})]
    assert titles == ["rooms", "streets", "streets", "streets"]


def test_holes_are_told_below_the_table() -> None:
    rows = [row_of("theirs", metrics_of(), holes=0.123), row_of("few", metrics_of(), holes=1e-6), row_of("ours", None)]
    note = results_table(rows, "rooms").note
    assert "theirs has no depth at 12.3 % of the scored pixels: each of them counts as the nearest depth" in note
    assert "few has no depth at less than 0.1 %" in note
    assert "ours" not in note


def test_aligned_source_says_so_and_is_not_compared() -> None:
    rows = [
        row_of("a", metrics_of(rel=0.1), alignment="median"),
        row_of("b", metrics_of(rel=0.2)),
        row_of("c", metrics_of(rel=0.3)),
        row_of("d", metrics_of(rel=0.1), alignment="disparity"),
    ]
    table = results_table(rows, "rooms")
    assert [row[0] for row in table.rows] == ["a (median-aligned)", "b", "c", "d (disparity-aligned)"]
    assert bold(table, "REL") == ["b"]


PAPER = [
    ("BTS", {"rel": Decimal("0.250"), "rmse": Decimal("0.392"), "delta1": None}),
    ("ZoeD-M12-N†", {}),
    ("ZoeD-M12-N", {"rel": Decimal("0.075")}),
    ("DORN", {"rel": Decimal("0.115")}),
]


def test_rows_of_the_paper_are_among_ours_by_rel_and_take_no_part_in_the_best() -> None:
    rows = [row_of("b", metrics_of(rel=0.3)), row_of("a", metrics_of(rel=0.2)), row_of("none", None)]
    table = results_table(rows, "nyu", paper=PAPER)
    assert [row[0] for row in table.rows] == [
        "ZoeD-M12-N (paper)", "DORN (paper)", "a", "BTS (paper)", "b", "none", "ZoeD-M12-N† (paper)",
    ]  # fmt: skip
    assert table.rows[3] == ("BTS (paper)", "not run", "0.250", "0.392", "-", "-", "-", "-", "-", "")
    assert table.rows[6] == ("ZoeD-M12-N† (paper)", "not run", *["-"] * 7, "")
    assert bold(table, "REL") == ["a"]
    assert bold(table, "SILog") == ["a", "b"]
    note = f"its own images under its protocol, nyu#{find_protocol('nyu').hash}; not run: by us, here."
    assert table.note.endswith(note)
    assert table.note in table.markdown()
    assert "nyu\\#" in table.latex()
    assert results_table(rows, "nyu").note == ""


def test_sources_keep_their_order_without_the_paper_and_aligned_ones_are_last_with_it() -> None:
    rows = [row_of("a", metrics_of(rel=0.1), alignment="median"), row_of("c", metrics_of(rel=0.3)),
            row_of("b", metrics_of(rel=0.2))]  # fmt: skip
    assert [row[0] for row in results_table(rows, "rooms").rows] == ["a (median-aligned)", "c", "b"]
    with_paper = results_table(rows, "rooms", paper=PAPER[:1])
    assert [row[0] for row in with_paper.rows] == ["b", "BTS (paper)", "c", "a (median-aligned)"]


def test_best_of_the_paper_is_one_row_beside_those_of_the_sources() -> None:
    table = results_table([row_of("dorn", metrics_of(rel=0.2))], "nyu", paper=PAPER, best_only=True)
    assert [row[:2] for row in table.rows] == [
        ("ZoeD-M12-N (paper)", "not run"),
        ("DORN (paper)", ""),  # is run here
        ("dorn", "1"),
    ]
    assert table.note.endswith("The paper has 4 rows: --with-paper all.")
    assert "rows" not in results_table([], "nyu", paper=PAPER[:1], best_only=True).note


# ---------------------------------------------------------------------------------------------------- other tables


def test_extras_have_the_other_mean_edges_and_doubts() -> None:
    full = row_of(
        "ours",
        metrics_of(sq_rel=0.125, rmse_log=0.25),
        other_mean=metrics_of(rel=0.375, rmse=0.875),
        boundary_f1=0.3336,
        uncertainty={"ause": 0.4444, "coverage1": 0.684, "coverage2": 0.956},
    )
    empty = row_of("none", None, other_mean=None)
    table = extras_table([full, empty], "rooms")
    assert table.header == (
        "source", "REL over pixels", "RMSE over pixels", "SqRel", "RMSE log", "edge F1", "AUSE", "within 1 std",
        "within 2 std",
    )  # fmt: skip
    assert table.rows == (
        ("ours", "0.375", "0.875", "0.125", "0.250", "0.334", "0.444", "68 %", "96 %"),
        ("none", *["-"] * 8),
    )
    assert extras_table([replace(full, mean="pixels")], "rooms").header[1] == "REL over images"
    assert extras_table([full, replace(full, mean="pixels")], "rooms").header[1] == "REL over images"


def test_ranges_have_a_column_where_any_source_has_pixels() -> None:
    near = row_of("near", metrics_of(), ranges={"0-1": {"share": 0.25, "rel": 0.1}, "1-2": {"share": 0.75, "rel": 0.2}})
    far = row_of("far", metrics_of(), ranges={"1-2": {"share": 0.5, "rel": 0.3}, "20-40": {"share": 0.5, "rel": 0.4}})
    table = ranges_table([row_of("none", None, ranges={}), near, far], "rooms")
    assert table.header == ("metres", "0-1", "1-2", "20-40")
    assert table.rows == (
        ("share of pixels", "25.0 %", "75.0 %", "-"),
        ("none", "-", "-", "-"),
        ("near", "0.100", "0.200", "-"),
        ("far", "-", "0.300", "0.400"),
    )


def test_data_set_has_three_tables_and_the_papers_rows() -> None:
    summaries = [
        row_of("ours", metrics_of()),
        row_of("theirs", metrics_of()),
        row_of("ours", metrics_of(), data="a_b"),
    ]
    found = report_tables(summaries, {"rooms": [("BTS", {"rel": 0.5})], "elsewhere": [("DORN", {"rel": 0.5})]})
    assert [table.title.split(":")[0] for table in found] == ["rooms"] * 3 + ["a_b"] * 3
    assert [row[0] for row in found[0].rows] == ["ours", "theirs", "BTS (paper)"]
    assert [row[0] for row in found[1].rows] == ["ours", "theirs"]
    assert [row[0] for row in found[2].rows] == ["share of pixels", "ours", "theirs"]
    assert [row[0] for row in found[3].rows] == ["ours"]


# ---------------------------------------------------------------------------------------------------- text

AWKWARD = ReportTable(
    "a_b: 100 % & more", ("source", "REL"), (("x|y_z #1 {50%} $\\~^", "0.1"), ("plain", "0.2")), frozenset({(0, 1)})
)


def test_markdown_has_bold_best_and_escaped_bars() -> None:
    assert AWKWARD.markdown() == (
        "**a_b: 100 % & more**\n"
        "\n"
        "| source | REL |\n"
        "| --- | ---: |\n"
        "| x\\|y_z #1 {50%} $\\~^ | **0.1** |\n"
        "| plain | 0.2 |\n"
    )


def test_html_has_bold_best_and_escaped_characters() -> None:
    table = replace(AWKWARD, header=("<b>", "REL"), rows=(("x & <i>y", "0.1"), ("plain", "0.2")), note="a < b")
    assert table.html() == (
        '<div class="table"><table>\n'
        "<caption>a_b: 100 % &amp; more</caption>\n"
        "<thead><tr><th>&lt;b&gt;</th><th>REL</th></tr></thead>\n"
        "<tbody>\n"
        '<tr><td>x &amp; &lt;i&gt;y</td><td class="best">0.1</td></tr>\n'
        "<tr><td>plain</td><td>0.2</td></tr>\n"
        "</tbody>\n"
        "</table></div>\n"
        "<p>a &lt; b</p>\n"
    )


def test_latex_has_bold_best_and_escaped_special_characters() -> None:
    lines = AWKWARD.latex().splitlines()
    assert r"\begin{tabular}{lr}" in lines
    assert r"source & REL \\" in lines
    cell = r"x|y\_z \#1 \{50\%\} \$\textbackslash{}\textasciitilde{}\textasciicircum{}"
    assert rf"{cell} & \textbf{{0.1}} \\" in lines
    assert r"plain & 0.2 \\" in lines
    assert r"\caption{a\_b: 100 \% \& more}" in lines
    for mark in (r"\toprule", r"\midrule", r"\bottomrule", r"\begin{table}[t]", r"\end{tabular}", r"\end{table}"):
        assert lines.count(mark) == 1


# ---------------------------------------------------------------------------------------------------- mRI


def scored(source: str, data: str, rel: float, *, delta1: float = 0.5) -> Summary:
    metrics = Metrics(*([1.0] * len(dataclasses.fields(Metrics))))
    return replace(SUMMARY, source=source, data=data, metrics=replace(metrics, rel=rel, rmse=2.0, delta1=delta1))


def test_mean_relative_improvement_is_over_a_source_on_each_data_set_and_over_all() -> None:
    table = mri_table(
        [
            scored("old", "a", 0.2),
            scored("new", "a", 0.1, delta1=0.6),
            scored("old", "b", 0.1),
            scored("new", "b", 0.12),
        ],
        "old",
    )
    assert table.header == ("source", "mRI_theta a", "mRI_theta b", "mRI_D")
    # On a: REL +50 %, delta1 +20 %, RMSE the same. On b: REL -20 %. REL over both: (50 - 20) / 2.
    assert table.rows == (("old", "+0.0", "+0.0", "+0.0"), ("new", "+23.3", "-6.7", "+15.0"))


def test_mean_relative_improvement_needs_numbers_and_a_reference() -> None:
    summaries = [scored("old", "a", 0.2, delta1=0.0), scored("new", "a", 0.1), replace(SUMMARY, source="new", data="b")]
    table = mri_table(summaries, "old")
    assert table.rows[1] == ("new", "-", NOT_RUN, NOT_RUN)  # of a delta1 of 0 there is no percentage
    partly = mri_table([scored("old", "a", 0.2), replace(scored("new", "a", 0.1), n_failed=1)], "old")
    assert partly.rows[1] == ("new", NOT_RUN, NOT_RUN)  # of other photos than the reference
    assert "where photos failed" in partly.note
    with pytest.raises(InputError, match=r"'older', which is not scored: give one of \['old', 'new'\]"):
        mri_table(summaries, "older")
