"""Work and downloads as they are shown: a bar on a terminal, lines elsewhere."""

import io
import time

import pytest
from rich.console import Console
from tests.servers import PATIENCE

from zoedepth.commands import progress as progress_module
from zoedepth.commands.progress import download_progress, show_tally, tally_line, track
from zoedepth.jobs.run import Tally


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that the module sees, in its only item."""
    now = [0.0]
    monkeypatch.setattr(progress_module, "monotonic", lambda: now[0])
    return now


def test_lines_of_a_download_at_the_start_every_15_seconds_and_at_the_end(
    clock: list[float], capfd: pytest.CaptureFixture[str]
) -> None:
    with download_progress() as progress:
        for clock[0], done in enumerate(range(0, 41)):
            progress("ZoeD [large]", done * 1_000_000, 40_000_000)
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        f"downloading ZoeD [large]: {megabytes} of 40 MB" for megabytes in (0, 15, 30, 40)
    ]


def test_lines_of_a_file_of_unknown_length(clock: list[float], capfd: pytest.CaptureFixture[str]):
    with download_progress() as progress:
        for clock[0], done in ((0, 0), (10, 100), (20, 150)):
            progress("ZoeD", done * 1_000_000, None)
    assert capfd.readouterr().err.splitlines() == ["downloading ZoeD: 0 MB", "downloading ZoeD: 150 MB"]


class TestTrack:
    def test_a_line_every_15_seconds_says_how_far_it_is_and_how_long_it_takes(
        self, clock: list[float], capfd: pytest.CaptureFixture[str]
    ) -> None:
        for item in track(range(1000), "depth [m]"):
            clock[0] = item * 0.1
        captured = capfd.readouterr()
        assert captured.out == ""
        lines = captured.err.splitlines()
        assert lines[:2] == ["depth [m]: 151 of 1,000, 84 s left", "depth [m]: 301 of 1,000, 70 s left"]
        assert len(lines) == 6

    def test_what_was_done_before_counts(self, clock: list[float], capfd: pytest.CaptureFixture[str]) -> None:
        for item in track(iter(range(100)), "shards", total=2000, first=1000):
            clock[0] = item * 2.0
        assert capfd.readouterr().err.splitlines()[0] == "shards: 1,009 of 2,000, 29 min left"

    def test_short_work_and_work_of_unknown_length(self, clock: list[float], capfd: pytest.CaptureFixture[str]) -> None:
        assert list(track(range(1000), "depth")) == list(range(1000))
        assert capfd.readouterr().err == ""
        for clock[0] in track(iter((5.0, 20.0, 30.0)), "files"):
            pass
        assert capfd.readouterr().err.splitlines() == ["files: 2"]

    def test_a_bar_on_a_terminal(
        self, clock: list[float], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setenv("FORCE_COLOR", "1")  # to rich, a terminal
        assert list(track(range(3), "depth [m]")) == [0, 1, 2]
        printed = capfd.readouterr().err
        assert "depth [m]" in printed
        assert "3/3" in printed


def test_bar_on_a_terminal_has_the_name(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]):
    monkeypatch.setenv("FORCE_COLOR", "1")  # to rich, a terminal
    with download_progress() as progress:
        progress("ZoeD [large]", 0, 250_000_000)
        progress("ZoeD [large]", 250_000_000, 250_000_000)
    captured = capfd.readouterr()
    assert captured.out == ""
    assert "ZoeD [large]" in captured.err
    assert "250.0/250.0 MB" in captured.err


@pytest.mark.parametrize("terminal", [True, False])
def test_nothing_is_shown_without_a_download(
    terminal: bool, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    if terminal:
        monkeypatch.setenv("FORCE_COLOR", "1")
    with download_progress():
        pass
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def test_bar_goes_away_when_the_download_fails(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]):
    monkeypatch.setenv("FORCE_COLOR", "1")

    def fail() -> None:
        with download_progress() as progress:
            progress("ZoeD", 0, 100)
            raise OSError("cut")

    with pytest.raises(OSError, match="cut"):
        fail()
    assert capfd.readouterr().err.endswith(("\x1b[2K", "\x1b[?25h")), "the line is erased and the cursor is back"


def test_the_line_of_a_job_says_what_is_done_failed_and_left() -> None:
    assert tally_line(Tally(), "depth", seconds=1) == "depth: 0 done, 0 failed"
    tally = Tally(done=900, failed=100, before=2000, total=13_000)
    assert (
        tally_line(tally, "depth", seconds=50)
        == "depth: 2,900 of 13,000 done, 100 failed, 2,000 of them before, 20.0 a second, 8 min left"
    )
    assert tally_line(Tally(done=3), "depth", seconds=15) == "depth: 3 done, 0 failed, 5.0 s each"


def test_a_job_prints_lines_where_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zoedepth.commands.progress.EVERY", 0.001)
    tally, shown = Tally(done=3, total=4), io.StringIO()
    deadline = time.monotonic() + PATIENCE  # minutes: a line comes after a millisecond, and a hang ends here
    with show_tally(tally, "depth", Console(file=shown)):
        while "\n" not in shown.getvalue():
            assert time.monotonic() < deadline
            time.sleep(0.001)
    assert shown.getvalue().startswith("depth: 3 of 4 done, 0 failed")
