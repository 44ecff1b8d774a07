"""Downloads as they are shown: a bar on a terminal, lines elsewhere."""

import pytest

from zoedepth.commands.progress import download_progress


def test_lines_at_the_start_after_every_100_mb_and_at_the_end(capfd: pytest.CaptureFixture[str]):
    total = 250_000_000
    with download_progress() as progress:
        for done in range(0, total + 1, 10_000_000):
            progress("ZoeD [large]", done, total)
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        f"downloading ZoeD [large]: {megabytes} of 250 MB" for megabytes in (0, 100, 200, 250)
    ]


def test_lines_of_a_file_of_unknown_length(capfd: pytest.CaptureFixture[str]):
    with download_progress() as progress:
        progress("ZoeD", 0, None)
        progress("ZoeD", 150_000_000, None)
    assert capfd.readouterr().err.splitlines() == ["downloading ZoeD: 0 MB", "downloading ZoeD: 150 MB"]


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
