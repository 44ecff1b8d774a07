"""The command line: help, exit codes, and errors in one line instead of a traceback."""

import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

import zoedepth
from zoedepth import cli
from zoedepth.cli import COMMANDS, Command, main
from zoedepth.errors import InputError, MissingExtraError, TrainingError


@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_help_lists_every_command(flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([flag]) == 0
    output = capsys.readouterr().out
    for name, command in COMMANDS.items():
        assert f"  {name} " in output
        assert command.help in output


def test_without_a_command_the_help_is_shown_and_it_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    output = capsys.readouterr()
    assert all(name in output.out + output.err for name in COMMANDS)


def test_version_is_the_packages(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert zoedepth.__version__ in capsys.readouterr().out


def test_unknown_command_is_an_error_that_names_it_and_lists_the_known(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pedict", "photo.jpg"]) == 2
    output = capsys.readouterr()
    assert "'pedict'" in output.err
    assert all(name in output.err for name in COMMANDS)
    assert output.out == ""


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "train"])
def test_every_command_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([name, "--help"])
    assert stopped.value.code == 0
    assert f"zoedepth {name}" in capsys.readouterr().out


NEEDED = {"convert": ["model", "target", "--to", "zoedepth"], "push": ["model", "owner/name"],
          "export": ["model", "--to", "onnx"]}  # fmt: skip
"""What a command is refused without before its flags are looked at."""


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "train"])
def test_unknown_flag_is_an_error_that_names_it(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([name, *NEEDED.get(name, []), "--no-such-flag", "1"])
    assert stopped.value.code == 2
    output = capsys.readouterr()
    assert "--no-such-flag" in output.out + output.err


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> Callable[[BaseException], None]:
    """Adds the command "fail", which raises."""

    def add(error: BaseException) -> None:
        def fail(arguments: Sequence[str]) -> int:
            raise error

        monkeypatch.setitem(cli.COMMANDS, "fail", Command("fails", lambda: fail))

    return add


@pytest.mark.parametrize(
    "error",
    [
        InputError("the photo is blank"),
        TrainingError("the photo is blank"),
        MissingExtraError("demo", "the photo is blank: seeing more"),
    ],
)
def test_errors_made_on_purpose_are_one_line(
    failing: Callable[[BaseException], None], error: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    failing(error)
    assert main(["fail"]) == 2
    output = capsys.readouterr()
    assert output.err.startswith("zoedepth fail: ")
    assert "the photo is blank" in output.err
    assert len(output.err.splitlines()) == 1
    assert output.out == ""


def test_interruption_has_its_own_exit_code(
    failing: Callable[[BaseException], None], capsys: pytest.CaptureFixture[str]
) -> None:
    failing(KeyboardInterrupt())
    assert main(["fail"]) == 130
    assert "interrupted" in capsys.readouterr().err


def test_bugs_are_not_hidden(failing: Callable[[BaseException], None]) -> None:
    failing(ZeroDivisionError())
    with pytest.raises(ZeroDivisionError):
        main(["fail"])


def test_what_a_command_returns_is_the_exit_code(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Sequence[str]] = []
    monkeypatch.setitem(cli.COMMANDS, "one", Command("", lambda: lambda rest: seen.append(rest) or 1))
    assert main(["one", "a", "--b"]) == 1
    assert seen == [["a", "--b"]]


def test_module_is_the_command(tmp_path: Path) -> None:
    process = subprocess.run(
        [sys.executable, "-m", "zoedepth", "evaluate", "--data", "nowhere.csv", "--model", "nowhere.safetensors"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert process.returncode == 2
    assert process.stdout == ""
    assert "nowhere.csv" in process.stderr
    assert "Traceback" not in process.stderr
