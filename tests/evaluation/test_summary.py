"""Numbers of many images, and the tables made of them."""

import dataclasses
import json
import math
from dataclasses import replace
from decimal import Decimal

import pytest

from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import INDOOR, OUTDOOR, Protocol, find_protocol
from zoedepth.evaluation.scoring import RANGES, Score
from zoedepth.evaluation.summary import (
    COLUMNS,
    NOT_RUN,
    Summary,
    Table,
    extras_table,
    ranges_table,
    results_table,
    summarise,
)
from zoedepth.evaluation.uncertainty import Calibration
from zoedepth.metrics import HEADINGS, Metrics, Sums, add_sums, mean_metrics, pooled_metrics

PROTOCOLS = {"indoor": INDOOR, "outdoor": OUTDOOR}


def sums_of(n_pixels: int, rel: float) -> Sums:
    """Of pixels with this REL; the other numbers follow from it in some way."""
    n = n_pixels
    return Sums(n, rel * n, 4 * rel**2 * n, rel * n / 2, n, n, n, rel * n, rel**2 * n / 16, rel * n / 8)


def score_of(
    rel: float | None, *, n_pixels: int = 100, domain: str = "indoor", routed: str | None = None, **more: object
) -> Score:
    """An image whose pixels are all between 1 and 2 m; of no known pixel without a REL."""
    if rel is None:
        return Score("photo.jpg", domain, routed, None)
    sums = sums_of(n_pixels, rel)
    ranges = tuple(sums if low == 1 else Sums() for low in RANGES[:-1])
    return Score("photo.jpg", domain, routed, sums, ranges, **more)


def summary_of(*scores: Score, source: str = "ours", protocols: dict[str, Protocol] = PROTOCOLS, **more) -> Summary:
    return summarise(source, "rooms", scores, protocols, **more)


# ---------------------------------------------------------------------------------------------------- summaries


def test_mean_is_over_images_and_the_other_over_pixels_or_the_other_way_round() -> None:
    scores = [score_of(0.1, n_pixels=300), score_of(0.5, n_pixels=100)]
    images, pixels = (
        f([one.sums for one in scores]) for f in (lambda s: mean_metrics([x.metrics() for x in s]), pooled_metrics)
    )
    assert (images.rel, pixels.rel) == (pytest.approx(0.3), pytest.approx(0.2))
    found = summary_of(*scores)
    assert (found.metrics, found.other_mean, found.mean) == (images, pixels, "images")
    found = summary_of(*scores, protocols={"indoor": replace(INDOOR, mean="pixels")})
    assert (found.metrics, found.other_mean, found.mean) == (pixels, images, "pixels")


def test_images_without_a_known_pixel_are_counted_and_in_no_mean() -> None:
    found = summary_of(score_of(0.1), score_of(None), score_of(0.3), n_failed=2)
    assert (found.n_images, found.n_scored, found.n_failed) == (3, 2, 2)
    assert found.metrics.rel == pytest.approx(0.2)


def test_nothing_scored_has_no_numbers() -> None:
    found = summary_of(score_of(None, routed="indoor"), n_failed=1)
    assert (found.n_images, found.n_scored, found.metrics, found.other_mean) == (1, 0, None, None)
    assert (found.domains, found.ranges, found.calibration, found.boundary_f1) == ({}, {}, {}, None)
    assert summary_of().router is None


def test_domains_are_apart_where_there_are_several() -> None:
    rooms, streets = [score_of(0.1), score_of(0.3)], [score_of(0.5, domain="outdoor")]
    found = summary_of(*rooms, *streets)
    assert found.metrics.rel == pytest.approx(0.3)
    assert {domain: m.rel for domain, m in found.domains.items()} == {
        "indoor": pytest.approx(0.2),
        "outdoor": pytest.approx(0.5),
    }
    assert summary_of(*rooms).domains == {}


def test_domains_have_the_kind_of_mean_of_all() -> None:
    pooled = {domain: replace(protocol, mean="pixels") for domain, protocol in PROTOCOLS.items()}
    scores = [score_of(0.1, n_pixels=300), score_of(0.5, n_pixels=100), score_of(0.5, domain="outdoor")]
    assert summary_of(*scores).domains["indoor"].rel == pytest.approx(0.3)
    assert summary_of(*scores, protocols=pooled).domains["indoor"].rel == pytest.approx(0.2)


def test_router_is_the_share_of_images_with_a_choice_that_took_their_own_head() -> None:
    right, wrong = score_of(0.1, routed="indoor"), score_of(0.1, routed="outdoor")
    no_choice, not_scored = score_of(0.1), score_of(None, routed="indoor")
    assert summary_of(right, wrong, wrong, no_choice, not_scored).router == 0.5
    assert summary_of(no_choice).router is None


def test_doubts_and_edges_are_means_over_the_images_that_have_them() -> None:
    found = summary_of(
        score_of(0.1, calibration=Calibration(0.2, 0.6, 0.9), boundary_f1=0.25),
        score_of(0.1, calibration=Calibration(0.4, 0.8, 1.0), boundary_f1=0.75),
        score_of(0.1),
    )
    assert found.calibration == {"ause": pytest.approx(0.3), "coverage1": 0.7, "coverage2": 0.95}
    assert found.boundary_f1 == 0.5


