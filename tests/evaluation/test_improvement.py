"""Relative improvement by hand, and every mean that the paper prints from the scores that it prints."""

import re
from collections.abc import Iterator
from decimal import Decimal
from itertools import product
from pathlib import Path

import pytest

from zoedepth.errors import InputError
from zoedepth.evaluation.improvement import mri_datasets, mri_metrics, relative_improvement
from zoedepth.evaluation.paper_numbers import ALL, MriEntry, datasets, mri_entries

DOCS = Path(__file__).parents[2] / "docs" / "published.md"

OTHER_DIGIT = {("table-3", "ibims", "LocalBins"): 0.236}
"""Entries whose printed digit does not follow from the printed scores → printed less recomputed, percent points."""

BEYOND_ROUNDING: dict[tuple[str, str, str], float] = {}
"""Entries that no scores give, whatever was rounded to the printed ones."""

REFERENCES = ("NeWCRFs-X-NK†", "NeWCRFs")


# ---------------------------------------------------------------------------------------- relative_improvement


@pytest.mark.parametrize(
    ("value", "reference", "higher_is_better", "expected"),
    [
        (0.5, 2.0, False, 75.0),
        (3.0, 2.0, False, -50.0),
        (0.5, 2.0, True, -75.0),
        (3.0, 2.0, True, 50.0),
        (2.0, 2.0, True, 0.0),
        (0.0, 2.0, False, 100.0),
        (0.25, 0.01, True, 2400.0),
    ],
)
def test_relative_improvement_by_hand(value: float, reference: float, higher_is_better: bool, expected: float) -> None:
    found = relative_improvement(value, reference, higher_is_better=higher_is_better)
    assert found == pytest.approx(expected)


@pytest.mark.parametrize(
    ("value", "reference", "expected"),
    [
        # Section 5.1 and 5.2: ZoeD-X-N and ZoeD-M12-NK over NeWCRFs, REL on NYU.
        (0.082, 0.095, 13.7),
        (0.077, 0.095, 18.9),
        # The shared head loses 8 % against ZoeD-M12-N.
        (0.081, 0.075, -8.0),
    ],
)
def test_relative_improvement_of_the_papers_text(value: float, reference: float, expected: float) -> None:
    assert round(relative_improvement(value, reference, higher_is_better=False), 1) == expected


@pytest.mark.parametrize(("value", "reference"), [(1.0, 0.0), (1.0, -1.0), (1.0, float("nan")), (float("inf"), 1.0)])
def test_scores_that_give_no_improvement_are_an_error(value: float, reference: float) -> None:
    with pytest.raises(InputError, match="reference > 0"):
        relative_improvement(value, reference, higher_is_better=True)


# ---------------------------------------------------------------------------------------- means


def test_mean_over_datasets_by_hand() -> None:
    # (75 - 50) / 2
    assert mri_datasets({"nyu": 0.5, "kitti": 3.0}, {"kitti": 2.0, "nyu": 2.0}) == pytest.approx(12.5)


def test_mean_over_metrics_by_hand() -> None:
    # delta1 +50, REL +75, RMSE -50; log10 is not looked at.
    scores = {"delta1": 0.9, "rel": 0.1, "rmse": 3.0, "log10": 9.0}
    assert mri_metrics(scores, {"delta1": 0.6, "rel": 0.4, "rmse": 2.0}) == pytest.approx(25.0)


@pytest.mark.parametrize(("rel", "reference"), [({}, {}), ({"nyu": 1.0}, {"kitti": 1.0}), ({"nyu": 1.0}, {})])
def test_mean_over_other_datasets_is_an_error(rel: dict[str, float], reference: dict[str, float]) -> None:
    with pytest.raises(InputError, match="same data sets"):
        mri_datasets(rel, reference)


def test_mean_without_one_of_the_metrics_is_an_error() -> None:
    full = {"delta1": 1.0, "rel": 1.0, "rmse": 1.0}
    for scores, reference in ((full, {"rel": 1.0, "rmse": 1.0}), ({"rel": 1.0, "rmse": 1.0}, full)):
        with pytest.raises(InputError, match="missing is delta1"):
            mri_metrics(scores, reference)


