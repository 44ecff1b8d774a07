"""Times in names, and pairs of the nearest."""

import pytest

from zoedepth.data.stamps import TOLERANCE, pair_by_time, seconds, seconds_of_name


@pytest.mark.parametrize(
    ("text", "time"),
    [
        ("1305031102.175304", 1305031102.175304),
        ("12.5", 12.5),
        ("1305031102175", 1305031102.175),
        ("1305031102175304", 1305031102.175304),
        ("1305031102175304000", 1305031102.175304),
    ],
)
def test_times_of_any_usual_unit(text: str, time: float) -> None:
    assert seconds(text) == pytest.approx(time, abs=1e-6)


@pytest.mark.parametrize("text", ["0001", "000001", "1305031102", "1e3", "-1.5", "frame", ""])
def test_numbers_of_frames_are_no_times(text: str) -> None:
    assert seconds(text) is None


def test_nearest_go_together_and_each_once() -> None:
    photos, depths = [0.0, 0.033, 0.066, 5.0], [0.010, 0.060, 0.069, 9.0]
    assert pair_by_time(photos, depths) == [(0, 0), (2, 2)]  # 0.033 is nearest to what is nearer to 0


def test_order_of_either_does_not_matter() -> None:
    assert pair_by_time([2.0, 0.0, 1.0], [0.01, 1.99, 1.0]) == [(0, 1), (1, 0), (2, 2)]


def test_far_ones_stay_alone() -> None:
    assert pair_by_time([1.0], [1.0 + TOLERANCE]) == [(0, 0)]
    assert pair_by_time([1.0], [1.001 + TOLERANCE]) == []
    assert pair_by_time([], [1.0]) == pair_by_time([1.0], []) == []


@pytest.mark.parametrize(
    ("name", "time"), [("3.10", None), ("12.5", None), ("0.033", 0.033), ("1305031102.17", 1305031102.17)]
)
def test_numbers_of_two_parts_are_no_times_of_files(name: str, time: float | None) -> None:
    assert seconds_of_name(name) == time