def test_ranges_are_pooled_and_have_their_share() -> None:
    near, far = sums_of(300, 0.1), sums_of(100, 0.5)
    ranges = tuple({1: near, 40: far}.get(low, Sums()) for low in RANGES[:-1])
    both = Score("a", "indoor", None, add_sums([near, far]), ranges)
    found = summary_of(both, score_of(0.3, n_pixels=400))
    assert list(found.ranges) == ["1-2", "40-80"]
    assert [entry["share"] for entry in found.ranges.values()] == [700 / 800, 100 / 800]
    assert found.ranges["1-2"]["rel"] == pytest.approx((300 * 0.1 + 400 * 0.3) / 700)
    assert found.ranges["40-80"]["rmse"] == pytest.approx(1.0)


def test_protocols_and_alignment_are_named() -> None:
    aligned = replace(INDOOR, alignment="median")
    found = summary_of(score_of(0.1), protocols={"indoor": aligned})
    assert (found.protocols, found.alignment) == ({"indoor": aligned.label}, "median")
    assert summary_of(score_of(0.1)).protocols == {"indoor": INDOOR.label, "outdoor": OUTDOOR.label}


@pytest.mark.parametrize("change", [{"mean": "pixels"}, {"alignment": "median"}])
def test_domains_that_are_averaged_or_aligned_in_different_ways_are_an_error(change: dict[str, str]) -> None:
    with pytest.raises(InputError, match="in one way"):
        summary_of(score_of(0.1), protocols={"indoor": INDOOR, "outdoor": replace(OUTDOOR, **change)})


def test_order_of_the_scores_does_not_matter_to_the_last_bit() -> None:
    scores = [
        score_of(0.1 * math.sqrt(i), n_pixels=7 * i, calibration=Calibration(0.1 * i, 0.3 * i, 0.7), boundary_f1=i / 7)
        for i in range(1, 12)
    ]
    assert summary_of(*scores) == summary_of(*scores[::-1]) == summary_of(*scores[5:], *scores[:5])


def test_summary_is_plain_values_for_json() -> None:
    found = summary_of(score_of(0.1, routed="indoor"), score_of(0.2, domain="outdoor"))
    values = json.loads(json.dumps(found.to_json()))
    assert values["metrics"] == dataclasses.asdict(found.metrics)
    assert values["protocols"] == {"indoor": INDOOR.label, "outdoor": OUTDOOR.label}
    assert set(values) == {f.name for f in dataclasses.fields(Summary)}


# ---------------------------------------------------------------------------------------------------- results


def metrics_of(**values: float) -> Metrics:
    return Metrics(**{**dict.fromkeys((f.name for f in dataclasses.fields(Metrics)), 0.5), **values})


def row_of(source: str, metrics: Metrics | None, **fields: object) -> Summary:
    """A summary of these metrics."""
    return replace(summary_of(score_of(0.1, routed="indoor"), source=source), metrics=metrics, **fields)


def bold(table: Table, column: str) -> list[str]:
    """Sources whose value in a column is bold."""
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


def test_published_rows_are_below_and_take_no_part_in_the_best() -> None:
    published = [("BTS", {"rel": Decimal("0.110"), "rmse": Decimal("0.392"), "delta1": None}), ("ZoeD-M12-N†", {})]
    rows = [row_of("a", metrics_of(rel=0.2)), row_of("b", metrics_of(rel=0.3))]
    table = results_table(rows, "nyu", published=published)
    assert table.rows[2:] == (
        ("BTS (paper)", "not run", "0.110", "0.392", "-", "-", "-", "-", "-", ""),
        ("ZoeD-M12-N† (paper)", "not run", *["-"] * 7, ""),
    )
    assert bold(table, "REL") == ["a"]
    note = f"its own images under its protocol, nyu#{find_protocol('nyu').hash}; not run: by us, here."
    assert table.note.endswith(note)
    assert table.note in table.markdown()
    assert "nyu\\#" in table.latex()
    assert results_table(rows, "nyu").note == ""


def test_published_model_that_is_scored_here_is_not_called_not_run():
    published = [("ZoeD-M12-N", {"rel": Decimal("0.075")})]
    table = results_table([row_of("zoed-m12-n", metrics_of(rel=0.2))], "nyu", published=published)
    assert table.rows[1][:2] == ("ZoeD-M12-N (paper)", "")


# ---------------------------------------------------------------------------------------------------- other tables


def test_extras_have_the_other_mean_edges_and_doubts() -> None:
    full = row_of(
        "ours",
        metrics_of(sq_rel=0.125, rmse_log=0.25),
        other_mean=metrics_of(rel=0.375, rmse=0.875),
        boundary_f1=0.3336,
        calibration={"ause": 0.4444, "coverage1": 0.684, "coverage2": 0.956},
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


# ---------------------------------------------------------------------------------------------------- text

AWKWARD = Table(
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