# ---------------------------------------------------------------------------------------- the paper's own


def key(entry: MriEntry) -> tuple[str, str, str]:
    return entry.table, entry.dataset, entry.method


def half_unit(printed: Decimal) -> float:
    """Return half a unit of the last printed digit, which rounding may have changed."""
    return 0.5 * 10.0 ** int(printed.as_tuple().exponent)


def corners(entry: MriEntry) -> Iterator[float]:
    """Return the mean at all ends of the intervals that round to the printed scores; it is monotone in each of them."""
    mean = mri_datasets if entry.dataset == ALL else mri_metrics
    if entry.method in REFERENCES:  # a score and its reference are one number, whatever it is
        yield 0.0
        return
    numbers = [*entry.scores.values(), *entry.reference.values()]
    for signs in product((-1, 1), repeat=len(numbers)):
        shifted = [float(number) + sign * half_unit(number) for number, sign in zip(numbers, signs, strict=True)]
        half = len(entry.scores)
        yield mean(
            dict(zip(entry.scores, shifted[:half], strict=True)),
            dict(zip(entry.reference, shifted[half:], strict=True)),
        )


def test_every_printed_mean_is_looked_at() -> None:
    found = {table: [e for e in mri_entries() if e.table == table] for table in ("table-2", "table-3", "table-4")}
    # 11 rows without PixelBins-X-NK, which has none; 7 rows on 4 data sets.
    assert [len(entries) for entries in found.values()] == [10, 28, 28]
    assert sum(map(len, found.values())) == len(mri_entries())
    for entry in mri_entries():
        assert len(entry.scores) == (4 if entry.dataset == ALL else 3)
        assert entry.scores.keys() == entry.reference.keys()


def test_table_2_to_the_printed_digit() -> None:
    printed = [-45.7, -74.0, 0.0, -12.2, 11.8, 10.1, 8.7, 4.9, 18.8, 25.2]
    assert [round(entry.recomputed, 1) for entry in mri_entries() if entry.dataset == ALL] == printed


def test_all_printed_means_but_the_listed_to_the_printed_digit() -> None:
    found = {
        key(entry): round(entry.difference, 3)
        for entry in mri_entries()
        if abs(entry.difference) > half_unit(entry.printed)
    }
    assert found == OTHER_DIGIT


def test_all_printed_means_but_the_listed_within_rounding() -> None:
    found = {}
    for entry in mri_entries():
        ends = list(corners(entry))
        half = half_unit(entry.printed) + 1e-9
        if not min(ends) - half <= float(entry.printed) <= max(ends) + half:
            found[key(entry)] = round(entry.difference, 3)
    assert found == BEYOND_ROUNDING


def test_rounding_interval_of_the_listed_entry_just_reaches_it() -> None:
    entry = next(entry for entry in mri_entries() if key(entry) in OTHER_DIGIT)
    # By hand, all six scores at the end in its favour:
    # 0.5585 / 0.5475 - 1 = 2.0091 %, 1 - 0.2105 / 0.2065 = -1.9370 %, 1 - 0.8795 / 0.8615 = -2.0894 %
    assert max(corners(entry)) == pytest.approx((2.0091 - 1.9370 - 2.0894) / 3, abs=1e-4)
    assert -0.75 < max(corners(entry)) < -0.65


def line(entry: MriEntry) -> str:
    """Return the entry's line in docs/published.md."""
    table = entry.table.replace("table-", "Table ")
    data = "all four" if entry.dataset == ALL else datasets()[entry.dataset].name
    difference = f"{entry.difference:+.3f}" if entry.method not in REFERENCES else "0"
    return f"| {table} | {data} | {entry.method} | {entry.printed} | {entry.recomputed:.3f} | {difference} |"


def test_documentation_lists_what_is_recomputed() -> None:
    lines = re.findall(r"^\| Table \d \| .*$", DOCS.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert lines == [line(entry) for entry in mri_entries()]
